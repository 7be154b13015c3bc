r"""The error of mean, covariance, reward and value along a first-order unroll (Theorems 1-4)."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from edtorch.bounds.constants import (
    NO_MODEL_ERROR,
    Constants,
    ModelError,
    NoiseLaw,
    NonSmoothDynamics,
)
from edtorch.bounds.moments import StartLaw
from edtorch.bounds.path import Path
from edtorch.bounds.result import ErrorBounds, Standing
from edtorch.bounds.step import Remainders, StepErrors, StepNorms, StepRule, known, spectral
from edtorch.bounds.theorems import reward_remainder
from edtorch.value.unroll import Horizon


def definition_weights(discount: float, steps: int) -> list[float]:
    """1, gamma, ..., gamma^n: section 3's definition of V, n + 1 rewards from the start on."""
    return [discount**k for k in range(steps + 1)]


def horizon_weights(horizon: Horizon) -> list[float]:
    """Weight of the expected reward of each belief 0..T in the horizon's value.

    Fig. 1's step 6d adds up the rewards of steps 1..T; that of the start weighs 0.
    """
    weights = horizon.weights()
    return [0.0] * (horizon.steps + 1 - len(weights)) + weights


class Propagators:
    """J_t ... J_{k+1} for every k below t, and J_t ... J_0: how past remainders reach step t + 1.

    Sums over them are often smaller than the step-wise product of |J|_2.
    """

    def __init__(self, n: int, start: StepErrors) -> None:
        self.products = torch.eye(n, dtype=torch.float64).unsqueeze(0)
        self.sources = [Remainders(start.mean, start.cov)]

    def carry(self, jacobian: Tensor, added: Remainders) -> Remainders:
        """The sums at step t + 1, after J_t ``[n, n]`` and the remainders of step t."""
        moved = jacobian @ self.products
        identity = torch.eye(jacobian.shape[-1], dtype=jacobian.dtype).unsqueeze(0)
        self.products = torch.cat([moved, identity])
        self.sources.append(added)
        gains = spectral(self.products).tolist()
        pairs = list(zip(gains, self.sources, strict=True))
        return Remainders(
            known(sum(gain * source.mean for gain, source in pairs)),
            known(sum(gain * gain * source.cov for gain, source in pairs)),
        )


def adjoint_value_bound(
    path: Path,
    weights: Sequence[float],
    start: StepErrors,
    added: Sequence[Remainders],
    reward_terms: Sequence[float],
) -> float:
    r"""The value's error by the adjoints of mean and covariance.

    $\lambda_t = w_t \nabla r + J_t'\lambda_{t+1}$, $\Lambda_t = \frac12 w_t D^2r +
    J_t'\Lambda_{t+1}J_t$, $e_V = |\lambda_0| e_s(0) + |\Lambda_0|_F e_\Sigma(0) +
    \sum_t |\lambda_{t+1}| b_s(t) + |\Lambda_{t+1}|_F b_\Sigma(t) + w_t(\ldots)$, where reward_terms
    are what is not linear in the errors.  Signs and directions are kept to the end of the horizon.
    """
    total = math.fsum(w * term for w, term in zip(weights, reward_terms, strict=True) if w > 0)
    last = path.steps
    vector = weights[last] * path.reward_gradient[last]
    matrix = 0.5 * weights[last] * path.reward_hessian[last]
    for t in reversed(range(last)):
        total += torch.linalg.vector_norm(vector).item() * added[t].mean
        total += torch.linalg.matrix_norm(matrix).item() * added[t].cov
        J = path.jacobian[t]
        vector = weights[t] * path.reward_gradient[t] + J.T @ vector
        matrix = 0.5 * weights[t] * path.reward_hessian[t] + J.T @ matrix @ J
    total += torch.linalg.vector_norm(vector).item() * start.mean
    return known(total + torch.linalg.matrix_norm(matrix).item() * start.cov)


def standing_of(constants: Sequence[Constants], error: ModelError) -> tuple[Standing, list[str]]:
    """Whether everything that the bounds assume is a true supremum, and if not, why."""
    reasons = []
    if any(c.provenance == "sampled" for c in constants):
        reasons.append("constants come from sampled states, which bound no supremum from above")
    if error.provenance == "sampled":
        reasons.append("the model's error comes from sampled states")
    return ("estimate" if reasons else "certified"), reasons


