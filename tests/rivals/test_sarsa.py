"""Sarsa(lambda): equal to the textbook's dense traces, and to the values of a chain."""

from __future__ import annotations

import itertools
import logging
import math
from dataclasses import replace
from typing import Any, ClassVar

import pytest
import torch
from torch import Tensor

from edtorch.model.features import Identity
from edtorch.policy.policies import LinearPolicy
from edtorch.rewards import QuadraticReward
from edtorch.rivals import sarsa
from edtorch.rivals.base import Problem
from edtorch.rivals.sarsa import Boxes, Sarsa, SarsaSearch
from edtorch.run.hashing import Use, hash_key, uniform
from edtorch.run.scaled_sim import World
from sims.base import Outcome, Quantity, Spec
from sims.bicycle import Bicycle, Physics

CELLS = 6


class Corridor:
    """Cells 1 to 6 in a row; one step to the left or to the right.  To the left of the first is
    failure, to the right of the last success."""

    traceable: ClassVar[bool] = True
    spec = Spec(
        name="corridor",
        state=(Quantity("cell", "1", scale=2.0),),
        action=(Quantity("side", "1", scale=4.0, low=-1.0, high=1.0),),
        dt=0.5,
        time_limit=100.0,
        disturbance_dim=0,
        reset_dim=1,
        clip_action=True,
        headline="cell",
    )

    def initial(self, uniforms: Tensor) -> Tensor:
        """Any cell, ``[*batch, 1]``."""
        return 1 + torch.floor(uniforms * CELLS)

    def restart(self, state: Tensor, mask: Tensor, uniforms: Tensor) -> Tensor:
        """A new cell where ``mask``."""
        return torch.where(mask.unsqueeze(-1), self.initial(uniforms), state)

    def step(self, state: Tensor, action: Tensor, uniforms: Tensor) -> Tensor:
        """One cell on."""
        return state + action

    def observe(self, state: Tensor) -> Tensor:
        """The cell."""
        return state

    def outcome(self, state: Tensor) -> Tensor:
        """Failed on the left, succeeded on the right."""
        cell = state[..., 0]
        ended = torch.where(cell < 1, int(Outcome.FAILED), int(Outcome.RUNNING))
        return torch.where(cell > CELLS, int(Outcome.SUCCEEDED), ended)

    def measures(self, start: Tensor, final: Tensor, seconds: Tensor) -> dict[str, Tensor]:
        """None."""
        return {}


CORRIDOR = Sarsa(
    tables={"cells": {"cell": [1.5, 2.5, 3.5, 4.5, 5.5]}},
    rates={"cells": 0.5},
    actions={"side": [-1.0, 1.0]},
    discount=0.9,
    success=1.0,
    step=-0.05,
    every=250.0,
)
BALANCING = Sarsa(
    tables={
        "balance": {"lean": [-0.06, 0.0, 0.06], "lean_rate": [-0.25, 0.0, 0.25]},
        "steering": {"handlebar": [-0.2, 0.0, 0.2], "lean": [0.0]},
    },
    rates={"balance": 0.5, "steering": 0.1},
    actions={"handlebar_torque": [-2.0, 0.0, 2.0], "displacement": [-0.02, 0.02]},
    exploration=0.2,
    success=0.01,
    step=0.001,
    every=30.0,
)


def _problem(world: World, seeds: range, *, cost: float = 0.0, **more: Any) -> Problem:
    n, m = len(world.spec.state), len(world.spec.action)
    reward = QuadraticReward(
        cost * torch.eye(n, dtype=torch.float64), cost * torch.eye(m, dtype=torch.float64)
    )
    policy = LinearPolicy(n, m, Identity(n))
    settings: dict[str, Any] = {"native": "off"} | more
    return Problem(world, policy, reward, seeds, **settings)


def _searched(settings: Sarsa, problem: Problem, pieces: int = 1) -> SarsaSearch:
    search = settings.begin(problem)
    for _ in range(pieces):
        search.advance([True] * len(problem.seeds), lambda: None)
    return search


def _bicycle() -> World:
    """Short rides that end in every way."""
    return World(
        Bicycle(
            time_limit=0.45,
            start_heading_low=-math.pi / 2 - 0.6,
            start_heading_high=-math.pi / 2 + 0.6,
            goal_radius=997.8,
            physics=Physics(omega_max=0.02),
        )
    )


