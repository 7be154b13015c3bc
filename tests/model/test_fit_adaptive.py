"""Least squares that notices a change."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from edtorch.model.fit import Fit, RecursiveLeastSquares
from edtorch.model.fit_adaptive import AdaptiveLeastSquares
from edtorch.types import Parameters
from tests.systems import normal

N, K, B = 2, 3, 20
UNIT = torch.tensor(0.01, dtype=torch.float64)


def learn(
    fit: Fit, truths: list[Tensor], ticks: int, noise: float = 0.3
) -> list[tuple[Tensor, Parameters]]:
    """Weights and memory after ``ticks`` samples of each truth ``[N, K]`` in turn."""
    g = torch.Generator().manual_seed(5)
    weight = torch.zeros(B, N, K, dtype=torch.float64)
    memory = fit.initial(weight)
    found = []
    for truth in truths:
        for _ in range(ticks):
            phi = normal(g, B, K)
            y = phi @ truth.T + noise * normal(g, B, N)
            fitted = fit.update(weight, memory, phi, y, UNIT)
            weight, memory = fitted.weight, fitted.memory
        found.append((weight, memory))
    return found


def truth(seed: int) -> Tensor:
    return normal(torch.Generator().manual_seed(seed), N, K)


def test_is_least_squares_while_nothing_changes() -> None:
    # No alarm in 20 x 40 seconds of noise.
    (found, memory), (plain, _) = (
        learn(fit, [truth(1)], 4000)[0] for fit in (AdaptiveLeastSquares(), RecursiveLeastSquares())
    )
    assert float(memory["alarms"].sum()) == 0
    assert torch.allclose(found, plain, rtol=1e-9, atol=1e-12)
    # What is left of the averages is the variance of the noise.
    assert torch.allclose(memory["long"].mean(0), torch.full((N,), 0.09).double(), rtol=0.1)


def test_learns_anew_after_a_change() -> None:
    adaptive = learn(AdaptiveLeastSquares(), [truth(1), truth(2)], 2000)
    plain = learn(RecursiveLeastSquares(), [truth(1), truth(2)], 2000)
    assert float(adaptive[0][1]["alarms"].sum()) == 0
    assert bool((adaptive[1][1]["alarms"] >= 1).all())
    error = (adaptive[1][0] - truth(2)).abs().amax((-1, -2))
    assert float(error.max()) < 0.1
    # Without doubt it is in the middle between both worlds.
    assert float((plain[1][0] - truth(2)).abs().amax((-1, -2)).min()) > 0.3


def test_doubts_each_learner_alone() -> None:
    g = torch.Generator().manual_seed(0)
    fit = AdaptiveLeastSquares()
    weight = torch.zeros(2, N, K, dtype=torch.float64)
    memory = fit.initial(weight)
    for tick in range(600):
        phi = normal(g, 2, K)
        y = phi @ truth(1).T + 0.1 * normal(g, 2, N)
        if tick >= 500:
            y[1] += phi[1] @ truth(2).T
        fitted = fit.update(weight, memory, phi, y, UNIT)
        weight, memory = fitted.weight, fitted.memory
    assert memory["alarms"][0] == 0 and memory["alarms"][1] >= 1


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"prior": 0.0}, r"prior=0.0: expected a number > 0"),
        ({"slow": 6.0}, r"slow=6.0: expected a number > 0 and < fast, 5.0"),
        ({"threshold": 1.0}, r"threshold=1.0: expected a number > 1"),
        ({"doubt": 0.0}, r"doubt=0.0: expected a number > 0"),
    ],
    ids=str,
)
def test_refuses_settings_that_are_none(changes: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        AdaptiveLeastSquares(**changes)
