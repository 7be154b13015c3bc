"""Random smooth stochastic systems whose moments no closed form knows, and their Monte Carlo."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

from edtorch.derivatives import rowwise_jacobian

Law = Literal["gaussian", "uniform"]


def _spectral(generator: torch.Generator, rows: int, columns: int, norm: float) -> Tensor:
    """A random matrix of the given spectral norm."""
    matrix = torch.randn(rows, columns, generator=generator, dtype=torch.float64)
    return matrix * (norm / torch.linalg.matrix_norm(matrix, 2))


@dataclass(frozen=True)
class SmoothSystem:
    """s+ = A s + B tanh(W s + b) + U diag(sqrt v(s)) z,  v_i = v0 (1 + .5 sin(c_i . s + d_i)).

    Seen as a closed loop, a = tanh(W s + b) is the policy and A s + B a the model.  The reward is
    -s'Qs - q.s + .2 sum_i sin(p_i . s + e_i).  z has independent components of variance 1, normal
    or uniform (law); the start is a point.
    """

    A: Tensor
    B: Tensor
    W: Tensor
    b: Tensor
    U: Tensor
    v0: float
    c: Tensor
    d: Tensor
    Q: Tensor
    q: Tensor
    p: Tensor
    e: Tensor
    start: Tensor
    law: Law
    horizon: int = 10
    discount: float = 0.95

    def policy(self, state: Tensor) -> Tensor:
        return torch.tanh(state @ self.W.T + self.b)

    def closed_loop(self, state: Tensor) -> Tensor:
        return state @ self.A.T + self.policy(state) @ self.B.T

    def variances(self, state: Tensor) -> Tensor:
        return self.v0 * (1 + 0.5 * torch.sin(state @ self.c.T + self.d))

    def noise(self, state: Tensor) -> Tensor:
        """nu(s) ``[*batch, n, n]``, positive definite."""
        return (self.U * self.variances(state).unsqueeze(-2)) @ self.U.T

    def state_reward(self, state: Tensor) -> Tensor:
        quadratic = (state @ self.Q * state).sum(-1) + state @ self.q
        return -quadratic + 0.2 * torch.sin(state @ self.p.T + self.e).sum(-1)

    def reward(self, state: Tensor, action: Tensor) -> Tensor:
        return self.state_reward(state)

    def disturbance(self, samples: int, generator: torch.Generator) -> Tensor:
        """z ``[samples, n]``."""
        n = len(self.start)
        if self.law == "gaussian":
            return torch.randn(samples, n, generator=generator, dtype=torch.float64)
        uniform = torch.rand(samples, n, generator=generator, dtype=torch.float64)
        return (2 * uniform - 1) * 3**0.5


def random_system(
    n: int, seed: int, nl: float = 0.6, noise: Law = "gaussian", v0: float = 0.05
) -> SmoothSystem:
    """A system of n states, |A| = .55, |W| = 1, |B| = nl: the closed loop's slope is <= .55 + nl.

    nl: strength of the nonlinearity; v0: variance of each noise component where the sines vanish.
    """
    g = torch.Generator().manual_seed(10_000 * n + seed)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=g, dtype=torch.float64)

    root = normal(n, n)
    return SmoothSystem(
        A=_spectral(g, n, n, 0.55),
        B=_spectral(g, n, n, nl),
        W=_spectral(g, n, n, 1.0),
        b=0.5 * normal(n),
        U=torch.linalg.qr(normal(n, n))[0],
        v0=v0,
        c=normal(n, n) / n**0.5,
        d=normal(n),
        Q=root @ root.T / n,
        q=0.5 * normal(n),
        p=normal(n, n) / n**0.5,
        e=normal(n),
        start=normal(n),
        law=noise,
    )


@dataclass(frozen=True)
class Truth:
    """Moments of the true process at steps 1..T: mean ``[T, n]``, cov ``[T, n, n]``, reward ``[T]``
    and value ``[]``, the last two with a standard error."""

    mean: Tensor
    cov: Tensor
    reward: Tensor
    value: Tensor
    reward_error: Tensor
    value_error: Tensor


def coupled_monte_carlo(
    system: SmoothSystem, samples: int, generator: torch.Generator, chunk: int = 50_000
) -> Truth:
    """The true moments, by simulation next to a companion whose moments are known.

    The same z drive the true chain x and x~+ = mu(s~) + J (x~ - s~) + sqrt(nu(s~)) z, whose mean
    and covariance are exactly the first-order transform's; only the differences are estimated.
    """
    n, T = len(system.start), system.horizon
    mean, slopes, roots, tangents = system.start, [], [], []
    nominal: list[Tensor] = []
    cov, covs = torch.zeros(n, n, dtype=torch.float64), []

    def gradient(s: Tensor) -> Tensor:
        return rowwise_jacobian(lambda x: system.state_reward(x).unsqueeze(-1), s).squeeze(-2)

    for _ in range(T):
        J = rowwise_jacobian(system.closed_loop, mean)
        slopes.append(J)
        roots.append(system.U * system.variances(mean).sqrt())
        cov = J @ cov @ J.T + system.noise(mean)
        mean = system.closed_loop(mean)
        nominal.append(mean)
        covs.append(cov)
        tangents.append((gradient(mean), rowwise_jacobian(gradient, mean)))

    weights = system.discount ** torch.arange(T, dtype=torch.float64)
    shift = torch.zeros(T, n, dtype=torch.float64)
    spread = torch.zeros(T, n, n, dtype=torch.float64)
    gain, gain2 = torch.zeros(T, dtype=torch.float64), torch.zeros(T, dtype=torch.float64)
    worth2 = torch.zeros((), dtype=torch.float64)
    done = 0
    while done < samples:
        count = min(chunk, samples - done)
        x = system.start.expand(count, n)
        offset = torch.zeros(count, n, dtype=torch.float64)
        worth = torch.zeros(count, dtype=torch.float64)
        for k in range(T):
            z = system.disturbance(count, generator)
            x = system.closed_loop(x) + (system.variances(x).sqrt() * z) @ system.U.T
            offset = offset @ slopes[k].T + z @ roots[k].T
            away = x - nominal[k]
            shift[k] += (away - offset).sum(0)
            spread[k] += away.T @ away - offset.T @ offset
            slope, hessian = tangents[k]
            companion = offset @ slope + 0.5 * (offset @ hessian * offset).sum(-1)
            surplus = system.state_reward(x) - system.state_reward(nominal[k]) - companion
            gain[k] += surplus.sum()
            gain2[k] += surplus.square().sum()
            worth = worth + weights[k] * surplus
        worth2 += worth.square().sum()
        done += count
    shift, spread, gain = shift / samples, spread / samples, gain / samples
    known = torch.stack(
        [
            system.state_reward(s) + 0.5 * (tangent[1] * C).sum()
            for s, C, tangent in zip(nominal, covs, tangents, strict=True)
        ]
    )
    total = weights @ gain
    return Truth(
        mean=torch.stack(nominal) + shift,
        cov=torch.stack(covs) + spread - shift.unsqueeze(-1) * shift.unsqueeze(-2),
        reward=known + gain,
        value=weights @ known + total,
        reward_error=((gain2 / samples - gain.square()) / samples).sqrt(),
        value_error=((worth2 / samples - total.square()) / samples).sqrt(),
    )
