r"""Value and gradient when what the model does not know counts as noise.

``BayesianNoise`` makes nu~ quadratic in the state: along a linear policy the features are K s with
K = (I; theta) (s being (1, s) where something is constant, see ``edtorch.value.linear.loop``), so
that over one step nu_pi(s) = nu (1 + c s'H s), H = K'P K.  A transform that averages nu_pi over the
belief sees E[s'H s] = tr(H X) with X the second moment (``averaged``: second order and cubature,
both exact for quadratics); the paper's first order takes nu_pi at the mean m (``at_mean``).  With
Z = X or m m' and q = tr(H Z),

    X_{tau+1} = A X_tau A' + nu (1 + c q_tau),  V = -sum_tau w_tau tr(C X_tau),

and adjoint Lambda (of X) and lambda (of m), g_tau = c tr(Lambda_{tau+1} nu):

    Lambda_tau = w_tau C + A' Lambda_{tau+1} A  (+ g_tau H if averaged),
    lambda_tau = A' lambda_{tau+1} + 2 g_tau H m_tau  (at the mean),
    dV/dA = -2 sum Lambda_{tau+1} A X_tau  (- sum lambda_{tau+1} m_tau' at the mean),
    dV/dtheta = G' dV/dA - 2 R theta sum w_tau X_tau - 2 sum g_tau (P K Z_tau) [rows of the
    actions].
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from edtorch.model.models import Model
from edtorch.model.noise import QuadraticNoise
from edtorch.policy.policies import GainedPolicy
from edtorch.types import Belief, Parameters
from edtorch.value.linear.loop import closed, linear_loop, loop_cost, priced_actions
from edtorch.value.unroll import Horizon, ValueGradient


@dataclass(frozen=True)
class UncertainLoop:
    """A linear loop under ``BayesianNoise``, all for a batch of B.

    A ``[B, N, N]``; features K ``[B, k, N]``, phi = K s along the policy; nu ``[B, N, N]`` over one
    step; P ``[B, k, k]``; c: the stretch; cost C ``[B, N, N]``, the policy's part included.
    """

    A: Tensor
    features: Tensor
    nu: Tensor
    P: Tensor
    stretch: float
    cost: Tensor


def _trace(a: Tensor, b: Tensor) -> Tensor:
    """tr(a b) of symmetric matrices, ``[B, 1, 1]``."""
    return (a * b).sum((-1, -2), keepdim=True)


def _outer(vector: Tensor) -> Tensor:
    return vector.unsqueeze(-1) * vector.unsqueeze(-2)


@dataclass(frozen=True)
class Passes:
    """What a forward and a backward pass found: X_1..X_T weighted, dV/dA, sum of g_tau Z_tau."""

    weighted: Tensor
    through: Tensor
    ignorance: Tensor


def averaged(loop: UncertainLoop, start: Belief, weights: Sequence[float]) -> Passes:
    """nu_pi averaged over the belief."""
    A, K = loop.A, loop.features
    H = K.mT @ loop.P @ K
    moments = [_outer(start.mean) + start.cov]
    for _ in weights:
        grown = loop.nu * (1 + loop.stretch * _trace(H, moments[-1]))
        moments.append(torch.baddbmm(grown, A @ moments[-1], A.mT))
    adjoint = torch.zeros_like(loop.cost)
    through = torch.zeros_like(A)
    ignorance = torch.zeros_like(A)
    for tau in range(len(weights) - 1, -1, -1):
        # Here ``adjoint`` is that of X_{tau + 1}, its own cost still to be added.
        adjoint = adjoint + weights[tau] * loop.cost
        g = loop.stretch * _trace(adjoint, loop.nu)
        through = through - 2 * adjoint @ A @ moments[tau]
        ignorance = ignorance + g * moments[tau]
        adjoint = A.mT @ adjoint @ A + g * H
    weighted = sum((w * X for w, X in zip(weights, moments[1:], strict=True)), torch.zeros_like(A))
    return Passes(weighted, through, ignorance)


def at_mean(loop: UncertainLoop, start: Belief, weights: Sequence[float]) -> Passes:
    """nu_pi at the mean of the belief: first order."""
    A, K = loop.A, loop.features
    H = K.mT @ loop.P @ K
    means = [start.mean.unsqueeze(-1)]
    moments = [_outer(start.mean) + start.cov]
    for _ in weights:
        here = means[-1]
        grown = loop.nu * (1 + loop.stretch * (here.mT @ H @ here))
        moments.append(torch.baddbmm(grown, A @ moments[-1], A.mT))
        means.append(A @ here)
    adjoint = torch.zeros_like(loop.cost)
    pull = torch.zeros_like(means[0])
    through = torch.zeros_like(A)
    ignorance = torch.zeros_like(A)
    for tau in range(len(weights) - 1, -1, -1):
        adjoint = adjoint + weights[tau] * loop.cost
        g = loop.stretch * _trace(adjoint, loop.nu)
        through = through - 2 * adjoint @ A @ moments[tau] - pull @ means[tau].mT
        ignorance = ignorance + g * (means[tau] @ means[tau].mT)
        pull = A.mT @ pull + 2 * g * (H @ means[tau])
        adjoint = A.mT @ adjoint @ A
    weighted = sum((w * X for w, X in zip(weights, moments[1:], strict=True)), torch.zeros_like(A))
    return Passes(weighted, through, ignorance)


NoisePasses = Callable[[UncertainLoop, Belief, Sequence[float]], Passes]
"""``averaged`` or ``at_mean``."""


@dataclass(frozen=True)
class LinearIgnorance:
    """A ``ValuePath`` for linear model and policy, quadratic reward and Bayesian noise.

    passes: ``averaged`` or ``at_mean``, as the transform takes the noise; costs as in
    ``edtorch.value.linear.loop.loop_cost``; the rest as in ``LinearMoment``.
    """

    model: Model
    policy: GainedPolicy
    horizon: Horizon
    noise: QuadraticNoise
    start_cov: Tensor
    passes: NoisePasses
    state_cost: Tensor
    action_cost: Tensor | None
    cross: Tensor | None = None
    augmented: bool = False
    needs_autograd: bool = False

    def __call__(
        self, model: Parameters, policy: Parameters, noise: Parameters, state: Tensor
    ) -> ValueGradient:
        """See ``edtorch.value.unroll.ValuePath``; ValueError if the closed loop is not linear."""
        linear = linear_loop(
            self.model, self.policy, model, policy, self.horizon.dt, self.augmented
        )
        theta, shape = linear.theta, linear.drift.shape
        cost = loop_cost(self.state_cost, self.action_cost, self.cross, theta)
        # What the model's features have of (1, s) or s: all but the last m, which are the actions.
        seen = noise["P"].shape[-1] - theta.shape[-2]
        rows = torch.eye(shape[-1], dtype=cost.dtype, device=cost.device)[shape[-1] - seen :]
        loop = UncertainLoop(
            closed(linear.drift, linear.G, theta),
            torch.cat([rows.expand(shape[0], *rows.shape), theta], dim=-2),
            linear.square(self.model.noise_over(noise["nu"], self.horizon.dt)),
            noise["P"],
            self.noise.stretch,
            cost,
        )
        start = Belief(linear.start(state), linear.square(self.start_cov).expand(shape))
        found = self.passes(loop, start, self.horizon.weights())
        gradient = linear.G.mT @ found.through
        known = loop.P @ loop.features @ found.ignorance
        gradient = gradient - 2 * known[..., seen:, :]
        gradient = priced_actions(gradient, self.action_cost, self.cross, theta, found.weighted)
        value = -(cost * found.weighted).sum((-1, -2))
        return ValueGradient(value, self.policy.of_gain(linear.gain(gradient)))
