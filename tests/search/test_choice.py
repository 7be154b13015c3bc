"""The choice among imagined courses."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from edtorch.search.choice import choose
from edtorch.search.imagination import Imagined


def _imagined(ends: list[float], costs: list[float]) -> Imagined:
    state = np.zeros((len(ends), 3, 1))
    state[:, -1, 0] = ends
    return Imagined(state, np.array(costs), np.isfinite(costs))


def _near(states: Tensor) -> Tensor:
    return states[:, -1, 0].abs() < 1


def test_the_most_successes_win_and_then_the_cheaper() -> None:
    often, seldom = _imagined([0, 0, 9], [9.0, 9.0, 9.0]), _imagined([0, 9, 9], [1.0, 1.0, 1.0])
    cheaper = _imagined([9, 0, 0], [8.0, 9.0, 9.0])
    assert choose([seldom, often], _near).place == 1
    found = choose([seldom, often, cheaper], _near)
    assert (found.place, found.success) == (2, 2 / 3)


def test_without_a_judge_the_cheapest_wins() -> None:
    found = choose([_imagined([0, 0], [2.0, 3.0]), _imagined([9, 9], [2.0, 2.5])], None)
    assert (found.place, found.cost) == (1, 2.25) and np.isnan(found.success)


def test_what_is_not_finite_is_no_success_and_costs_as_the_dearest() -> None:
    lost = _imagined([0, np.nan, 0], [1.0, np.inf, 3.0])
    found = choose([lost], lambda states: torch.ones(len(states), dtype=torch.bool))
    assert (found.success, found.cost) == (2 / 3, 7 / 3)
    assert choose([_imagined([np.nan], [np.inf])], None).cost == np.inf
