"""Noise as the transforms take it: nu_pi, a function of the state."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from edtorch.derivatives import StateFunction


@dataclass(frozen=True)
class ConstantNoise:
    """nu_pi(s) = cov, wherever s is.

    cov ``[*batch, n, n]``, positive semidefinite, per step, in squared units of the state.
    """

    cov: Tensor
    positive = True
    constant = True

    def __call__(self, state: Tensor) -> Tensor:
        """``[*more, *batch, n] -> [*more, *batch, n, n]``."""
        return self.cov.expand(*state.shape, state.shape[-1])


@dataclass(frozen=True)
class PositiveNoise:
    """A function nu_pi ``[*batch, n] -> [*batch, n, n]`` vouched for: every value a covariance."""

    function: StateFunction
    positive = True

    def __call__(self, state: Tensor) -> Tensor:
        """The function's value."""
        return self.function(state)


def is_positive(noise: StateFunction) -> bool:
    """Whether a noise function declares (``positive = True``) that all its values are covariances.

    One that declares nothing is not believed: the unroll then watches the eigenvalues at every
    step, which ``PositiveNoise`` saves.
    """
    return bool(getattr(noise, "positive", False))


def is_constant(noise: StateFunction) -> bool:
    """Whether a noise function declares (``constant = True``) that it is the same everywhere."""
    return bool(getattr(noise, "constant", False))
