"""A decaying fit against the sum of its rates."""

from __future__ import annotations

import pytest
import torch

from edtorch.model.fit import AbsoluteError, SquaredError
from edtorch.model.fit_decaying import DecayingFit


def test_the_rate_is_divided_by_one_plus_time_over_decay() -> None:
    """W = sum_k rate unit / (1 + k unit / decay) phi', as long as y is out of reach."""
    rule = DecayingFit(AbsoluteError(0.5), 0.3)
    weight = torch.zeros(2, 3, 4, dtype=torch.float64)
    phi = torch.rand(2, 4, generator=torch.Generator().manual_seed(0), dtype=torch.float64)
    memory, unit = rule.initial(weight), torch.tensor(0.1, dtype=torch.float64)
    y = torch.full((2, 3), 1e6, dtype=torch.float64)
    for _ in range(20):
        fitted = rule.update(weight, memory, phi, y, unit)
        weight, memory = fitted.weight, fitted.memory
    rates = sum(0.5 * 0.1 / (1 + k * 0.1 / 0.3) for k in range(20))
    torch.testing.assert_close(weight, (rates * phi).unsqueeze(-2).expand(2, 3, 4))
    torch.testing.assert_close(memory["learned"], torch.full((2,), 2.0, dtype=torch.float64))


def test_it_comes_to_rest_where_a_constant_rate_does_not() -> None:
    """The mean of noisy samples, by the last of ten thousand."""
    generator = torch.Generator().manual_seed(1)
    y = 3 + torch.randn(10_000, generator=generator, dtype=torch.float64)
    errors = []
    for rule in (SquaredError(0.5), DecayingFit(SquaredError(0.5), 2.0)):
        weight, unit = torch.zeros(1, 1, dtype=torch.float64), torch.tensor(1.0)
        memory = rule.initial(weight)
        for sample in y:
            fitted = rule.update(weight, memory, torch.ones(1).double(), sample.view(1), unit)
            weight, memory = fitted.weight, fitted.memory
        errors.append(abs(float(weight) - 3))
    constant, decaying = errors
    assert decaying < 0.05 < constant


def test_refuses_a_decay_that_is_none() -> None:
    with pytest.raises(ValueError, match=r"^decay=0"):
        DecayingFit(AbsoluteError(1.0), 0.0)
