"""The linear system: its two moments, and what it refuses."""

from __future__ import annotations

import pytest
import torch

from sims.base import Outcome
from sims.linear import LinearSystem


def test_mean_and_variance_of_a_step() -> None:
    sim = LinearSystem([[1.0, 0.1], [0.0, 0.9]], [[0.0], [0.5]], noise=0.3)
    count = 100_000
    uniforms = torch.rand(count, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    state = torch.tensor([1.0, -2.0], dtype=torch.float64).expand(count, 2)
    after = sim.step(state, torch.full((count, 1), 2.0, dtype=torch.float64), uniforms)
    error = 0.3 / count**0.5
    assert after.mean(0).tolist() == pytest.approx([0.8, -0.8], abs=5 * error)
    assert after.std(0).tolist() == pytest.approx([0.3, 0.3], rel=0.02)
    assert abs(float(torch.corrcoef(after.T)[0, 1])) < 5 / count**0.5


def test_leaving_the_box_is_failing() -> None:
    sim = LinearSystem([[1.0]], [[1.0]], start=2.0)
    outcome = sim.outcome(torch.tensor([[1999.0], [2001.0], [float("nan")]]))
    assert outcome.tolist() == [Outcome.RUNNING, Outcome.FAILED, Outcome.FAILED]


@pytest.mark.parametrize(
    ("F", "G", "more", "message"),
    [
        ([[1.0, 2.0]], [[1.0]], {}, "state_matrix=.*square"),
        ([[1.0, 2.0], [3.0]], [[1.0]], {}, "state_matrix=.*one length"),
        ([[1.0]], [[1.0], [2.0]], {}, "action_matrix=.*1 rows"),
        ([[1.0]], [1.0], {}, "action_matrix=.*rows of finite"),
        ([[1.0]], [[1.0]], {"noise": -1.0}, "noise=-1.0"),
        ([[1.0]], [[1.0]], {"start": 0.0}, "start=0.0"),
    ],
)
def test_refuses_the_impossible(F, G, more: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        LinearSystem(F, G, **more)
