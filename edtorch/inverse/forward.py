"""A forward model and a policy of actions in a domain with a goal (``inverse=none``): their
features, and a fast path to their value.

What an inverse model sees of accelerations, a forward model sees of actions.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import torch
from torch import Tensor

from edtorch.inverse.adjoint import Loop, adjoint
from edtorch.inverse.features import ACCELERATION, Linear
from edtorch.inverse.layout import Layout
from edtorch.inverse.policy import InversePolicy
from edtorch.inverse.unroll import by_theta, driven
from edtorch.model.features import FeatureMap
from edtorch.model.models import Model
from edtorch.policy.policies import LinearPolicy, Policy, SquashedPolicy
from edtorch.rewards import Reward, quadratic_form_of
from edtorch.transform import Transform
from edtorch.types import Parameters
from edtorch.value.unroll import Horizon, ValueGradient
from sims.base import Spec, spec_index


class Mechanical(FeatureMap):
    """Of a model: 1, sines and cosines of all angles, other positions, velocities, actions.

    Not the goal, whose derivative is 0.
    """

    def __init__(self, spec: Spec) -> None:
        layout = Layout(spec)
        linear = Linear(layout)
        super().__init__(len(spec.state) + len(spec.action), linear.outputs)
        self.layout, self._linear = layout, linear

    def forward(self, x: Tensor) -> Tensor:
        """``[*batch, N + m] -> [*batch, outputs]``, scaled states and actions."""
        state, _ = self.layout.split(x[..., : -self.layout.joints])
        return self._linear(state, ACCELERATION * x[..., -self.layout.joints :])


class Errors(FeatureMap):
    """Of a policy: z = (s, g - q, 1), the state scaled; what an inverse policy has."""

    of_observation: Tensor
    constant: Tensor

    def __init__(self, spec: Spec) -> None:
        layout = Layout(spec)
        policy = InversePolicy(layout)
        super().__init__(len(spec.state), policy.outputs)
        everything = torch.eye(len(spec.state), dtype=torch.float64)
        constant = policy.constant
        matrix = policy.regressor(*layout.split(everything)) - constant
        self.register_buffer("of_observation", matrix, persistent=False)
        self.register_buffer("constant", constant, persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        """``[*batch, N] -> [*batch, outputs]``."""
        return x @ self.of_observation.to(x) + self.constant.to(x)


@dataclass(frozen=True)
class Tracking:
    """What ``edtorch.value.unroll.Generic`` gives for this model and policy, its adjoint written
    out.

    The model is a ``DerivativeModel`` with ``Mechanical`` features, the policy linear in
    ``Errors``, squashed or not.  The reward is minus ``weight`` times the squared distance from the
    goal, which stays where it is; only the mean is unrolled.
    """

    layout: Layout
    squashed: bool
    horizon: Horizon
    weight: float
    needs_autograd: bool = False

    @cached_property
    def _policy(self) -> InversePolicy:
        return InversePolicy(self.layout, 1.0, 1.0 if self.squashed else None)

    @cached_property
    def _rows(self) -> Tensor:
        """Where the components of s are in an observation."""
        return torch.tensor(spec_index(self.layout.spec, self.layout.names))

    @cached_property
    def _angles(self) -> Tensor:
        return torch.tensor(self.layout.angles)

    @cached_property
    def _reading(self) -> Tensor:
        """phi without its 1, from (s, sin, cos, t): ``[outputs - 1, S + 2 A + n]``."""
        layout = self.layout
        size, half, angles = layout.size, layout.size // 2, len(layout.angles)
        scaled = torch.diag(1 / layout.scale)
        taken = [k for k in range(size) if k >= half or k not in layout.angles]
        waves = torch.eye(2 * angles, dtype=torch.float64)
        action = torch.eye(layout.joints, dtype=torch.float64)
        return torch.cat(
            (
                torch.nn.functional.pad(waves, (size, layout.joints)),
                torch.nn.functional.pad(scaled[taken], (0, 2 * angles + layout.joints)),
                torch.nn.functional.pad(action, (size + 2 * angles, 0)),
            )
        )

    def __call__(
        self, model: Parameters, policy: Parameters, noise: Parameters, state: Tensor
    ) -> ValueGradient:
        """See ``edtorch.value.unroll.ValuePath``."""
        here, goal = (part.unsqueeze(-2) for part in self.layout.split(state))
        # ds/dt in physical units; an Euler step, as the model's own.
        rates = model["weight"][..., self._rows, :] * self.layout.scale.to(state).unsqueeze(-1)
        step = self.horizon.dt * (rates[..., 1:] @ self._reading.to(state))
        step[..., : self.layout.size] += torch.eye(self.layout.size).to(state)
        shift = self.horizon.dt * rates[..., :1].mT
        theta = policy["weight"]
        loop = Loop(
            step, shift, *driven(self._policy, theta, goal), self._angles, bounded=self.squashed
        )
        found = adjoint(loop, here, goal, [w * self.weight for w in self.horizon.weights()])
        gradient = by_theta(self._policy, found, goal)
        return ValueGradient(found.value.squeeze(-1), {"weight": gradient})


def tracking(
    model: Model,
    policy: Policy,
    reward: Reward,
    transform: Transform,
    horizon: Horizon,
) -> Tracking | None:
    """The fast path where it holds, else None."""
    seen, sees = getattr(model, "features", None), getattr(policy, "features", None)
    parts = (
        model.integrates
        and isinstance(seen, Mechanical)
        and isinstance(sees, Errors)
        # Not a subclass, which may act otherwise.
        and type(policy) in (LinearPolicy, SquashedPolicy)
        and not transform.propagates_covariance
        and getattr(transform, "at_mean", False)
        and horizon.first_step == 1
    )
    form = quadratic_form_of(reward)
    if not parts or form is None or not form.is_plain or bool((form.action != 0).any()):
        return None
    assert isinstance(seen, Mechanical)
    cost = distance_cost(seen.layout.spec).to(form.state)
    weight = float(form.state.trace() / cost.trace())
    if not torch.allclose(form.state, weight * cost, rtol=1e-12, atol=0.0):
        return None
    return Tracking(seen.layout, type(policy) is SquashedPolicy, horizon, weight)


def distance_cost(spec: Spec) -> Tensor:
    """Q ``[N, N]``: s' Q s is the squared distance, in physical units, of the tracked components
    from their goal, s being a scaled observation."""
    lacking = torch.zeros(len(spec.goal), len(spec.state), dtype=torch.float64)
    for names, sign in ((spec.tracked, -1.0), (spec.goal, 1.0)):
        for row, place in enumerate(spec_index(spec, names)):
            lacking[row, place] = sign * spec.state[place].scale
    return lacking.mT @ lacking