def _dense(  # noqa: C901 (written out as the textbook has it, sharing nothing with the code)
    settings: Sarsa, world: World, seed: int, ticks: int, cost: float
) -> list[Any]:
    """The textbook, one learner, one table of traces each as large as its table of values; also the
    outcomes that came."""
    names = [q.name for q in world.spec.state]
    actions = list(itertools.product(*settings.actions.values()))
    # The order in which the domain names its actions is that of these settings.
    assert list(settings.actions) == [q.name for q in world.spec.action]

    def boxes(observation: Tensor) -> list[tuple[int, ...]]:
        found = []
        for table in settings.tables.values():
            places = []
            for name, edges in table.items():
                quantity = world.spec.state[names.index(name)]
                value = float(observation[names.index(name)]) * quantity.scale
                places.append(sum(value >= edge for edge in edges))
            found.append(tuple(places))
        return found

    values: list[dict[Any, float]] = [{} for _ in settings.tables]
    traces: list[dict[Any, float]] = [{} for _ in settings.tables]
    rates = [settings.rates[name] for name in settings.tables]
    key = hash_key(Use.EPISODE, seed)

    def numbers(clock: int) -> Tensor:
        return uniform(key, torch.tensor(clock), world.uniforms + 2)

    def value(at: list[tuple[int, ...]], action: int) -> float:
        return sum(own.get((box, action), 0.0) for own, box in zip(values, at, strict=True))

    def chosen(at: list[tuple[int, ...]], drawn: Tensor) -> int:
        if float(drawn[-2]) < settings.exploration:
            return int(float(drawn[-1]) * len(actions))
        every = [value(at, a) for a in range(len(actions))]
        return every.index(max(every))

    drawn = numbers(0)
    state = world.initial(drawn[None, :-2])
    here = boxes(world.observe(state)[0])
    action, age = chosen(here, drawn), 0
    outcomes = set()
    for clock in range(1, ticks + 1):
        drawn, age = numbers(clock), age + 1
        command = world.clip(world.scaled(torch.tensor([actions[action]], dtype=torch.float64)))
        state = world.step(state, command, drawn[None])
        outcome = Outcome(int(world.outcome(state, torch.tensor([age]))))
        seen = world.observe(state)
        reward = settings.step - cost * float((seen**2).sum() + (command**2).sum())
        if outcome is Outcome.FAILED:
            reward = settings.failure
        if outcome is Outcome.SUCCEEDED:
            reward = settings.success
        following = 0.0
        if outcome is Outcome.RUNNING:
            there = boxes(seen[0])
            after = chosen(there, drawn)
            following = value(there, after)
        else:
            outcomes.add(outcome)
            state, age = world.initial(drawn[None, :-2]), 0
            there = boxes(world.observe(state)[0])
            after = chosen(there, drawn)
        error = reward + settings.discount * following - value(here, action)
        for own, trace, box, rate in zip(values, traces, here, rates, strict=True):
            for a in range(len(actions)):
                trace.pop((box, a), None)
            trace[box, action] = 1.0
            for entry in trace:
                if outcome is not Outcome.TIMED_OUT:
                    own[entry] = own.get(entry, 0.0) + rate * error * trace[entry]
                trace[entry] *= settings.discount * settings.trace
            if outcome is not Outcome.RUNNING:
                trace.clear()
        here, action = there, after
    return [values, outcomes]


def _entries(search: SarsaSearch, settings: Sarsa, row: int) -> list[dict[Any, float]]:
    """The tables of one seed by box and action, unvisited entries left out."""
    table, first, found = search.parameters["table"][row], 0, []
    for edges in settings.tables.values():
        sizes = [len(e) + 1 for e in edges.values()]
        own = {}
        # The first component counts fastest.
        for place, box in enumerate(itertools.product(*(range(s) for s in reversed(sizes)))):
            for action, entry in enumerate(table[first + place].tolist()):
                if entry != 0:
                    own[box[::-1], action] = entry
        found.append(own)
        first += math.prod(sizes)
    return found


