"""Elementary functions of kernels: those of torch, to the last digits."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from sims.elementary import functions

RANDOM = np.random.default_rng(0)
ANGLES = (
    RANDOM.uniform(-7, 7, 500),
    RANDOM.uniform(-1e8, 1e8, 500),
    np.arange(-9, 10) * np.pi / 4,
    10.0 ** RANDOM.uniform(-300, 0, 100),
)
ARGUMENTS = {
    "sin": np.concatenate(ANGLES),
    "cos": np.concatenate(ANGLES),
    "atan": np.concatenate([RANDOM.uniform(-4, 4, 500), 10.0 ** RANDOM.uniform(-300, 300, 500)]),
    "asin": np.concatenate([RANDOM.uniform(-1, 1, 500), 1 - 10.0 ** RANDOM.uniform(-16, 0, 200)]),
}
SPECIAL = {
    "sin": [np.inf, np.nan, 0.0],
    "cos": [-np.inf, np.nan, 0.0],
    "atan": [np.inf, -np.inf, np.nan, 0.0],
    "asin": [1.0, -1.0, 1.1, np.nan, 0.0],
}


@pytest.mark.parametrize("name", ARGUMENTS)
def test_elementary_functions(name: str) -> None:
    """Within three units in the last place, at zeros of sine and cosine as well; exceptional
    arguments exactly."""
    function = functions(lambda f: f)[name]
    with np.errstate(all="ignore"):
        found = torch.tensor([function(x) for x in ARGUMENTS[name]], dtype=torch.float64)
        special = torch.tensor([function(np.float64(x)) for x in SPECIAL[name]])
    wanted = getattr(torch, name)(torch.from_numpy(ARGUMENTS[name]))
    torch.testing.assert_close(found, wanted, rtol=7e-16, atol=0)
    of_special = getattr(torch, name)(torch.tensor(SPECIAL[name], dtype=torch.float64))
    assert special.nan_to_num(nan=9.0).equal(of_special.nan_to_num(nan=9.0))


def test_a_huge_angle_stays_finite() -> None:
    """Beyond 1e15 neighbouring numbers are an eighth of a radian apart: it counts as zero."""
    own = functions(lambda f: f)
    assert [own["sin"](1e300), own["cos"](-1e300)] == [0.0, 1.0]
    assert abs(own["sin"](9e14)) <= 1.2
