"""Sarsa(lambda) on boxes: the values of actions in tables, learned while they are acted upon.

Rummery and Niranjan's "On-line Q-learning using connectionist systems" (1994), with the replacing
traces of Singh and Sutton, "Reinforcement learning with replacing eligibility traces" (1996), as
Randløv and Alstrøm rode their bicycle by it ("Learning to drive a bicycle using reinforcement
learning and shaping", ICML 1998).

The observation is cut into boxes, by edges along some of its components.  There may be several such
tables; the value of an action is the sum of its entries in the boxes of the moment, one of each
table:

    Q(s, a) = sum_k q_k(box_k(s), a)

With s', a' the next state and the action chosen there, every tick does, in each table k,

    delta = r + gamma Q(s', a') - Q(s, a)        Q(s', a') = 0 after a failure or a success
    e_k(box_k(s), a) = 1,  e_k(box_k(s), other actions) = 0
    q_k <- q_k + alpha_k delta e_k,  e_k <- gamma lambda e_k

and an episode begins with e = 0.  The tick in which time ran out teaches nothing: what would have
come after it is not known.  Actions are the best ones, the first of equals, but for a share
``exploration`` of them, which are uniformly random.

A trace that has fallen below ``forget`` counts as 0, so that a table needs to remember only its
last log(forget) / log(gamma lambda) visits, and a tick costs that many additions, however large the
tables are.  All seeds go in lockstep, each by random numbers of its own.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import torch
from torch import Tensor

from edtorch.native.choice import kernel_for
from edtorch.rewards import QuadraticReward
from edtorch.rivals.base import AccountedSearch, Problem
from edtorch.rivals.native_sarsa import BoxTable, SarsaKernel
from edtorch.run.hashing import Use, hash_key, uniform
from edtorch.run.scaled_sim import World
from edtorch.types import Parameters, select
from sims.base import Outcome, Quantity, Spec, spec_index

CHUNK = 2000
"""Ticks between two looks at which episodes have ended."""


@dataclass(frozen=True)
class Sarsa:
    """tables: by name, each the edges of its boxes by component of the state, in its unit, rising;
    a component on an edge is above it.  rates: alpha of each table, by the same names.  actions:
    values by component of the action, in its unit, of which every combination is an action.

    discount: gamma per tick, in [0, 1); trace: lambda, in [0, 1]; forget: the trace that counts as
    0; exploration: share of random actions.

    The reward of a tick: failure or success for one that ends an episode, else step plus the
    shaping reward of the problem.  every: simulated seconds from one checkpoint to the next.
    """

    tables: dict[str, dict[str, list[float]]] = field(default_factory=dict)
    rates: dict[str, float] = field(default_factory=dict)
    actions: dict[str, list[float]] = field(default_factory=dict)
    discount: float = 0.99
    trace: float = 0.95
    forget: float = 1e-4
    exploration: float = 0.0
    failure: float = -1.0
    success: float = 0.0
    step: float = 0.0
    every: float = 10_000.0

    def __post_init__(self) -> None:
        """Refuse impossible arguments."""
        bounds: tuple[tuple[str, str, Callable[[float], bool]], ...] = (
            ("discount", "a number in [0, 1)", lambda x: 0 <= x < 1),
            ("trace", "a number in [0, 1]", lambda x: 0 <= x <= 1),
            ("forget", "a number in (0, 1)", lambda x: 0 < x < 1),
            ("exploration", "a number in [0, 1]", lambda x: 0 <= x <= 1),
            ("failure", "a finite number", math.isfinite),
            ("success", "a finite number", math.isfinite),
            ("step", "a finite number", math.isfinite),
            ("every", "a finite number above 0 (s)", lambda x: 0 < x < math.inf),
        )
        for name, expected, holds in bounds:
            value = getattr(self, name)
            if not holds(value):
                raise ValueError(f"{name}={value}: expected {expected}")
        if not self.tables:
            raise ValueError("tables={}: expected one or more, each with edges by component")
        for name, table in self.tables.items():
            if not table:
                raise ValueError(f"tables.{name}={{}}: expected edges by component of the state")
            for component, edges in table.items():
                _expect_rising(f"tables.{name}.{component}", edges, "edges")
        if set(self.rates) != set(self.tables):
            raise ValueError(
                f"rates={dict(self.rates)}: expected one for each of the tables"
                f" {', '.join(self.tables)}, and no other"
            )
        for name, rate in self.rates.items():
            if not 0 < rate <= 1:
                raise ValueError(f"rates.{name}={rate}: expected a number in (0, 1]")
        if not self.actions:
            raise ValueError("actions={}: expected values for each component of the action")
        for name, values in self.actions.items():
            _expect_rising(f"actions.{name}", values, "values")

    @property
    def visits(self) -> int:
        """How many visits back a trace reaches ``forget``."""
        decay = self.discount * self.trace
        return max(1, math.ceil(math.log(self.forget) / math.log(decay))) if decay > 0 else 1

    def begin(self, problem: Problem) -> SarsaSearch:
        """Raises ValueError for components that the domain does not have, or an action without."""
        return SarsaSearch(self, problem)


def _expect_rising(name: str, numbers: Sequence[float], what: str) -> None:
    rising = all(a < b for a, b in itertools.pairwise(numbers))
    if not numbers or not rising or not all(map(math.isfinite, numbers)):
        raise ValueError(f"{name}={list(numbers)}: expected finite {what}, rising")


class Boxes:
    """Which box of each table an observation is in; all tables' boxes are rows of one.

    rows: how many there are; tables: how they are counted.
    """

    def __init__(self, tables: Mapping[str, Mapping[str, Sequence[float]]], world: World) -> None:
        """Raises ValueError for components that there are not."""
        self.tables: list[BoxTable] = []
        self.rows = 0
        for name, table in tables.items():
            known = [quantity.name for quantity in world.spec.state]
            for component, edges in table.items():
                if component not in known:
                    raise ValueError(
                        f"tables.{name}.{component}={list(edges)}: expected a component of"
                        f" {world.spec.name}: {', '.join(known)}"
                    )
            places = spec_index(world.spec, table)
            parts: list[tuple[int, int, Tensor]] = []
            size = 1
            for place, edges in zip(places, table.values(), strict=True):
                scale = world.spec.state[place].scale
                scaled = torch.tensor(edges, dtype=torch.float64) / scale
                parts.append((place, size, scaled.to(world.dtype)))
                size *= len(edges) + 1
            self.tables.append((self.rows, parts))
            self.rows += size

    def row(self, observation: Tensor) -> Tensor:
        """Rows ``[*batch, T]`` of T tables for observations ``[*batch, n]``, scaled."""
        components = observation.unbind(-1)
        rows = []
        for first, parts in self.tables:
            row = torch.full_like(components[0], first, dtype=torch.int64)
            for place, size, edges in parts:
                above = components[place].unsqueeze(-1) >= edges
                row = row + size * above.to(torch.int64).sum(-1)
            rows.append(row)
        return torch.stack(rows, -1)


def combinations(values: Mapping[str, Sequence[float]], spec: Spec) -> Tensor:
    """Every combination of the values ``[A, m]``, physical units, the last component fastest.

    Raises ValueError unless there are values for each component of the action.
    """
    names = [quantity.name for quantity in spec.action]
    if set(values) != set(names):
        raise ValueError(
            f"actions={dict(values)}: expected values of {', '.join(names)}, and no other"
        )
    for quantity in spec.action:
        _expect_within(quantity, values[quantity.name])
    chosen = itertools.product(*(values[name] for name in names))
    return torch.tensor(list(chosen), dtype=torch.float64)


def _expect_within(quantity: Quantity, values: Sequence[float]) -> None:
    for value in values:
        if not quantity.low <= value <= quantity.high:
            raise ValueError(
                f"actions.{quantity.name}={list(values)}: expected values from {quantity.low} to"
                f" {quantity.high} {quantity.unit}"
            )


class GreedyTable:
    """The best action of tables of values.

    boxes: where in the tables an observation is; actions: ``[A, m]``, scaled.
    """

    def __init__(self, boxes: Boxes, actions: Tensor) -> None:
        self.boxes = boxes
        self.actions = actions

    def action(self, parameters: Parameters, observation: Tensor) -> Tensor:
        """Actions ``[N, m]`` for observations ``[N, n]``, scaled; ``table`` ``[N, rows, A]``."""
        table = parameters["table"]
        row = self.boxes.row(observation)
        batch = torch.arange(len(table), device=table.device).unsqueeze(-1)
        return self.actions[table[batch, row].sum(-2).argmax(-1)]


@dataclass(frozen=True)
class _Memory:
    """What a tick changes in place, and never copies.

    table ``[S rows A]``: all values, flat; visited ``[S, T, K]``: where in it the last visits were;
    trace ``[S, T, K]``: their traces; ended ``[CHUNK, S]``: outcomes of the episodes that ended in
    each tick of the chunk, int64.
    """

    table: Tensor
    visited: Tensor
    trace: Tensor
    ended: Tensor


@dataclass(frozen=True)
class _Moment:
    """What a tick hands to the next one: the sim's state ``[k, S]``, the ticks of the episode
    ``[S]``, the observation ``[n, S]``, rows ``[T, S]`` and the chosen action ``[S]``."""

    state: Tensor
    ticks: Tensor
    observation: Tensor
    row: Tensor
    choice: Tensor


class _Tick:
    """One tick of every seed."""

    def __init__(
        self, settings: Sarsa, world: World, reward: QuadraticReward, seeds: Sequence[int]
    ) -> None:
        self._settings = settings
        self.world = world
        self.reward = reward
        self.boxes = Boxes(settings.tables, world)
        self.actions = world.scaled(combinations(settings.actions, world.spec))
        rates = [settings.rates[name] for name in settings.tables]
        self.rates = torch.tensor(rates, dtype=torch.float64).unsqueeze(-1)
        self.key = torch.stack([hash_key(Use.EPISODE, seed) for seed in seeds])
        seed_size = self.boxes.rows * len(self.actions)
        self._own = torch.arange(len(seeds)).unsqueeze(-1) * seed_size

    @property
    def numbers(self) -> dict[str, float]:
        """For ``SarsaKernel``."""
        settings = self._settings
        return {
            "DISCOUNT": settings.discount,
            "DECAY": settings.discount * settings.trace,
            "EXPLORATION": settings.exploration,
            "FAILURE": settings.failure,
            "SUCCESS": settings.success,
            "STEP": settings.step,
        }

    def _numbers(self, clock: Tensor) -> Tensor:
        """Of tick ``clock`` ``[]``: the world's, then two for the choice, ``[S, u + 2]``."""
        counter = clock.expand(len(self.key))
        return uniform(self.key, counter, self.world.uniforms + 2)

    def memory(self) -> _Memory:
        """Nothing learned yet."""
        seeds, tables = len(self.key), len(self.rates)
        shape = (seeds, tables, self._settings.visits)
        return _Memory(
            table=torch.zeros(seeds * self.boxes.rows * len(self.actions), dtype=torch.float64),
            visited=torch.zeros(shape, dtype=torch.int64),
            trace=torch.zeros(shape, dtype=torch.float64),
            ended=torch.zeros(CHUNK, seeds, dtype=torch.int64),
        )

    def first(self, memory: _Memory) -> _Moment:
        """The start of the first episodes: tick 0."""
        numbers = self._numbers(torch.zeros((), dtype=torch.int64))
        state = self.world.initial(numbers[:, :-2])
        observation = self.world.observe(state)
        row = self.boxes.row(observation)
        choice = self._choose(self._values(memory, row), numbers)
        ticks = torch.zeros(len(self.key), dtype=torch.int64)
        return _moment(state, ticks, observation, row, choice)

    def _values(self, memory: _Memory, row: Tensor) -> Tensor:
        """Q of every action ``[S, A]`` in rows ``[S, T]``."""
        count = len(self.actions)
        first = (self._own + row * count).unsqueeze(-1)
        return memory.table[first + torch.arange(count)].sum(-2)

    def _choose(self, values: Tensor, numbers: Tensor) -> Tensor:
        greedy = values.argmax(-1)
        count = len(self.actions)
        anyone = (numbers[:, -1] * count).to(torch.int64)
        return torch.where(numbers[:, -2] < self._settings.exploration, anyone, greedy)

    def _shaping(self, observation: Tensor, action: Tensor) -> Tensor:
        """The quadratic reward, its products written out: a library's call costs more than they."""
        state, command = self.reward.state_cost, self.reward.action_cost
        cost = ((observation.unsqueeze(-2) * state).sum(-1) * observation).sum(-1)
        if self.reward.costs_actions:
            cost = cost + ((action.unsqueeze(-2) * command).sum(-1) * action).sum(-1)
        return -cost

    def __call__(
        self, memory: _Memory, here: _Moment, going: Tensor, clock: Tensor, place: Tensor
    ) -> _Moment:
        """going ``[S]``: who learns; clock ``[]``: the tick; place ``[]``: its in the chunk."""
        settings, world = self._settings, self.world
        state, observation, row = (
            x.movedim(0, -1) for x in (here.state, here.observation, here.row)
        )
        numbers = self._numbers(clock)
        action = world.clip(self.actions[here.choice])
        moved = world.step(state, action, numbers)
        ticks = here.ticks + 1
        outcome = world.outcome(moved, ticks)
        seen = world.observe(moved, observation)
        ended = outcome != int(Outcome.RUNNING)
        reward = settings.step + self._shaping(seen, action).to(torch.float64)
        reward = torch.where(outcome == int(Outcome.FAILED), settings.failure, reward)
        reward = torch.where(outcome == int(Outcome.SUCCEEDED), settings.success, reward)

        moved = world.restart(moved, ended, numbers[:, :-2])
        seen = select(ended, world.observe(moved), seen)
        next_row = self.boxes.row(seen)
        values = self._values(memory, next_row)
        choice = self._choose(values, numbers)

        first = self._own + row * len(self.actions)
        entry = first + here.choice.unsqueeze(-1)
        following = values.gather(-1, choice.unsqueeze(-1)).squeeze(-1)
        following = torch.where(ended, 0.0, following)
        delta = reward + settings.discount * following - memory.table[entry].sum(-1)
        learns = going & (outcome != int(Outcome.TIMED_OUT))
        delta = torch.where(learns, delta, 0.0)

        first, entry = first.unsqueeze(-1), entry.unsqueeze(-1)
        newest = torch.arange(settings.visits) == clock % settings.visits
        in_box = (memory.visited >= first) & (memory.visited < first + len(self.actions))
        trace = torch.where(newest, 1.0, torch.where(in_box, 0.0, memory.trace))
        visited = torch.where(newest, entry, memory.visited)
        change = self.rates * delta.view(-1, 1, 1) * trace
        decayed = settings.discount * settings.trace * trace
        memory.trace.copy_(select(ended, torch.zeros_like(decayed), decayed))
        memory.visited.copy_(visited)
        # At most one visit to an entry still has a trace, so that the order does not matter.
        memory.table.index_put_((visited,), change, accumulate=True)
        memory.ended.index_put_((place,), outcome)
        ticks = torch.where(ended, 0, ticks)
        return _moment(moved, ticks, seen, next_row, choice)


