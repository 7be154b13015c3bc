"""A search that goes on from the state of another one does what that would have done, by digits."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest

from edtorch.rivals import fitted_q
from edtorch.rivals.adaptive_lqr import AdaptiveLqr
from edtorch.rivals.base import Problem, Resumable, Rival, Search, Storing
from edtorch.rivals.fitted_q import FittedQ
from edtorch.rivals.lqr import Lqr
from edtorch.rivals.lspi import Lspi
from edtorch.rivals.pegasus import Pegasus
from edtorch.rivals.reinforce import Reinforce
from edtorch.rivals.sarsa import CHUNK, Sarsa
from edtorch.rivals.stable_baselines import BaselinesSearch
from edtorch.types import Parameters
from sims.bicycle import Bicycle
from sims.from_gymnasium import GymnasiumSim
from sims.linear import LinearSystem
from tests.rivals.chain import Chain
from tests.rivals.problems import pause, problem, scalar
from tests.states import read_back

fitted_q.trees()  # imported before the tests, whose time it would count in


def _bicycle() -> Problem:
    """Short rides from a small lean."""
    sim = Bicycle(time_limit=0.4)
    count = len(sim.spec.state)
    return replace(problem(sim, [0.01] * count, [0.01, 0.01], [3, 4]), native="on")


def _system() -> Problem:
    """Two states, one action, noise."""
    sim = LinearSystem(
        [[1.1, 0.3], [-0.2, 0.9]], [[0.0], [0.5]], noise=0.05, dt=0.1, time_limit=2.0
    )
    return problem(sim, [1.0, 2.0], [0.3], [0, 1, 2])


def _pendulum() -> Problem:
    """An environment with a memory of its own, in the midst of an episode."""
    return problem(GymnasiumSim("Pendulum-v1"), [1.0, 1.0, 0.1], [0.1], [5])


def _chain() -> Problem:
    return problem(Chain(), [0.0], [0.0], [4, 5])


BATCH: dict[str, Any] = {
    "actions": [[-1.0], [1.0]],
    "steps": 10,
    "discount": 0.9,
    "reward_square": {"place": -1.0},
}
TREES = FittedQ(**BATCH, episodes=6, iterations=6, every=2, trees=3, smallest=2)
SARSA = Sarsa(
    tables={
        "balance": {"lean": [-0.06, 0.0, 0.06], "lean_rate": [-0.25, 0.0, 0.25]},
        "steering": {"handlebar": [-0.2, 0.0, 0.2], "lean": [0.0]},
    },
    rates={"balance": 0.5, "steering": 0.1},
    actions={"handlebar_torque": [-2.0, 0.0, 2.0], "displacement": [-0.02, 0.02]},
    exploration=0.2,
    success=0.01,
    step=0.001,
    every=1.0,
)
SWINGING = Sarsa(
    tables={"swing": {"state_0": [0.0], "state_1": [0.0], "state_2": [-2.0, 0.0, 2.0]}},
    rates={"swing": 0.5},
    actions={"action_0": [-2.0, 2.0]},
    exploration=0.2,
    every=4.0,
)
CLIMBING = Pegasus(gradients=6, scenarios=3, horizon=3.0, longest=2.0)
NOISY = Reinforce(batch=5, updates=2, horizon=3.0)
SEARCHES: dict[str, tuple[Rival, Callable[[], Problem]]] = {
    "pegasus": (CLIMBING, scalar),
    "reinforce": (NOISY, lambda: scalar(0.1)),
    "lspi": (Lspi(**BATCH, episodes=[3, 6, 9, 12], ridge=1e-9), _chain),
    "fitted_q": (TREES, _chain),
    "fitted_q, leaves renewed": (replace(TREES, rebuilt=3), _chain),
    "sarsa": (SARSA, lambda: replace(_bicycle(), native="off")),
    "adaptive_lqr": (AdaptiveLqr(exploration=0.3, piece=1.3), _system),
    "adaptive_lqr, environment": (AdaptiveLqr(exploration=0.3, piece=4.0), _pendulum),
    "sarsa, environment": (SWINGING, _pendulum),
    "lqr": (Lqr(), scalar),
}
COMPILED: dict[str, tuple[Rival, Callable[[], Problem]]] = {
    "pegasus": (replace(CLIMBING, horizon=0.3), _bicycle),
    "reinforce": (replace(NOISY, horizon=0.3), _bicycle),
    "sarsa": (replace(SARSA, every=0.01 * (CHUNK + 7)), _bicycle),
}


def _known(search: Search) -> Parameters:
    """The policies, and the tensors that are the data of a forest."""
    whole = search.stored() if isinstance(search, Storing) and any(search.done) else {}
    return {**search.parameters, **whole}


def _assert_the_same(found: Search, wanted: Search) -> None:
    assert found.accounts == wanted.accounts
    assert found.done == wanted.done
    parameters = _known(wanted)
    assert parameters.keys() == _known(found).keys()
    for name, values in _known(found).items():
        assert values.equal(parameters[name]), name


def _check(rival: Rival, asked: Callable[[], Problem], pieces: int) -> None:
    """With a break after every piece, in which all but the state is lost."""
    whole, begun = rival.begin(asked()), rival.begin(asked())
    for number in range(pieces):
        assert isinstance(begun, Resumable)
        state = read_back(begun.state())
        begun = rival.begin(asked())
        assert isinstance(begun, Resumable)
        begun.restore(state)
        _assert_the_same(begun, whole)
        # The seeds do not all go on for equally long.
        skipped = [0] if number == 1 else []
        going = [not over and row not in skipped for row, over in enumerate(whole.done)]
        for search in (whole, begun):
            search.advance(going, pause)
        _assert_the_same(begun, whole)
    assert any(account.seconds > 0 for account in whole.accounts) or isinstance(rival, Lqr)


@pytest.mark.parametrize("name", SEARCHES)
def test_it_goes_on_as_if_nothing_had_been(name: str) -> None:
    _check(*SEARCHES[name], pieces=3)


@pytest.mark.experiment
@pytest.mark.parametrize("name", COMPILED)
def test_it_goes_on_in_kernels(name: str) -> None:
    _check(*COMPILED[name], pieces=3)


def test_a_break_shows_where_something_is_missing() -> None:
    """What would be seen if a generator, a trace or a record were not part of the state."""
    rival, asked = SEARCHES["sarsa"]
    whole, begun = rival.begin(asked()), rival.begin(asked())
    whole.advance([True, True], pause)
    assert isinstance(whole, Resumable) and isinstance(begun, Resumable)
    state = read_back(whole.state())
    state["memory"]["trace"].zero_()
    begun.restore(state)
    for search in (whole, begun):
        search.advance([True, True], pause)
    assert not whole.parameters["table"].equal(begun.parameters["table"])


def test_stable_baselines_does_not_hold_its_state() -> None:
    assert not issubclass(BaselinesSearch, Resumable)
