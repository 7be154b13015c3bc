"""When a policy stabilises for good."""

from __future__ import annotations

import numpy as np
import torch

from sims.bicycle import RANDLOV, semi_implicit
from sims.bicycle.lqr import ACTION_COST, STATE_COST, linearised, regulator
from studies.stabilising import first_for_good, radii
from tests.systems import f64


def test_the_first_tick_from_which_on_it_holds() -> None:
    holds = np.array([[0, 1, 0, 1], [1, 1, 0, 0], [1, 1, 0, 1]], dtype=bool)
    assert first_for_good(holds).tolist() == [1, 0, 3, 2]


def test_the_regulator_is_stable_and_nothing_is_not() -> None:
    F, G = linearised(RANDLOV, semi_implicit, 0.01)
    gains = regulator(F, G, f64(STATE_COST), f64(ACTION_COST))
    both = torch.stack([gains, torch.zeros_like(gains)])
    upright, course = radii(F, G, both)
    assert bool((upright < 1).tolist()[0]) and bool((course < 1).tolist()[0])
    assert float(upright[1]) > 1.001
