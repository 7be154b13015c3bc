"""The batch-proof arc tangent."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from sims.angles import atan2


def tensor(*values: float) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def test_atan2() -> None:
    angles = torch.linspace(-math.pi, math.pi, 1001, dtype=torch.float64)[1:]
    for size in (1e-3, 1.0, 1e3, 1e8):
        y, x = size * angles.sin(), size * angles.cos()
        wanted = torch.atan2(y, x)
        assert (
            float(((atan2(y, x) - wanted) / wanted.clamp(min=1e-300).abs()).abs()[501:].max())
            < 1e-15
        )
        assert float((atan2(y, x) - wanted).abs().max()) < 1e-15
    y, x = tensor(0, 1, 0, -1, -0.0, 0), tensor(1, 0, -1, 0, -1, 0)
    wanted = tensor(0, math.pi / 2, math.pi, -math.pi / 2, math.pi, 0)
    assert torch.equal(atan2(y, x), wanted)

    def by_y_and_x(y: Tensor, x: Tensor) -> Tensor:
        return atan2(y, x)

    slope = torch.func.vmap(torch.func.grad(by_y_and_x, (0, 1)))(y, x)
    assert torch.allclose(slope[0][:5], tensor(1, 0, -1, 0, -1))
    assert torch.allclose(slope[1][:5], tensor(0, -1, 0, 1, 0))
    assert bool(torch.stack(slope).isfinite().all())
    fine = atan2(y.float(), x.float())
    assert fine.dtype == torch.float32 and torch.allclose(fine.double(), wanted, atol=1e-6)
