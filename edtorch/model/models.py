"""Models mu~ of the next state, in the paper's two forms.

``NextState``: the output y~ is the next state (Fig. 1).  ``Derivative``: it is ds/dt, integrated by
an Euler step of any length (section 4).  ``NextStateModel`` and ``DerivativeModel`` are linear in
features, y~ = W phi(s, a), and fitted by a rule of ``edtorch.model.fit`` to pairs (regressor phi,
target y) that they make of transitions; ``edtorch.model.module`` has models that are any module.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple, Protocol

import torch
from torch import Tensor, nn

from edtorch.initial import population
from edtorch.linalg import matvec
from edtorch.model.features import FeatureMap, linear_part
from edtorch.shapes import Actions, Features, Squares, States
from edtorch.types import Parameters, Transition, each_learner


class Model(Protocol):
    """mu~(s, a) with the parameters of a whole population, ``[B, ...]`` each, by any names.

    Optional members: ``linear_dynamics(parameters, dt) -> LinearDynamics | None`` where mu~ is
    linear or affine in state and action, which closed forms need (asked for by ``dynamics_of``);
    ``linear_in_parameters = True`` with the members of ``LinearModel`` for a model that rules for
    weights fit (``edtorch.model.fit``) and observers use; ``dt_per_learner = True`` where
    ``target`` and ``residual_noise`` take transitions whose dt is ``[B]``.
    """

    @property
    def states(self) -> int:
        """n."""
        ...

    @property
    def actions(self) -> int:
        """m."""
        ...

    @property
    def regressors(self) -> int:
        """k, the size of ``phi``."""
        ...

    @property
    def integrates(self) -> bool:
        """Whether rates are per second and the unroll steps by any dt; else all is per step."""
        ...

    @property
    def period(self) -> Tensor:
        """``[n]``: of the components that are angles, 0 elsewhere; dtype and device are the
        model's."""
        ...

    def initial(self, seeds: Sequence[int]) -> Parameters:
        """The first parameters, one set per seed, a function of that seed alone."""
        ...

    def phi(self, state: States, action: Actions) -> Features:
        """What a rule for nu~ knows of state and action, ``[*batch, k]``."""
        ...

    def output(self, parameters: Parameters, state: States, action: Actions) -> States:
        """y~, what is fitted to ``target``, ``[*batch, n]``."""
        ...

    def next(self, parameters: Parameters, state: States, action: Actions, dt: float) -> States:
        """mu~, the state ``[*batch, n]`` ``dt`` seconds later."""
        ...

    def target(self, transition: Transition) -> States:
        """y ``[*batch, n]``."""
        ...

    def displacement(self, transition: Transition) -> States:
        """s' - s ``[*batch, n]``, the short way round the circle where a component is an angle."""
        ...

    def time_unit(self, dt: Tensor) -> Tensor:
        """What a rate is multiplied with in one update: the seconds, or 1."""
        ...

    def noise_over(self, noise: Tensor, dt: float) -> Tensor:
        """Covariance that nu~ adds in ``dt`` seconds."""
        ...

    def residual_noise(self, residual: States, dt: Tensor) -> Squares:
        """Step 2 of Fig. 1: the squared residual ``[*batch, n, n]``, in the unit of nu~."""
        ...


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


def dynamics_of(model: Model, parameters: Parameters, dt: float | Tensor) -> LinearDynamics | None:
    """The model's linear dynamics over ``dt`` seconds, None where it has none."""
    offered = getattr(model, "linear_dynamics", None)
    return None if offered is None else offered(parameters, dt)


class Dynamics(nn.Module):
    """What all models share: sizes, and which components are angles.

    states n, actions m; period ``[n]``: that of the components that are angles, 0 elsewhere, in
    scaled units.
    """

    period: Tensor
    turns_per_unit: Tensor

    def __init__(self, states: int, actions: int, period: Tensor) -> None:
        super().__init__()
        if period.shape != (states,):
            raise ValueError(f"period has shape {tuple(period.shape)}, expected ({states},)")
        self.states = states
        self.actions = actions
        self.register_buffer("period", period, persistent=False)
        circular = period > 0
        per_unit = torch.where(circular, 1 / torch.where(circular, period, 1.0), 0.0)
        self.register_buffer("turns_per_unit", per_unit, persistent=False)

    def displacement(self, transition: Transition) -> States:
        """s' - s, ``[*batch, n]``, the short way round the circle where a component is an angle."""
        difference = transition.next_state - transition.state
        return difference - self.period * torch.round(difference * self.turns_per_unit)


class Derivative(Dynamics):
    """ds/dt = y~ (section 4); rates and noise are per second."""

    integrates = True
    dt_per_learner = True

    def time_unit(self, dt: Tensor) -> Tensor:
        """What a rate of the configuration is multiplied with in one update: the seconds."""
        return dt

    def target(self, transition: Transition) -> States:
        """(s' - s) / dt, ``[*batch, n]`` per second."""
        displacement = self.displacement(transition)
        return displacement / each_learner(transition.dt, displacement.ndim)

    def advance(self, state: States, output: States, dt: float) -> States:
        """One Euler step of ``dt`` seconds, s + dt y~, ``[*batch, n]``."""
        return state + dt * output

    def step(self, state: Tensor, output: Tensor, dt: Tensor) -> Tensor:
        """mu~ - s a tick of ``dt`` seconds later, dt y~, ``[*batch, n]``."""
        return dt * output

    def noise_over(self, noise: Tensor, dt: float) -> Tensor:
        """Covariance that ``noise`` (per second) adds in ``dt`` seconds."""
        return noise * dt

    def residual_noise(self, residual: States, dt: Tensor) -> Squares:
        """Step 2 of Fig. 1: e e' dt, squared error per second, ``[*batch, n, n]``."""
        squared = residual.unsqueeze(-1) * residual.unsqueeze(-2)
        return squared * each_learner(dt, squared.ndim)