def bound_errors(
    path: Path,
    constants: Constants | Sequence[Constants],
    *,
    noise_law: NoiseLaw,
    weights: Sequence[float],
    start: StartLaw | None = None,
    model_error: ModelError = NO_MODEL_ERROR,
) -> ErrorBounds:
    r"""Bounds of the error of every mean, covariance and expected reward along ``path``, and of V'.

    $$e_r = |\nabla r| e_s + \tfrac12 |D^2 r|_F e_\Sigma + \tfrac12 |D^2 r|_2 e_s^2
      + \tfrac16 M_r D_3,$$
    $$e_s^+ = \min\{|J|_2 e_s + b_s,\ \textstyle\sum_k |J_t \cdots J_{k+1}|_2 b_s(k)\},\quad
      e_\Sigma^+ = \min\{|J|_2^2 e_\Sigma + b_\Sigma,\
      \textstyle\sum_k |J_t \cdots J_{k+1}|_2^2 b_\Sigma(k)\},$$

    with $b_s = \frac12 m_\mu D_2$ and $b_\Sigma = N + m_\mu \sqrt{\mathrm{tr}(JCJ') D_4} +
    \frac14 m_\mu^2 D_4$ (T1, T2, T3); an initial error is carried by J_t ... J_0.

    constants: one for all states, or T + 1 of them, each for the states that may occur at its step
    (see ``tube_radii``).  weights ``T + 1`` numbers >= 0: ``definition_weights`` or
    ``horizon_weights``.  start: None means a point, and is refused if the first covariance is not
    zero.  With a learned model, path and constants are the learned model's.

    Raises NonSmoothDynamics if the constants say so, and ValueError for lists of the wrong length,
    negative weights or an unsound path.
    """
    path.require_sound()
    T, n = path.steps, path.mean.shape[-1]
    each = [constants] * (T + 1) if isinstance(constants, Constants) else list(constants)
    if len(each) != T + 1 or len(weights) != T + 1:
        raise ValueError(
            f"{len(each)} constants and {len(weights)} weights, expected {T + 1}: one a belief"
        )
    if not all(0 <= w < math.inf for w in weights):
        raise ValueError(f"weights={list(weights)}: expected finite numbers >= 0")
    if not all(c.smooth for c in each):
        raise NonSmoothDynamics("the dynamics are flagged as not smooth: no bound exists for them")
    if start is None:
        if bool(path.cov[0].any()):
            raise ValueError("the first covariance is not zero: pass start=StartLaw...")
        start = StartLaw.point()
    start.require_consistent(path.cov[0])

    norms = StepNorms.of(path)
    rule = StepRule(n, norms, noise_law, model_error)
    errors = [
        StepErrors(start.mean_error, start.cov_error, start.second_moment, start.fourth_moment)
    ]
    propagators = Propagators(n, errors[0])
    added: list[Remainders] = []
    for t in range(T):
        now, c = errors[-1], each[t]
        step = rule.remainders(t, now, c)
        carried = propagators.carry(path.jacobian[t], step)
        j = norms.jacobian[t]
        mean = min(known(j * now.mean + step.mean), carried.mean)
        cov = min(known(j * j * now.cov + step.cov), carried.cov)
        direct = norms.cov_trace[t + 1] + math.sqrt(n) * cov + mean * mean
        second = min(direct, rule.second_moment(t, now, c))
        added.append(step)
        errors.append(StepErrors(mean, cov, second, rule.fourth_moment(t, now, c)))

    bends = [
        known(
            reward_remainder(
                hessian=norms.hessian[t],
                mean_error=e.mean,
                reward_third=each[t].reward_third,
                third_moment=e.third,
            )
        )
        for t, e in enumerate(errors)
    ]
    rewards = [
        known(
            norms.reward_gradient[t] * e.mean + 0.5 * norms.hessian_frobenius[t] * e.cov + bends[t]
        )
        for t, e in enumerate(errors)
    ]
    standing, reasons = standing_of(each, model_error)
    return ErrorBounds(
        standing=standing,
        reasons=tuple(reasons),
        mean=tuple(e.mean for e in errors),
        cov=tuple(e.cov for e in errors),
        reward=tuple(rewards),
        second_moment=tuple(e.second for e in errors),
        fourth_moment=tuple(e.fourth for e in errors),
        value_summed=math.fsum(w * e for w, e in zip(weights, rewards, strict=True) if w > 0),
        value_adjoint=adjoint_value_bound(path, weights, errors[0], added, bends),
    )