@pytest.mark.oracle
def test_equals_the_textbook_with_dense_traces() -> None:
    """Two tables, shaping, exploration, episodes that end in every way; nothing forgotten."""
    settings = replace(BALANCING, forget=1e-12, every=6.0)
    world = _bicycle()
    search = _searched(settings, _problem(world, range(3, 5), cost=0.01))
    expected, outcomes = _dense(settings, world, 4, 600, 0.01)
    for found, own in zip(_entries(search, settings, 1), expected, strict=True):
        assert set(found) == set(own)
        assert all(abs(found[k] - own[k]) < 1e-12 for k in own)
    assert outcomes == {Outcome.FAILED, Outcome.SUCCEEDED, Outcome.TIMED_OUT}


def test_forgetting_small_traces_changes_little() -> None:
    """One episode; what is left out of each update is below alpha delta times the cut-off."""
    world = _bicycle()
    settings = replace(BALANCING, exploration=1.0, every=0.4)
    tables = [
        _searched(replace(settings, forget=f), _problem(world, range(8))).parameters["table"]
        for f in (1e-12, 0.1, 0.3)
    ]
    differences = [float((tables[0] - other).abs().max()) for other in tables[1:]]
    assert 0 <= differences[0] < 0.5 * 0.1 * 1.1
    assert differences[0] < differences[1] < 0.5 * 0.3 * 1.1
    assert replace(settings, forget=1e-3).visits == 113  # 0.9405^113 < .001 < 0.9405^112


@pytest.mark.parametrize("trace", [0.0, 0.8, 1.0])
def test_learns_the_values_of_a_corridor(trace: float) -> None:
    """The best is to go right: d cells from the end, -.05 (1 - g^(d-1)) / (1 - g) + g^(d-1)."""
    settings = replace(CORRIDOR, trace=trace, exploration=0.0)
    search = _searched(settings, _problem(World(Corridor()), range(4)))
    left = torch.arange(CELLS - 1, -1, -1, dtype=torch.float64)
    expected = -0.05 * (1 - 0.9**left) / 0.1 + 0.9**left
    table = search.parameters["table"]
    torch.testing.assert_close(table[..., 1], expected.expand(4, CELLS), rtol=0, atol=1e-3)
    assert bool((table[..., 0] < table[..., 1]).all())
    cells = torch.arange(1, CELLS + 1, dtype=torch.float64) / 2.0
    for cell in cells:
        acted = search.actor.action(search.parameters, cell.expand(4, 1))
        assert acted.equal(torch.full((4, 1), 0.25, dtype=torch.float64))


def test_a_seed_is_the_same_in_any_population() -> None:
    world = _bicycle()
    settings = replace(BALANCING, every=1.5)
    alone = _searched(settings, _problem(world, range(7, 8)))
    among = _searched(settings, _problem(world, range(5, 9)))
    assert alone.parameters["table"][0].equal(among.parameters["table"][2])
    assert alone.accounts[0] == among.accounts[2]
    assert among.accounts[0] != among.accounts[1]


def test_what_is_paid_is_what_was_simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    """Also where a piece is longer than a chunk; a seed that stopped learns and pays no more."""
    monkeypatch.setattr(sarsa, "CHUNK", 40)
    settings = replace(CORRIDOR, every=100 * 0.5, exploration=0.3)
    search = _searched(settings, _problem(World(Corridor()), range(2)))
    assert all(a.seconds == 50.0 for a in search.accounts)
    before = search.parameters["table"].clone()
    stopped, other = replace(search.accounts[0]), search.accounts[1].episodes
    search.advance([False, True], lambda: None)
    assert search.accounts[0] == stopped
    assert search.parameters["table"][0].equal(before[0])
    assert not search.parameters["table"][1].equal(before[1])
    assert search.accounts[1].seconds == 100.0
    account = search.accounts[1]
    assert account.episodes > other > 0
    assert account.failures + account.successes == account.episodes
    assert account.first is not None and account.goal is not None
    assert account.goal.seconds <= account.goal.paid <= account.seconds
    assert search.done == [False, False]