def _moment(
    state: Tensor, ticks: Tensor, observation: Tensor, row: Tensor, choice: Tensor
) -> _Moment:
    """Of tensors ``[S, ...]``."""
    turned = (x.movedim(-1, 0).contiguous() for x in (state, observation, row))
    state, observation, row = turned
    return _Moment(state, ticks, observation, row, choice)


LearningLoop = Callable[[_Memory, _Moment, Tensor, int, int], _Moment]
"""(memory, moment, going ``[S]``, clock, count) to the moment ``count`` ticks later, at most
``CHUNK``; memory is changed in place."""


def learning_loop(tick: _Tick) -> LearningLoop:
    """One tick after the other."""

    def advance(memory: _Memory, moment: _Moment, going: Tensor, clock: int, count: int) -> _Moment:
        for number in range(count):
            now, place = torch.tensor(clock + 1 + number), torch.tensor(number)
            moment = tick(memory, moment, going, now, place)
        return moment

    return advance


def compiled_loop(tick: _Tick) -> LearningLoop:
    """The same compiled.  Raises NoKernel or Unavailable."""
    kernel = SarsaKernel(
        tick.world,
        tick.reward,
        tick.boxes.tables,
        tick.world.clip(tick.actions),
        tick.rates.flatten(),
        tick.key,
        tick.numbers,
    )

    def advance(memory: _Memory, moment: _Moment, going: Tensor, clock: int, count: int) -> _Moment:
        kept = (memory.table, memory.visited, memory.trace)
        here = (moment.state, moment.ticks, moment.observation, moment.row, moment.choice)
        return _Moment(*kernel(kept, here, memory.ended, going, clock, count))

    return advance


