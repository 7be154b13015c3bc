r"""Random smooth systems whose every constant is known on paper, and their exact errors.

    s+ = A s + B tanh(W s + b) + U diag(sqrt v(s)) z,   v_i = v0_i (1 + 1/2 sin(c_i s + d_i)),
    r  = -s'Q s + q's + 1/5 sum_k sin(f_k s + g_k),

z of independent components with mean 0 and variance 1.  With few atoms for z and a short horizon
the true distribution is a finite sum: errors are then exact, and a bound has no slack to hide in.
"""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import torch
from torch import Tensor

from edtorch.bounds import Constants, ErrorBounds, Path, Provenance, first_order_path
from edtorch.transform import point_belief
from edtorch.types import Belief
from tests.systems import f64, normal, random_cost

TANH_2 = 4 / (3 * math.sqrt(3))
"""sup |tanh''|: -2 t (1 - t^2) is extreme at t = tanh x = 1 / sqrt 3."""


def corners(low: Tensor, high: Tensor) -> Tensor:
    """The 2^n corners ``[2^n, n]`` of a box, where a convex function is largest."""
    pairs = zip(low.tolist(), high.tolist(), strict=True)
    return torch.tensor(list(itertools.product(*pairs)), dtype=torch.float64)


def signed_maximum(gram: Tensor) -> float:
    """max over x in [-1, 1]^n of sqrt(x' gram x), gram positive semidefinite."""
    one = torch.ones(len(gram))
    x = corners(-one, one)
    return (x @ gram * x).sum(-1).max().sqrt().item()


@dataclass(frozen=True)
class SmoothSystem:
    """One system; also a reward and, as the policy is part of mu, any policy."""

    A: Tensor
    B: Tensor
    W: Tensor
    b: Tensor
    U: Tensor
    v0: Tensor
    c: Tensor
    d: Tensor
    Q: Tensor
    q: Tensor
    f: Tensor
    g: Tensor
    start: Tensor

    @property
    def n(self) -> int:
        return len(self.start)

    def mu(self, s: Tensor) -> Tensor:
        return s @ self.A.T + torch.tanh(s @ self.W.T + self.b) @ self.B.T

    def variances(self, s: Tensor) -> Tensor:
        return self.v0 * (1 + 0.5 * torch.sin(s @ self.c.T + self.d))

    def nu(self, s: Tensor) -> Tensor:
        return self.U * self.variances(s).unsqueeze(-2) @ self.U.T

    def reward(self, state: Tensor, action: Tensor) -> Tensor:
        waves = torch.sin(state @ self.f.T + self.g).sum(-1)
        return -(state @ self.Q * state).sum(-1) + state @ self.q + 0.2 * waves

    def policy(self, s: Tensor) -> Tensor:
        return s

    def shake(self, s: Tensor, z: Tensor) -> Tensor:
        """The noise at ``s`` for the draws ``z``."""
        return (self.variances(s).sqrt() * z) @ self.U.T

    def path(self, steps: int, start: Belief | None = None) -> Path:
        return first_order_path(
            point_belief(self.start) if start is None else start,
            self.mu,
            self.nu,
            self.policy,
            reward=self.reward,
            steps=steps,
        )

    def frobenius_constants(self) -> tuple[float, float, float]:
        """The paper's M_mu, M_nu and M_r: suprema, attained where W, c and f are invertible."""
        rows = self.W @ self.W.T
        curvature = TANH_2 * signed_maximum((self.B.T @ self.B) * rows * rows)
        slope = torch.linalg.matrix_norm(0.5 * self.v0.unsqueeze(-1) * self.c).item()
        third = 0.2 * signed_maximum((self.f @ self.f.T) ** 3)
        return curvature, slope, third

    def constants(self) -> Constants:
        """Suprema over all states: tanh' is in (0, 1], |tanh''| at most TANH_2."""
        one = torch.ones(self.n, dtype=torch.float64)
        return self.constants_for(0 * one, one, TANH_2 * one, "analytic")

    def constants_near(self, center: Tensor, radius: float) -> Constants:
        """Suprema over a ball, from the intervals of tanh' and tanh'' on it."""
        x = self.W @ center + self.b
        reach = radius * torch.linalg.vector_norm(self.W, dim=-1)
        t = torch.tanh(torch.stack([x - reach, x + reach]))
        root = 1 / math.sqrt(3)
        bends = 2 * t * (1 - t**2)
        inside = ((t[0] < root) & (t[1] > root)) | ((t[0] < -root) & (t[1] > -root))
        high = torch.where((t[0] < 0) & (t[1] > 0), 1.0, (1 - t**2).amax(0))
        bend = torch.where(inside, TANH_2, bends.abs().amax(0))
        return self.constants_for((1 - t**2).amin(0), high, bend, "interval")

    def constants_for(
        self, low: Tensor, high: Tensor, bend: Tensor, provenance: Provenance
    ) -> Constants:
        """Suprema where tanh' of each unit is in [low, high] and |tanh''| at most bend.

        D mu = A + B diag(t') W and D^2 mu[u, u] = B diag(t'') (W u)^2: their norms are convex in
        t' and t'', hence largest at corners.
        """
        slopes = 0.5 * self.v0.unsqueeze(-1) * self.c
        J = self.A + (self.B * corners(low, high).unsqueeze(-2)) @ self.W
        signed = self.B * corners(-bend, bend).unsqueeze(-2)
        # The unfolding n x n^2 of D^2 mu is (B diag t'')(rows w_h x w_h), whose Gram matrix is:
        rows = (self.W @ self.W.T) ** 2
        unfolded = torch.linalg.eigvalsh(signed @ rows @ signed.mT)[:, -1].max().sqrt().item()
        v = torch.outer(self.v0, self.v0) / 4
        bends = torch.linalg.eigvalsh(v * (self.c @ self.c.T) ** 2)[-1].sqrt().item()
        return Constants(
            lipschitz=torch.linalg.matrix_norm(J, ord=2).max().item(),
            curvature=unfolded,
            noise_slope=torch.linalg.matrix_norm(slopes, ord=2).item(),
            noise_trace_slope=signed_maximum(slopes @ slopes.T),
            noise_curvature=bends,
            reward_third=self.frobenius_constants()[2],
            provenance=provenance,
        )