class NextState(Dynamics):
    """s' = y~ (Fig. 1); rates and noise are per step, and the unroll steps by the tick."""

    integrates = False
    dt_per_learner = True

    def time_unit(self, dt: Tensor) -> Tensor:
        """What a rate of the configuration is multiplied with in one update: 1."""
        return torch.ones_like(dt)

    def target(self, transition: Transition) -> States:
        """s', ``[*batch, n]``, counted on from s where a component is an angle."""
        return transition.state + self.displacement(transition)

    def advance(self, state: States, output: States, dt: float) -> States:
        """The next state, y~, ``[*batch, n]``; ``dt`` does not enter."""
        return output

    def step(self, state: Tensor, output: Tensor, dt: Tensor) -> Tensor:
        """mu~ - s a step later, y~ - s, ``[*batch, n]``."""
        return output - state

    def noise_over(self, noise: Tensor, dt: float) -> Tensor:
        """Covariance that ``noise`` (per step) adds in one step."""
        return noise

    def residual_noise(self, residual: States, dt: Tensor) -> Squares:
        """Step 2 of Fig. 1: (s' - mu~)(s' - mu~)', ``[*batch, n, n]``."""
        return residual.unsqueeze(-1) * residual.unsqueeze(-2)


class LinearModel(Dynamics):
    """W phi(s, a), with ``weight`` W ``[n, k]`` that starts at zero.

    features: a map of n + m inputs (the state, then the action); the rest as in ``Dynamics``.  The
    module is a template: a learner calls it with parameters ``[B, n, k]`` of a whole population.
    """

    linear_in_parameters = True

    def __init__(self, states: int, actions: int, features: FeatureMap, period: Tensor) -> None:
        super().__init__(states, actions, period)
        if features.inputs != states + actions:
            raise ValueError(
                f"the model's feature map takes {features.inputs} inputs, expected "
                f"{states} states + {actions} actions = {states + actions}"
            )
        self.features = features
        self.weight = nn.Parameter(torch.zeros(states, features.outputs, dtype=period.dtype))

    @property
    def regressors(self) -> int:
        """k."""
        return self.features.outputs

    def initial(self, seeds: Sequence[int]) -> Parameters:
        """The template's parameters, the same for every seed: zero."""
        return population(self, len(seeds))

    def phi(self, state: States, action: Actions) -> Features:
        """phi(s, a), ``[*batch, k]``."""
        return self.features(torch.cat([state, action], dim=-1))

    def regressor(self, transition: Transition) -> Features:
        """phi(s, a) of a transition, ``[*batch, k]``."""
        return self.phi(transition.state, transition.action)

    def output(self, parameters: Parameters, state: States, action: Actions) -> States:
        """W phi(s, a), ``[*batch, n]``."""
        return matvec(parameters["weight"], self.phi(state, action))

    def linear_parts(self, weight: Tensor) -> tuple[Tensor, Tensor, Tensor | None] | None:
        """What multiplies state, action and 1 in W phi, None if anything else does."""
        part = linear_part(self.features, weight)
        if part is None:
            return None
        matrix, constant = part
        return matrix[..., : self.states], matrix[..., self.states :], constant


class DerivativeModel(LinearModel, Derivative):
    """ds/dt = W phi(s, a) (section 4); rates and noise are per second."""

    def forward(self, state: States, action: Actions, dt: float) -> States:
        """``next`` with the template's weight."""
        return self.next({"weight": self.weight}, state, action, dt)

    def next(self, parameters: Parameters, state: States, action: Actions, dt: float) -> States:
        """mu~: one Euler step of ``dt`` seconds, s + dt W phi(s, a), ``[*batch, n]``."""
        return self.advance(state, self.output(parameters, state, action), dt)

    def change(self, weight: Tensor, phi: Tensor, state: Tensor, dt: Tensor) -> Tensor:
        """mu~ - s a tick of ``dt`` seconds later, dt W phi, ``[*batch, n]``."""
        return self.step(state, matvec(weight, phi), dt)

    def linear_dynamics(self, parameters: Parameters, dt: float | Tensor) -> LinearDynamics | None:
        """dt W where the features are the variables themselves (and perhaps 1), else None."""
        parts = self.linear_parts(parameters["weight"])
        if parts is None:
            return None
        state, action, constant = parts
        return LinearDynamics(dt * state, dt * action, None if constant is None else dt * constant)


class NextStateModel(LinearModel, NextState):
    """s' = W phi(s, a) (Fig. 1); rates and noise are per step, and the unroll steps by the tick."""

    def forward(self, state: States, action: Actions, dt: float) -> States:
        """``next`` with the template's weight."""
        return self.next({"weight": self.weight}, state, action, dt)

    def next(self, parameters: Parameters, state: States, action: Actions, dt: float) -> States:
        """mu~: the next state, W phi(s, a), ``[*batch, n]``; ``dt`` does not enter."""
        return self.advance(state, self.output(parameters, state, action), dt)

    def change(self, weight: Tensor, phi: Tensor, state: Tensor, dt: Tensor) -> Tensor:
        """mu~ - s a step later, W phi - s, ``[*batch, n]``."""
        return self.step(state, matvec(weight, phi), dt)

    def linear_dynamics(self, parameters: Parameters, dt: float | Tensor) -> LinearDynamics | None:
        """W where the features are the variables themselves (and perhaps 1), else None."""
        parts = self.linear_parts(parameters["weight"])
        if parts is None:
            return None
        state, action, constant = parts
        identity = torch.eye(self.states, dtype=state.dtype, device=state.device)
        return LinearDynamics(state - identity, action, constant)