class SarsaSearch(AccountedSearch):
    """One table of values per seed, begun and under way."""

    def __init__(self, settings: Sarsa, problem: Problem) -> None:
        super().__init__(problem)
        world, seeds = problem.world, problem.seeds
        self._settings = settings
        self._dt = world.dt
        lasts = world.rule.survival is not False
        self._successes = {Outcome.SUCCEEDED, *([Outcome.TIMED_OUT] if lasts else [])}
        with torch.inference_mode():
            self._tick = _Tick(settings, world, problem.weights, seeds)
            self._memory = self._tick.memory()
            self._moment = self._tick.first(self._memory)
        self._clock = 0
        tick, what = self._tick, "ticks of Sarsa are"
        self._advance = kernel_for(
            problem.native, lambda: compiled_loop(tick), what
        ) or learning_loop(tick)
        self._actor = GreedyTable(self._tick.boxes, self._tick.actions)
        self._began = [0] * len(seeds)

    @property
    def actor(self) -> GreedyTable:
        """The best action."""
        return self._actor

    @property
    def parameters(self) -> Parameters:
        """``table`` ``[S, rows, A]``: values of the actions in the boxes of all tables."""
        shape = (len(self.accounts), self._tick.boxes.rows, len(self._tick.actions))
        return {"table": self._memory.table.view(shape)}

    @property
    def done(self) -> list[bool]:
        """It never is."""
        return [False] * len(self.accounts)

    def state(self) -> dict[str, Any]:
        """See ``Resumable``."""
        memory = self._memory
        return {
            **super().state(),
            "clock": self._clock,
            "began": list(self._began),
            "memory": {"table": memory.table, "visited": memory.visited, "trace": memory.trace},
            "moment": dict(vars(self._moment)),
            "world": self._tick.world.memory(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """See ``Resumable``."""
        super().restore(state)
        self._clock, self._began = state["clock"], list(state["began"])
        memory, moment = (
            {name: part.clone() for name, part in state[kind].items()}
            for kind in ("memory", "moment")
        )
        world = self._tick.world.recall(moment["state"].movedim(0, -1), state["world"])
        moment["state"] = world.movedim(-1, 0).contiguous()
        self._memory, self._moment = replace(self._memory, **memory), _Moment(**moment)

    def advance(self, going: Sequence[bool], pause: Callable[[], None]) -> None:
        """``every`` simulated seconds; a seed that is not going learns no more."""
        left = max(1, round(self._settings.every / self._dt))
        with torch.inference_mode():
            learns = torch.tensor(going)
            while left:
                pause()
                count = min(CHUNK, left)
                self._moment = self._advance(self._memory, self._moment, learns, self._clock, count)
                self._clock += count
                self._record(going, count)
                left -= count

    def _record(self, going: Sequence[bool], count: int) -> None:
        """The episodes that ended in the last ``count`` ticks, and what they cost."""
        before = self._clock - count
        for row, account in enumerate(self.accounts):
            if not going[row]:
                continue
            ended = self._memory.ended[:count, row]
            at = ended.nonzero().flatten()
            for place, outcome in zip(at.tolist(), ended[at].tolist(), strict=True):
                clock = before + place + 1
                # By the clock, not episode by episode: a sum of thousands would miss the budget.
                account.spend(clock * self._dt - account.seconds)
                seconds = (clock - self._began[row]) * self._dt
                success = outcome in self._successes
                account.end(Outcome(outcome), seconds, success=success)
                self._began[row] = clock
            account.spend((before + count) * self._dt - account.seconds)
