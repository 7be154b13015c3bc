"""Recorded transitions of a random controller, and rewards for them: what batch methods learn from.

A batch method never acts while it learns.  Here a controller that chooses uniformly among a few
actions makes the record; any other one of the same form would do.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import torch
from torch import Tensor

from edtorch.rivals.ledger import Account, pay
from edtorch.run.evaluation import starts
from edtorch.run.hashing import Use, hash_key, uniform
from edtorch.run.random import Draw
from edtorch.run.rollout import rollout
from edtorch.run.scaled_sim import World
from edtorch.run.tick import Tick
from edtorch.types import Transition
from sims.base import Outcome, Spec

BETWEEN_PAUSES = 64
"""Ticks between two looks at whether to stop."""


@dataclass(frozen=True)
class Transitions:
    """N transitions, ordered by episode and in it by time; all scaled (``edtorch.run.scaled_sim``).

    state ``[N, n]``, action ``[N, m]``, next_state ``[N, n]``, dt ``[N]`` (s), episode ``[N]``
    int64; terminated ``[N]``: the world ended the episode here; failed ``[N]``: and by a failure;
    truncated ``[N]``: the episode was cut off here, or ran out of time, and would have gone on.
    """

    state: Tensor
    action: Tensor
    next_state: Tensor
    dt: Tensor
    episode: Tensor
    terminated: Tensor
    truncated: Tensor
    failed: Tensor

    def __len__(self) -> int:
        """N."""
        return len(self.state)


def concatenated(parts: Sequence[Transitions]) -> Transitions:
    """One record of several, at least one, in this order."""
    names = Transitions.__dataclass_fields__
    return Transitions(**{n: torch.cat([getattr(part, n) for part in parts]) for n in names})


@dataclass(frozen=True)
class BatchSettings:
    """What methods that learn from recorded transitions of a random controller have in common.

    actions: vectors of actions in physical units to choose from; none: every combination of the
    lower bound, zero and the upper bound of each component.  steps: of an episode, after which it
    is cut off; null: it goes on to its end.  discount: per tick, in [0, 1).

    The reward of a transition is a sum, by name of components of the state, in physical units:
    reward_square: per unit by which the square of a component decreases; reward_size: by which its
    absolute value does; reward_cosine: times the cosine of an angle (rad) afterwards, or of the
    difference of two, ``one-other``, which is the progress towards something far away in the
    direction 0, made at a steady speed; and reward_failure where the episode ends by a failure.
    Nothing is gained after an end.
    """

    actions: Any = field(default_factory=list)  # a typed list would refuse whole numbers
    steps: int | None = None
    discount: float = 0.98
    reward_square: dict[str, float] = field(default_factory=dict)
    reward_size: dict[str, float] = field(default_factory=dict)
    reward_cosine: dict[str, float] = field(default_factory=dict)
    reward_failure: float = 0.0

    def __post_init__(self) -> None:
        """Refuse impossible arguments."""
        if self.steps is not None:
            check_at_least("steps", self.steps, 1)
        if not 0 <= self.discount < 1:
            raise ValueError(f"discount={self.discount}: expected a number in [0, 1)")
        for name in REWARDS:
            for component, weight in getattr(self, name).items():
                if not math.isfinite(weight):
                    raise ValueError(f"{name}.{component}={weight}: expected a finite number")
        if not math.isfinite(self.reward_failure):
            raise ValueError(f"reward_failure={self.reward_failure}: expected a finite number")


REWARDS = ("reward_square", "reward_size", "reward_cosine")


def check_at_least(name: str, value: int, least: int) -> None:
    """Raises ValueError for an integer that is too small."""
    if value < least:
        raise ValueError(f"{name}={value}: expected an integer >= {least}")


def action_set(settings: BatchSettings, world: World) -> Tensor:
    """The actions to choose from, scaled, ``[A, m]``; ValueError names the setting."""
    spec = world.spec
    chosen = settings.actions
    if not isinstance(chosen, list):
        raise ValueError(f"actions={chosen}: expected a list of vectors")
    if not chosen:
        bounds = [q.low for q in spec.action] + [q.high for q in spec.action]
        if not all(map(math.isfinite, bounds)):
            raise ValueError(
                f"actions={chosen}: expected vectors of {len(spec.action)} numbers, since not all"
                f" actions of {spec.name} have bounds"
            )
        chosen = [
            list(vector)
            for vector in itertools.product(*(sorted({q.low, 0.0, q.high}) for q in spec.action))
        ]
    for place, vector in enumerate(chosen):
        if not _is_vector(vector, len(spec.action)):
            raise ValueError(
                f"actions[{place}]={vector}: expected {len(spec.action)} finite numbers,"
                f" {', '.join(q.name for q in spec.action)}"
            )
        if not all(q.low <= a <= q.high for q, a in zip(spec.action, vector, strict=True)):
            bounds = ", ".join(f"{q.name} in [{q.low:g}, {q.high:g}]" for q in spec.action)
            raise ValueError(f"actions[{place}]={vector}: expected {bounds}")
    if len({tuple(vector) for vector in chosen}) != len(chosen) or len(chosen) < 2:
        raise ValueError(f"actions={chosen}: expected at least two, all different")
    return world.scaled(torch.tensor(chosen, dtype=torch.float64, device=world.device))


def _is_vector(given: Any, size: int) -> bool:
    """Whether it is a list of so many finite numbers."""
    if not isinstance(given, list) or len(given) != size:
        return False
    return all(isinstance(a, (int, float)) and math.isfinite(a) for a in given)


def choices(actions: Tensor, taken: Tensor) -> Tensor:
    """Which of ``actions`` ``[A, m]`` each of ``taken`` ``[N, m]`` is, ``[N]``.

    Raises ValueError for any other action.
    """
    same = (taken[:, None] == actions).all(-1)
    if not bool(same.any(-1).all()):
        row = int((~same.any(-1)).nonzero()[0])
        raise ValueError(f"row {row}: action {taken[row].tolist()} is not an allowed action")
    return same.to(torch.uint8).argmax(-1)


def _weights(name: str, given: Mapping[str, float], spec: Spec) -> list[tuple[int, float]]:
    names = [q.name for q in spec.state]
    for component, weight in given.items():
        if component not in names:
            raise ValueError(f"{name}.{component}={weight}: expected one of {', '.join(names)}")
    return [(names.index(component), weight) for component, weight in given.items()]


def _angles(given: Mapping[str, float], spec: Spec) -> list[tuple[list[int], float]]:
    """Places of the angle that each weight is for, and of the one subtracted from it, if any."""
    angles = {q.name: place for place, q in enumerate(spec.state) if q.unit == "rad"}
    found: list[tuple[list[int], float]] = []
    for key, weight in given.items():
        parts = key.split("-")
        if len(parts) > 2 or not all(part in angles for part in parts):
            raise ValueError(
                f"reward_cosine.{key}={weight}: expected an angle in rad or one-other, of"
                f" {', '.join(angles)}"
            )
        found.append(([angles[part] for part in parts], weight))
    return found


def rewards(settings: BatchSettings, spec: Spec, data: Transitions) -> Tensor:
    """The reward of each transition, ``[N]``.  Raises ValueError, which names the setting."""
    scale = torch.tensor(
        [q.scale for q in spec.state], dtype=torch.float64, device=data.state.device
    )
    before, after = data.state * scale, data.next_state * scale
    total = settings.reward_failure * data.failed.to(before.dtype)
    for place, weight in _weights("reward_square", settings.reward_square, spec):
        total = total + weight * (before[:, place].square() - after[:, place].square())
    for place, weight in _weights("reward_size", settings.reward_size, spec):
        total = total + weight * (before[:, place].abs() - after[:, place].abs())
    for places, weight in _angles(settings.reward_cosine, spec):
        first, *subtracted = (after[:, place] for place in places)
        total = total + weight * (first - sum(subtracted)).cos()
    return total


def check_rewards(settings: BatchSettings, spec: Spec) -> None:
    """Raises ValueError, which names the setting, for rewards that this domain has not."""
    n, m = len(spec.state), len(spec.action)
    no = torch.zeros(0, dtype=torch.bool)
    numbers = torch.zeros(0, dtype=torch.float64)
    rewards(
        settings,
        spec,
        Transitions(
            state=torch.zeros(0, n, dtype=torch.float64),
            action=torch.zeros(0, m, dtype=torch.float64),
            next_state=torch.zeros(0, n, dtype=torch.float64),
            dt=numbers,
            episode=no.to(torch.int64),
            terminated=no,
            truncated=no,
            failed=no,
        ),
    )
    weights = [w for name in REWARDS for w in getattr(settings, name).values()]
    if not any(weights) and settings.reward_failure == 0:
        raise ValueError(
            f"reward_failure={settings.reward_failure}: expected another number than 0, or one of"
            f" {', '.join(REWARDS)}"
        )


def collect(
    world: World,
    actions: Tensor,
    *,
    seed: int,
    episodes: range,
    steps: int | None,
    account: Account,
    pause: Callable[[], None],
) -> Transitions:
    """Episodes of a controller that chooses in each tick, uniformly among ``actions``
    ``[A, m]`` (scaled), whatever it sees; each is cut off after ``steps``.

    Which of them it chooses, and what happens, depends on (seed, number of the episode, tick)
    alone.  All of it is entered in ``account``.
    """
    number = torch.tensor(list(episodes), device=world.device)
    key = hash_key(Use.EPISODE, seed, number)
    count = world.uniforms + 1  # the last one chooses

    @lru_cache(maxsize=1)
    def draw(clock: int) -> Draw:
        numbers = uniform(key, torch.full_like(number, clock), count)
        return Draw(numbers[:, :-1], actions[(numbers[:, -1] * len(actions)).to(torch.int64)])

    lived = torch.zeros_like(number)
    ended = torch.zeros_like(number)  # RUNNING
    record: list[tuple[Tensor, ...]] = []
    with torch.no_grad():
        tick = Tick(_Drawn(), world, most_episodes=1)
        here = tick.first(None, starts(world, [seed], len(number), draw(0).uniform))
        pause()
        for happened in rollout(tick, here, draw, ticks=steps):
            if happened.clock % BETWEEN_PAUSES == 0:
                pause()
            transition, outcome = happened.transition, happened.outcome
            running = happened.before.active
            last = torch.full_like(running, happened.clock == steps)
            cut = last & (outcome == int(Outcome.RUNNING))
            # The action that was chosen, whatever became of it.
            action = draw(happened.clock).normal
            rows = (transition.state, action, transition.next_state, number, outcome, cut)
            record.append(tuple(r[running] for r in rows))
            lived, ended = lived + running, ended + outcome
            here = happened.population
        pay(account, world, here.worlds.world, ended, lived)
        return _in_order([torch.cat(column) for column in zip(*record, strict=True)], world)


class _Drawn:
    """Does what was drawn (``edtorch.run.tick.Source``): a tick's other numbers are its actions."""

    def begin(self, memory: None, fresh: Tensor, observation: Tensor, /) -> None:
        """It remembers nothing."""

    def act(self, memory: None, observation: Tensor, normal: Tensor, /) -> Tensor:
        """The action drawn."""
        return normal

    def step(self, memory: None, transition: Transition, /, *, improve: bool) -> tuple[None, None]:
        """It learns nothing."""
        return None, None


def _in_order(columns: Sequence[Tensor], world: World) -> Transitions:
    """What was written down tick by tick, episode by episode."""
    order = columns[3].argsort(stable=True)
    state, action, seen, number, outcome, cut = (column[order] for column in columns)
    failed, succeeded = (outcome == int(o) for o in (Outcome.FAILED, Outcome.SUCCEEDED))
    return Transitions(
        state=state,
        action=action,
        next_state=seen,
        dt=torch.full_like(state[:, 0], world.dt),
        episode=number,
        terminated=failed | succeeded,
        truncated=cut | (outcome == int(Outcome.TIMED_OUT)),
        failed=failed,
    )
