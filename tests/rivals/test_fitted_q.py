"""Against the optimal values of a walk, and the trees' own library."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch

from edtorch.rivals import fitted_q
from edtorch.rivals.base import Storing
from edtorch.rivals.batch import rewards
from edtorch.rivals.fitted_q import FittedQ, Iteration, grown
from tests.rivals.chain import ACTIONS, PLACES, Chain, every_transition, optimal_values
from tests.rivals.problems import problem

fitted_q.trees()  # imported before the tests, whose time it would count in

SETTINGS = FittedQ(
    actions=[[-1.0], [1.0]],
    steps=10,
    discount=0.9,
    reward_square={"place": -1.0},
    episodes=15,
    iterations=30,
    every=15,
    trees=3,
    smallest=2,
)


def _q(iteration: Iteration) -> torch.Tensor:
    """By place and action, for ``every_transition``."""
    return torch.from_numpy(iteration.targets).unflatten(0, (PLACES, 2))


@pytest.mark.parametrize("rebuilt", [None, 1], ids=["built anew", "leaves renewed"])
def test_it_finds_the_optimal_values(rebuilt: int | None) -> None:
    """Trees that split until a leaf holds one value are a table; Q_k is then value iteration."""
    settings = FittedQ(
        discount=0.9, reward_square={"place": -1.0}, trees=3, smallest=2, rebuilt=rebuilt
    )
    data = every_transition()
    reward = rewards(settings, Chain.spec, data)
    iteration = Iteration(settings, data, reward, ACTIONS, seed=0)
    for _ in range(8):
        iteration.advance()
    assert torch.allclose(_q(iteration), optimal_values(0.9), atol=1e-9)


def test_the_first_iterations_are_the_finite_horizons() -> None:
    """Q_1 = r, Q_2 = r + discount max r: by hand for the place before the last."""
    settings = FittedQ(discount=0.5, reward_square={"place": -1.0}, trees=2, smallest=2)
    data = every_transition()
    iteration = Iteration(settings, data, rewards(settings, Chain.spec, data), ACTIONS, seed=1)
    assert _q(iteration)[PLACES - 1].tolist() == [1 - 4, 9 - 4]
    iteration.advance()
    assert _q(iteration)[PLACES - 1].tolist() == [-3 + 0.5 * 3, 5]


def test_a_forest_predicts_as_its_library_does() -> None:
    numbers = np.random.default_rng(0)
    inputs = numbers.normal(size=(300, 4)).astype(np.float32)
    regression = fitted_q.trees().ExtraTreesRegressor(n_estimators=7, random_state=3)
    regression.fit(inputs, inputs[:, 0] * inputs[:, 1])
    fresh = numbers.normal(size=(50, 4)).astype(np.float32)
    assert np.allclose(grown(regression).predict(fresh), regression.predict(fresh), rtol=1e-12)


def _search(seeds: list[int]) -> fitted_q.FittedQSearch:
    search = SETTINGS.begin(problem(Chain(), [0.0], [0.0], seeds))
    while not all(search.done):
        search.advance([not over for over in search.done], lambda: None)
    return search


def test_the_search_walks_to_the_goal_and_a_seed_does_the_same_anywhere() -> None:
    both, alone = _search([4, 5]), _search([5])
    place = torch.arange(PLACES, dtype=torch.float64)[:, None]
    for which in (0, 1):
        acts = both.actor.action({"which": torch.full((PLACES,), which)}, place)
        assert acts.equal(ACTIONS[1].expand(PLACES, 1))
    assert both.accounts[1] == alone.accounts[0]
    assert isinstance(both, Storing)
    whole, part = both.stored(), alone.stored()
    start = int(whole["first"][1, 0])
    for name in ("feature", "threshold", "children_left", "value"):
        assert whole[name][start:].equal(part[name]), name


def test_what_is_stored_is_the_policy() -> None:
    """Walked by hand through the arrays that are saved: the same values."""
    search = _search([4])
    stored = search.stored()
    forest = search._forests[0]
    assert forest is not None
    for place in range(PLACES):
        for move in (-1.0, 1.0):
            found = []
            for first in stored["first"][0].tolist():
                node = first
                while int(stored["children_left"][node]) >= 0:
                    value = (float(place), move)[int(stored["feature"][node])]
                    side = "left" if value <= float(stored["threshold"][node]) else "right"
                    node = first + int(stored[f"children_{side}"][node])
                found.append(float(stored["value"][node]))
            expected = forest.predict(np.array([[place, move]], dtype=np.float32))[0]
            assert np.isclose(np.mean(found), expected, rtol=1e-5)


@pytest.mark.parametrize(
    ("settings", "wanted"),
    [
        ({"episodes": 0}, r"episodes=0: expected an integer >= 1"),
        ({"iterations": 0}, r"iterations=0: expected an integer >= 1"),
        ({"every": 0}, r"every=0: expected an integer >= 1"),
        ({"trees": 0}, r"trees=0: expected an integer >= 1"),
        ({"rebuilt": 0}, r"rebuilt=0: expected an integer >= 1"),
        ({"smallest": 1}, r"smallest=1: expected an integer >= 2"),
    ],
    ids=str,
)
def test_refuses_impossible_settings(settings: dict[str, Any], wanted: str) -> None:
    with pytest.raises(ValueError, match=wanted):
        FittedQ(**settings)


def test_without_the_extra_it_says_what_to_install(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(fitted_q.importlib.util, "find_spec", lambda name: None)
    with pytest.raises(ValueError, match=r"install edtorch with the extra \[rivals\]"):
        _search([0])