def smooth_system(
    n: int, seed: int, *, nonlinearity: float = 0.6, v0: float = 0.02
) -> SmoothSystem:
    """A random system with |A|_2 about 0.6 and nonlinear part of the size ``nonlinearity``."""
    g = torch.Generator().manual_seed(7919 * n + seed)
    A, B, W = (normal(g, n, n) / math.sqrt(n) for _ in range(3))
    U, _ = torch.linalg.qr(normal(g, n, n))
    return SmoothSystem(
        A=0.5 * A / torch.linalg.matrix_norm(A, ord=2) + 0.1 * torch.eye(n).double(),
        B=nonlinearity * B / torch.linalg.matrix_norm(B, ord=2),
        W=W / torch.linalg.matrix_norm(W, ord=2),
        b=0.5 * normal(g, n),
        U=U,
        v0=v0 * (0.5 + torch.rand(n, generator=g, dtype=torch.float64)),
        c=normal(g, n, n) / math.sqrt(n),
        d=normal(g, n),
        Q=random_cost(g, n),
        q=normal(g, n),
        f=normal(g, n, n) / math.sqrt(n),
        g=normal(g, n),
        start=normal(g, n),
    )


@dataclass(frozen=True)
class Law:
    """Finitely many states ``[K, n]`` with probabilities ``[K]``."""

    states: Tensor
    weights: Tensor

    def mean(self, values: Tensor) -> Tensor:
        """Expectation of values ``[K, ...]``."""
        return torch.tensordot(self.weights, values, dims=1)

    def moments(self) -> tuple[Tensor, Tensor]:
        """Mean ``[n]`` and covariance ``[n, n]``."""
        mean = self.mean(self.states)
        centred = self.states - mean
        return mean, centred.T @ (centred * self.weights.unsqueeze(-1))

    def distance_moment(self, point: Tensor, order: int) -> float:
        """E |X - point|^order."""
        distance = torch.linalg.vector_norm(self.states - point, dim=-1)
        return self.mean(distance**order).item()


RADEMACHER = ((-1.0, 0.5), (1.0, 0.5))
"""Kurtosis 1, the least there is."""
THREE_POINT = ((-math.sqrt(3.0), 1 / 6), (0.0, 2 / 3), (math.sqrt(3.0), 1 / 6))
"""Kurtosis 3, a Gaussian's."""
Atoms = tuple[tuple[float, float], ...]


def noise_atoms(atoms: Atoms, n: int) -> Law:
    """z of n independent components."""
    grid = list(itertools.product(atoms, repeat=n))
    values = torch.tensor([[a[0] for a in z] for z in grid], dtype=torch.float64)
    chances = torch.tensor([math.prod(a[1] for a in z) for z in grid], dtype=torch.float64)
    return Law(values, chances)


def exact_laws(system: SmoothSystem, atoms: Atoms, steps: int, start: Law) -> list[Law]:
    """P_0 .. P_T as finite sums, with K_0 * atoms^(n t) states at step t."""
    z, laws = noise_atoms(atoms, system.n), [start]
    for _ in range(steps):
        s, w = laws[-1].states, laws[-1].weights
        moved = system.mu(s).unsqueeze(1) + system.shake(s.unsqueeze(1), z.states)
        laws.append(Law(moved.flatten(0, 1), torch.outer(w, z.weights).flatten()))
    return laws


@dataclass(frozen=True)
class StepErrors:
    """True errors at one step."""

    mean: float
    cov: float
    reward: float
    second_moment: float
    fourth_moment: float


def exact_errors(system: SmoothSystem, path: Path, laws: list[Law]) -> list[StepErrors]:
    """Of every step."""
    errors = []
    for t, law in enumerate(laws):
        mean, cov = law.moments()
        gain = law.mean(system.reward(law.states, law.states)) - path.expected_reward[t]
        errors.append(
            StepErrors(
                mean=torch.linalg.vector_norm(mean - path.mean[t]).item(),
                cov=torch.linalg.matrix_norm(cov - path.cov[t]).item(),
                reward=gain.abs().item(),
                second_moment=law.distance_moment(path.mean[t], 2),
                fourth_moment=law.distance_moment(path.mean[t], 4),
            )
        )
    return errors


def exact_value_error(
    system: SmoothSystem, path: Path, laws: list[Law], weights: list[float]
) -> float:
    """|V - V'|."""
    total = 0.0
    for t, (law, weight) in enumerate(zip(laws, weights, strict=True)):
        gain = law.mean(system.reward(law.states, law.states)) - path.expected_reward[t]
        total += weight * gain.item()
    return abs(total)


FLOOR = 1e-12
"""The first step's error of a point start is exactly 0; rounding is not."""


def at_start(system: SmoothSystem) -> Law:
    return Law(system.start.unsqueeze(0), f64([1.0]))


def broken(bounds: ErrorBounds, errors: list[StepErrors]) -> list[tuple[int, str]]:
    """Where an error is above its bound."""
    names = ("mean", "cov", "reward", "second_moment", "fourth_moment")
    return [
        (t, name)
        for t, error in enumerate(errors)
        for name in names
        if getattr(error, name) > getattr(bounds, name)[t] * (1 + FLOOR) + FLOOR
    ]
