"""Values that are to be followed."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch

from edtorch.rewards.reference import reference_values


def test_a_wave_has_its_values_in_time() -> None:
    found = reference_values({"amplitude": 2.0, "period": 4.0}, 8, 0.5)
    expected = [2 * math.sin(math.pi / 2 * 0.5 * t) for t in range(9)]
    assert torch.allclose(found, torch.tensor(expected).double(), atol=1e-12)


def test_the_last_of_given_values_stays() -> None:
    assert reference_values([1, 2.5], 4, 0.1).tolist() == [1, 2.5, 2.5, 2.5, 2.5]
    assert reference_values((3, 2, 1), 1, 0.1).tolist() == [3, 2]


@pytest.mark.parametrize(
    ("told", "words"),
    [
        ({"amplitude": 1.0, "period": 0.0}, "period > 0"),
        ({"amplitude": 1.0}, "expected amplitude and period, or a list"),
        ("sine", "reference=sine: expected amplitude and period"),
        ([1.0, math.nan], "finite"),
    ],
)
def test_other_references_are_refused(told: Any, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        reference_values(told, 3, 0.1)
