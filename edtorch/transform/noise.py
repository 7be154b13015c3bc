"""Noise covariance nu_pi as a function of the state, as the transforms take it."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from edtorch.derivatives import StateFunction
from edtorch.shapes import Squares, States


@dataclass(frozen=True)
class ConstantNoise:
    """nu_pi(s) = cov for every state s.

    cov ``[*batch, n, n]``, positive semidefinite, per step, in squared units of the state.
    """

    cov: Tensor
    positive = True
    constant = True

    def __call__(self, state: States) -> Squares:
        """``[*more, *batch, n] -> [*more, *batch, n, n]``."""
        return self.cov.expand(*state.shape, state.shape[-1])


@dataclass(frozen=True)
class PositiveNoise:
    """A function nu_pi ``[*batch, n] -> [*batch, n, n]``, all of whose values are covariances."""

    function: StateFunction
    positive = True

    def __call__(self, state: States) -> Squares:
        """The function's value."""
        return self.function(state)


def is_positive(noise: StateFunction) -> bool:
    """Whether a noise function declares (``positive = True``) that all its values are covariances.

    Without that declaration the unroll checks the eigenvalues at every step; ``PositiveNoise``
    avoids it.
    """
    return bool(getattr(noise, "positive", False))


def is_constant(noise: StateFunction) -> bool:
    """Whether a noise function declares (``constant = True``) that it is the same everywhere."""
    return bool(getattr(noise, "constant", False))
