r"""State and model estimated together, from readings that err.

Least squares takes its regressors for exact.  Where they are readings with errors, it takes the
errors for damping, however long it learns; and the difference of two readings a tick apart is
mostly error.  What is to be found then is both, the states and the weights, and each is known as
well as the other allows.  The extended Kalman filter of the two together (Ljung, "Asymptotic
behavior of the extended Kalman filter as a parameter estimator for linear systems", 1979, with the
covariance that the product of two unknowns adds) does that tick by tick, and without errors of the
readings is recursive least squares.

Notation: s' = s + d(s, a) + w, d linear in the weights W through phi; readings y = s + e, with
w ~ N(0, Q), e ~ N(0, R).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor

from edtorch.linalg import solve_positive
from edtorch.model.models import DerivativeModel, NextStateModel, dynamics_of
from edtorch.policy.policies import bounded
from edtorch.types import Belief, Parameters


@dataclass(frozen=True)
class Filtered:
    """What a tick taught: weights ``[B, n, k]``, the filter's memory, the belief about the state,
    the regressor phi ``[B, k]``, and by how much a reading has moved the state, in the unit of the
    model's target, ``[B, n]``."""

    weight: Tensor
    memory: Parameters
    belief: Belief
    phi: Tensor
    residual: Tensor


@dataclass(frozen=True)
class JointFilter:
    """The extended Kalman filter of state and weights together.

    model: linear in features that are the state and the action themselves, and perhaps a constant
    (ValueError otherwise); deviations ``[n]``: standard deviations of the readings' errors, scaled
    units; prior: variance of each weight at first, in the model's units, squared; disturbance:
    standard deviation of what moves each component of the state beside the model, in scaled units
    per square root of a second, or per step.

    Memory beside the belief about the state, the weights being row by row one vector of n k:
    ``cross`` ``[B, n, n k]``, the covariance of state and weights, and ``cov`` ``[B, n k, n k]``,
    that of the weights.
    """

    model: DerivativeModel | NextStateModel
    deviations: Tensor
    prior: float = 2.0
    disturbance: float = 0.02
    estimates_state: ClassVar[bool] = True

    def __post_init__(self) -> None:
        if not self.prior > 0:
            raise ValueError(f"prior={self.prior}: expected a number > 0")
        if not self.disturbance > 0:
            raise ValueError(f"disturbance={self.disturbance}: expected a number > 0")
        if dynamics_of(self.model, self.model.initial([0]), 1.0) is None:
            name = type(getattr(self.model, "features", self.model)).__name__
            raise ValueError(
                f"expected model.features=identity or affine, not {name}: a model linear in state"
                " and action"
            )

    def initial(self, weight: Tensor) -> Parameters:
        """The weights are unknown, and independent of the state."""
        batch, (n, k) = weight.shape[:-2], weight.shape[-2:]
        eye = torch.eye(n * k, dtype=weight.dtype, device=weight.device)
        return {
            "cross": weight.new_zeros(*batch, n, n * k),
            "cov": (self.prior * eye).expand(*batch, n * k, n * k).clone(),
        }

    def begun(self, memory: Parameters) -> Parameters:
        """The memory at the beginning of an episode, where the state is a new one."""
        return memory | {"cross": torch.zeros_like(memory["cross"])}

    def first(self, reading: Tensor) -> Belief:
        """What the first reading ``[B, n]`` of an episode tells of the state."""
        return Belief(
            reading, torch.diag(self.deviations.square()).expand(*reading.shape, -1).clone()
        )

    def update(
        self,
        weight: Tensor,
        memory: Parameters,
        belief: Belief,
        limit: Tensor | None,
        action: Tensor,
        reading: Tensor,
        dt: Tensor,
    ) -> Filtered:
        """Predict with the action ``[B, m]`` that acted, correct by the reading ``[B, n]``.

        limit ``[B, n]``: the bounds within which the model sees the state; dt: seconds a tick.
        """
        n, k = weight.shape[-2:]
        unit = self.model.time_unit(dt)
        cross, cov = memory["cross"], memory["cov"]
        mean, phi, F = self._ahead(weight, belief.mean, limit, action, dt)
        # The Jacobian to the weights is I (x) g', g = unit phi: row i of the weights moves s_i.
        g = (unit * phi).unsqueeze(-1)
        ahead = F @ cross
        moved = ahead + (cov.unflatten(-2, (n, k)) * g.unsqueeze(-3)).sum(-2)
        crossed = (ahead.unflatten(-1, (n, k)) @ g.unsqueeze(-3)).squeeze(-1)
        own = (moved.unflatten(-1, (n, k)) @ g.unsqueeze(-3)).squeeze(-1)
        spread = F @ belief.cov @ F.mT + own + crossed.mT
        # What the product of the two errors, of weights and state, adds to mean and covariance.
        seen = _seen(belief.mean, limit)
        state = slice(k - action.shape[-1] - n, k - action.shape[-1])
        both = unit * cross.unflatten(-1, (n, k))[..., state] * seen.unsqueeze(-2).unsqueeze(-2)
        mean = mean + both.diagonal(dim1=-3, dim2=-1).sum(-1)
        of_state = unit * unit * belief.cov * seen.unsqueeze(-1) * seen.unsqueeze(-2)
        blocks = cov.unflatten(-1, (n, k)).unflatten(-3, (n, k))[..., :, state, :, state]
        squared = (blocks * of_state.unsqueeze(-2).unsqueeze(-4)).sum((-3, -1))
        # Cov(W_ij, s_l) Cov(W_ml, s_j), summed over j and l.
        mixed = torch.einsum("...lij,...jml->...im", both, both)
        spread = spread + squared + mixed
        return self._corrected(weight, mean, spread, moved, cov, phi, reading, dt)

    def _corrected(
        self,
        weight: Tensor,
        mean: Tensor,
        spread: Tensor,
        cross: Tensor,
        cov: Tensor,
        phi: Tensor,
        reading: Tensor,
        dt: Tensor,
    ) -> Filtered:
        """The filter's second half, from the prediction of the state and its covariances."""
        spread = self._disturbed(spread, dt)
        mean, innovation = self._innovation(mean, reading)
        # V^-1 (S C): what each unit of the innovation tells of state and weights.
        both = torch.cat([spread, cross], dim=-1)
        gain = solve_positive(self._innovation_cov(spread), both)
        told = (gain.mT @ innovation.unsqueeze(-1)).squeeze(-1)
        n = mean.shape[-1]
        by_state, by_weight = told[..., :n], told[..., n:]
        left = spread - spread @ gain[..., :n]
        cov = cov - cross.mT @ gain[..., n:]
        memory = {
            "cross": cross - spread @ gain[..., n:],
            "cov": 0.5 * (cov + cov.mT),
        }
        belief = Belief(mean + by_state, 0.5 * (left + left.mT))
        found = weight + by_weight.unflatten(-1, weight.shape[-2:])
        return Filtered(found, memory, belief, phi, by_state / self.model.time_unit(dt))

    def follow(
        self,
        weight: Tensor,
        belief: Belief,
        limit: Tensor | None,
        action: Tensor,
        reading: Tensor,
        dt: Tensor,
    ) -> Belief:
        """``update`` of the state alone, with weights that are taken for exact."""
        mean, _, F = self._ahead(weight, belief.mean, limit, action, dt)
        spread = self._disturbed(F @ belief.cov @ F.mT, dt)
        mean, innovation = self._innovation(mean, reading)
        gain = solve_positive(self._innovation_cov(spread), spread)
        left = spread - spread @ gain
        told = (gain.mT @ innovation.unsqueeze(-1)).squeeze(-1)
        return Belief(mean + told, 0.5 * (left + left.mT))

    def _ahead(
        self, weight: Tensor, mean: Tensor, limit: Tensor | None, action: Tensor, dt: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """The mean a tick later, phi, and F = ds'/ds ``[B, n, n]``."""
        start = mean if limit is None else bounded(mean, limit)
        phi = self.model.features(torch.cat([start, action], dim=-1))
        dynamics = self.model.linear_dynamics({"weight": weight}, dt)
        assert dynamics is not None  # checked when it was made
        eye = torch.eye(mean.shape[-1], dtype=mean.dtype, device=mean.device)
        F = eye + dynamics.drift * _seen(mean, limit).unsqueeze(-2)
        return mean + self.model.change(weight, phi, start, dt), phi, F

    def _disturbed(self, spread: Tensor, dt: Tensor) -> Tensor:
        eye = torch.eye(spread.shape[-1], dtype=spread.dtype, device=spread.device)
        return spread + self.disturbance**2 * self.model.time_unit(dt) * eye

    def _innovation_cov(self, spread: Tensor) -> Tensor:
        return spread + torch.diag(self.deviations.square())

    def _innovation(self, mean: Tensor, reading: Tensor) -> tuple[Tensor, Tensor]:
        """The mean, on the reading's turn of the circle where a component is an angle, and how far
        the reading is from it."""
        turns = torch.round((reading - mean) * self.model.turns_per_unit)
        mean = mean + turns * self.model.period
        return mean, reading - mean


def _seen(mean: Tensor, limit: Tensor | None) -> Tensor:
    """1 where the model sees a component ``[B, n]`` as it is, 0 where it sees its bound."""
    if limit is None:
        return torch.ones_like(mean)
    return (mean.abs() <= limit).to(mean.dtype)
