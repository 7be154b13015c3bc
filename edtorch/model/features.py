"""Feature maps phi: ``[*batch, d] -> [*batch, k]``, what models and policies are linear in.

A map knows its sizes (``inputs`` d, ``outputs`` k), so that weights can be laid out before the
first state is seen.  ``Identity`` is the paper's choice for the bicycle ("the features were simply
the state and action variables themselves", section 4).
"""

from __future__ import annotations

import math
from typing import NamedTuple

import torch
from jaxtyping import Float
from torch import Tensor, nn

from edtorch.shapes import Features


class LinearPart(NamedTuple):
    """W phi(x) = matrix x + constant: ``[*batch, p, d]``, and ``[*batch, p]`` or None for zero."""

    matrix: Tensor
    constant: Tensor | None


class FeatureMap(nn.Module):
    """Base of all feature maps; ``inputs`` d and ``outputs`` k are fixed at construction."""

    inputs: int
    outputs: int

    def __init__(self, inputs: int, outputs: int) -> None:
        super().__init__()
        if inputs < 1:
            raise ValueError(f"inputs={inputs}: a feature map needs at least one input")
        self.inputs = inputs
        self.outputs = outputs

    def linear_part(self, weight: Tensor) -> LinearPart | None:
        """W phi as a linear function of x, weight W ``[*batch, p, k]``; None where it is none."""
        return None


class Identity(FeatureMap):
    """phi(x) = x."""

    def __init__(self, inputs: int) -> None:
        super().__init__(inputs, inputs)

    def forward(self, x: Features) -> Float[Tensor, "*batch p"]:
        """``[*batch, d] -> [*batch, d]``."""
        return x

    def linear_part(self, weight: Tensor) -> LinearPart:
        """W itself."""
        return LinearPart(weight, None)


class Affine(FeatureMap):
    """phi(x) = (1, x)."""

    def __init__(self, inputs: int) -> None:
        super().__init__(inputs, inputs + 1)

    def forward(self, x: Features) -> Float[Tensor, "*batch p"]:
        """``[*batch, d] -> [*batch, 1 + d]``."""
        return torch.cat([torch.ones_like(x[..., :1]), x], dim=-1)

    def linear_part(self, weight: Tensor) -> LinearPart:
        """The first column of W is the constant."""
        return LinearPart(weight[..., 1:], weight[..., 0])


class Pairwise(FeatureMap):
    """phi(x) = (1, x, all products x_i x_j with i <= j): polynomials of degree two."""

    first: Tensor
    second: Tensor

    def __init__(self, inputs: int) -> None:
        super().__init__(inputs, 1 + inputs + inputs * (inputs + 1) // 2)
        first, second = torch.triu_indices(inputs, inputs)
        self.register_buffer("first", first, persistent=False)
        self.register_buffer("second", second, persistent=False)

    def forward(self, x: Features) -> Float[Tensor, "*batch p"]:
        """``[*batch, d] -> [*batch, 1 + d + d (d + 1) / 2]``."""
        products = x[..., self.first] * x[..., self.second]
        return torch.cat([torch.ones_like(x[..., :1]), x, products], dim=-1)


class Trigonometric(FeatureMap):
    """phi(x) = (1, x, sin(pi x), cos(pi x)): angles scaled to half a turn keep their circle."""

    def __init__(self, inputs: int) -> None:
        super().__init__(inputs, 1 + 3 * inputs)

    def forward(self, x: Features) -> Float[Tensor, "*batch p"]:
        """``[*batch, d] -> [*batch, 1 + 3 d]``."""
        angle = math.pi * x
        return torch.cat([torch.ones_like(x[..., :1]), x, angle.sin(), angle.cos()], dim=-1)


class RandomFourier(FeatureMap):
    """phi(x) = (1, x, sqrt(2 / K) cos(omega x + b)), omega ~ N(0, 1 / lengthscale^2).

    The phases b are uniform on the circle.
    The cosines' inner products approach a squared-exponential kernel (Rahimi & Recht, 2007).
    """

    frequency: Tensor
    phase: Tensor

    def __init__(
        self, inputs: int, count: int, lengthscale: float, generator: torch.Generator
    ) -> None:
        if count < 1:
            raise ValueError(f"count={count}: random Fourier features need at least one")
        if not lengthscale > 0:
            raise ValueError(f"lengthscale={lengthscale}: expected a positive number")
        super().__init__(inputs, 1 + inputs + count)
        normal = torch.randn(count, inputs, generator=generator, dtype=torch.float64)
        uniform = torch.rand(count, generator=generator, dtype=torch.float64)
        self.register_buffer("frequency", normal / lengthscale)
        self.register_buffer("phase", 2 * math.pi * uniform)

    def forward(self, x: Features) -> Float[Tensor, "*batch p"]:
        """``[*batch, d] -> [*batch, 1 + d + K]``."""
        angle = (x.unsqueeze(-2) * self.frequency.to(x)).sum(-1) + self.phase.to(x)
        waves = angle.cos() * math.sqrt(2 / self.phase.shape[0])
        return torch.cat([torch.ones_like(x[..., :1]), x, waves], dim=-1)


def linear_part(features: nn.Module, weight: Tensor) -> LinearPart | None:
    """``features.linear_part(weight)``, None for a map that does not offer it."""
    offered = getattr(features, "linear_part", None)
    return None if offered is None else offered(weight)
