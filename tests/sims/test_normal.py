"""Normal numbers from uniform ones: against another implementation, at the ends, in any batch."""

from __future__ import annotations

import pytest
import torch

from sims.normal import normal_quantile


def test_is_the_inverse_of_the_distribution_function() -> None:
    uniform = torch.cat([torch.linspace(0, 1, 20_001)[1:-1], 10.0 ** -torch.arange(5, 16)]).double()
    assert torch.allclose(normal_quantile(uniform), torch.special.ndtri(uniform), 1e-14, 1e-15)
    assert float(normal_quantile(torch.tensor(0.5).double())) == 0


def test_is_finite_at_the_ends_and_odd() -> None:
    ends = normal_quantile(torch.tensor([0.0, 1.0]).double()).tolist()
    assert ends == pytest.approx([-8.29, 8.21], abs=0.01)
    half = torch.rand(1000, generator=torch.Generator().manual_seed(0), dtype=torch.float64) / 2
    half = (half * 2**40).round() / 2**40 + 2.0**-40  # so that 1 - half is exact
    assert torch.equal(normal_quantile(half), -normal_quantile(1 - half))


def test_same_digits_for_any_batch() -> None:
    uniform = torch.rand(40, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    alone = torch.cat([normal_quantile(uniform[k : k + 1]) for k in range(40)])
    for size in range(1, 41):
        assert torch.equal(normal_quantile(uniform[:size]), alone[:size])
    assert torch.equal(normal_quantile(uniform.reshape(8, 5).T), alone.reshape(8, 5).T)