def test_boxes_are_those_of_the_edges() -> None:
    """Rows by counting, in units, edges to the box above them."""
    world = World(Bicycle())
    tables = {"a": {"lean": [0.0, 0.1], "handlebar": [0.2]}, "b": {"angle_to_goal": [1.0]}}
    boxes = Boxes(tables, world)
    assert boxes.rows == 3 * 2 + 2
    scale = torch.tensor([q.scale for q in world.spec.state], dtype=torch.float64)
    physical = torch.zeros(4, 5, dtype=torch.float64)
    physical[:, 0] = torch.tensor([-0.01, 0.0, 0.05, 0.15])
    physical[:, 2] = torch.tensor([0.0, 0.3, 0.1, 0.3])
    physical[:, 4] = torch.tensor([0.0, 1.5, -3.0, 1.1])
    assert boxes.row(physical / scale).tolist() == [[0, 6], [4, 7], [1, 6], [5, 7]]


def test_pause_ends_it() -> None:
    def stop() -> None:
        raise KeyboardInterrupt

    search = CORRIDOR.begin(_problem(World(Corridor()), range(1)))
    with pytest.raises(KeyboardInterrupt):
        search.advance([True], stop)
    assert search.accounts[0].seconds == 0


@pytest.mark.oracle
def test_a_kernel_does_the_same() -> None:
    """Episodes that end in every way, over pieces and chunks; a seed that stopped as well."""
    settings = replace(BALANCING, every=6.0)
    found, wanted = (
        _searched(settings, _problem(_bicycle(), range(3, 6), cost=0.01, native=native))
        for native in ("on", "off")
    )
    for search in (found, wanted):
        search.advance([True, False, True], lambda: None)
    assert found.accounts == wanted.accounts
    assert all(account.failures and account.successes for account in found.accounts)
    torch.testing.assert_close(
        found.parameters["table"], wanted.parameters["table"], rtol=1e-9, atol=1e-9
    )


def test_a_world_without_a_kernel_is_said(caplog: pytest.LogCaptureFixture) -> None:
    with pytest.raises(ValueError, match="no kernel for the simulator corridor, which is not writ"):
        CORRIDOR.begin(_problem(World(Corridor()), range(1), native="on"))
    with caplog.at_level(logging.WARNING, "edtorch"):
        _searched(
            replace(CORRIDOR, every=2.0), _problem(World(Corridor()), range(1), native="auto")
        )
    assert "ticks of Sarsa are uncompiled, many times slower: there is no kernel" in caplog.text


@pytest.mark.parametrize(
    ("argument", "wanted"),
    [
        ({"tables": {}}, "tables={}: expected one or more"),
        ({"tables": {"cells": {}}}, "tables.cells={}: expected edges"),
        ({"tables": {"cells": {"cell": [2.0, 1.0]}}}, r"tables.cells.cell=\[2.0, 1.0\]: expected"),
        ({"tables": {"cells": {"cell": []}}}, r"tables.cells.cell=\[\]: expected finite edges"),
        ({"rates": {}}, "rates={}: expected one for each of the tables cells"),
        ({"rates": {"cells": 0.0}}, "rates.cells=0.0: expected a number in"),
        ({"actions": {}}, "actions={}: expected values"),
        ({"actions": {"side": [1.0, 1.0]}}, r"actions.side=\[1.0, 1.0\]: expected finite values"),
        ({"discount": 1.0}, r"discount=1.0: expected a number in \[0, 1\)"),
        ({"trace": 1.1}, "trace=1.1: expected a number in"),
        ({"forget": 0.0}, "forget=0.0: expected a number in"),
        ({"exploration": -0.1}, "exploration=-0.1: expected"),
        ({"failure": math.nan}, "failure=nan: expected a finite number"),
        ({"every": 0.0}, "every=0.0: expected a finite number above 0"),
    ],
)
def test_refuses(argument: dict[str, Any], wanted: str) -> None:
    with pytest.raises(ValueError, match=wanted):
        replace(CORRIDOR, **argument)


@pytest.mark.parametrize(
    ("argument", "wanted"),
    [
        (
            {"tables": {"cells": {"nowhere": [0.0]}}},
            r"tables.cells.nowhere=\[0.0\]: expected a component of corridor: cell",
        ),
        ({"actions": {"front": [0.0]}}, "expected values of side, and no other"),
        ({"actions": {"side": [0.0, 3.0]}}, r"actions.side=\[0.0, 3.0\]: expected values from -1"),
    ],
)
def test_refuses_for_a_domain(argument: dict[str, Any], wanted: str) -> None:
    with pytest.raises(ValueError, match=wanted):
        replace(CORRIDOR, **argument).begin(_problem(World(Corridor()), range(1)))
