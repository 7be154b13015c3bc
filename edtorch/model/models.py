"""Models mu~ of the next state, linear in features, in the paper's two forms.

``NextStateModel``: s' = W phi(s, a) (Fig. 1).  ``DerivativeModel``: ds/dt = W phi(s, a), integrated
by an Euler step of any length (section 4).  Both are fitted by a rule of ``edtorch.model.fit`` to
pairs (regressor phi, target y) that they make of transitions.
"""

from __future__ import annotations

from typing import NamedTuple

import torch
from torch import Tensor, nn

from edtorch.linalg import matvec
from edtorch.model.features import Affine, FeatureMap, Identity
from edtorch.types import Transition


class LinearDynamics(NamedTuple):
    """s' = s + drift s + action a + constant.

    drift ``[*batch, n, n]``, action ``[*batch, n, m]``, constant ``[*batch, n]`` or None for zero.
    The step from s is kept apart from s itself: it is small, and in float32 the sum would round it.
    """

    drift: Tensor
    action: Tensor
    constant: Tensor | None

    @property
    def state(self) -> Tensor:
        """ds'/ds = I + drift."""
        return torch.eye(self.drift.shape[-1], dtype=self.drift.dtype, device=self.drift.device) + (
            self.drift
        )


class LinearModel(nn.Module):
    """W phi(s, a), with ``weight`` W ``[n, k]`` that starts at zero.

    states n, actions m; features: a map of n + m inputs (the state, then the action);
    period ``[n]``: that of the components that are angles, 0 elsewhere, in scaled units.  The
    module is a template: a learner calls it with parameters ``[B, n, k]`` of a whole population.
    """

    period: Tensor
    turns_per_unit: Tensor

    def __init__(self, states: int, actions: int, features: FeatureMap, period: Tensor) -> None:
        super().__init__()
        if features.inputs != states + actions:
            raise ValueError(
                f"the model's feature map takes {features.inputs} inputs, expected "
                f"{states} states + {actions} actions = {states + actions}"
            )
        if period.shape != (states,):
            raise ValueError(f"period has shape {tuple(period.shape)}, expected ({states},)")
        self.states = states
        self.actions = actions
        self.features = features
        self.weight = nn.Parameter(torch.zeros(states, features.outputs, dtype=period.dtype))
        self.register_buffer("period", period, persistent=False)
        circular = period > 0
        per_unit = torch.where(circular, 1 / torch.where(circular, period, 1.0), 0.0)
        self.register_buffer("turns_per_unit", per_unit, persistent=False)

    def regressor(self, transition: Transition) -> Tensor:
        """phi(s, a) of a transition, ``[*batch, k]``."""
        return self.features(torch.cat([transition.state, transition.action], dim=-1))

    def output(self, state: Tensor, action: Tensor) -> Tensor:
        """W phi(s, a), ``[*batch, n]``."""
        return matvec(self.weight, self.features(torch.cat([state, action], dim=-1)))

    def displacement(self, transition: Transition) -> Tensor:
        """s' - s, ``[*batch, n]``, the short way round the circle where a component is an angle."""
        difference = transition.next_state - transition.state
        return difference - self.period * torch.round(difference * self.turns_per_unit)

    def _linear_parts(self, weight: Tensor) -> tuple[Tensor, Tensor, Tensor | None] | None:
        """What multiplies state, action and 1 in W phi, if nothing else does."""
        constant = None
        if isinstance(self.features, Affine):
            constant, weight = weight[..., 0], weight[..., 1:]
        elif not isinstance(self.features, Identity):
            return None
        return weight[..., : self.states], weight[..., self.states :], constant


class DerivativeModel(LinearModel):
    """ds/dt = W phi(s, a) (section 4); rates and noise are per second."""

    def time_unit(self, dt: Tensor) -> Tensor:
        """What a rate of the configuration is multiplied with in one update: the seconds."""
        return dt

    def target(self, transition: Transition) -> Tensor:
        """(s' - s) / dt, ``[*batch, n]`` per second."""
        return self.displacement(transition) / transition.dt

    def forward(self, state: Tensor, action: Tensor, dt: float) -> Tensor:
        """mu~: one Euler step of ``dt`` seconds, s + dt W phi(s, a), ``[*batch, n]``."""
        return state + dt * self.output(state, action)

    def change(self, weight: Tensor, phi: Tensor, state: Tensor, dt: Tensor) -> Tensor:
        """mu~ - s a tick of ``dt`` seconds later, dt W phi, ``[*batch, n]``."""
        return dt * matvec(weight, phi)

    def noise_over(self, noise: Tensor, dt: float) -> Tensor:
        """Covariance that ``noise`` (per second) adds in ``dt`` seconds."""
        return noise * dt

    def residual_noise(self, residual: Tensor, dt: Tensor) -> Tensor:
        """Step 2 of Fig. 1: e e' dt, squared error per second, ``[*batch, n, n]``."""
        return residual.unsqueeze(-1) * residual.unsqueeze(-2) * dt

    def linear_dynamics(self, weight: Tensor, dt: float | Tensor) -> LinearDynamics | None:
        """dt W where the features are the variables themselves (and perhaps 1), else None."""
        parts = self._linear_parts(weight)
        if parts is None:
            return None
        state, action, constant = parts
        return LinearDynamics(dt * state, dt * action, None if constant is None else dt * constant)


class NextStateModel(LinearModel):
    """s' = W phi(s, a) (Fig. 1); rates and noise are per step, and the unroll steps by the tick."""

    def time_unit(self, dt: Tensor) -> Tensor:
        """What a rate of the configuration is multiplied with in one update: 1."""
        return torch.ones_like(dt)

    def target(self, transition: Transition) -> Tensor:
        """s', ``[*batch, n]``, counted on from s where a component is an angle."""
        return transition.state + self.displacement(transition)

    def forward(self, state: Tensor, action: Tensor, dt: float) -> Tensor:
        """mu~: the next state, W phi(s, a), ``[*batch, n]``; ``dt`` does not enter."""
        return self.output(state, action)

    def change(self, weight: Tensor, phi: Tensor, state: Tensor, dt: Tensor) -> Tensor:
        """mu~ - s a step later, W phi - s, ``[*batch, n]``."""
        return matvec(weight, phi) - state

    def noise_over(self, noise: Tensor, dt: float) -> Tensor:
        """Covariance that ``noise`` (per step) adds in one step."""
        return noise

    def residual_noise(self, residual: Tensor, dt: Tensor) -> Tensor:
        """Step 2 of Fig. 1: (s' - mu~)(s' - mu~)', ``[*batch, n, n]``."""
        return residual.unsqueeze(-1) * residual.unsqueeze(-2)

    def linear_dynamics(self, weight: Tensor, dt: float | Tensor) -> LinearDynamics | None:
        """W where the features are the variables themselves (and perhaps 1), else None."""
        parts = self._linear_parts(weight)
        if parts is None:
            return None
        state, action, constant = parts
        identity = torch.eye(self.states, dtype=weight.dtype, device=weight.device)
        return LinearDynamics(state - identity, action, constant)


Model = DerivativeModel | NextStateModel
"""Either form."""
