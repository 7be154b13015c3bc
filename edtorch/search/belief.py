"""The expected cost of a policy under a belief, propagated through model, policy and readings.

The belief is over (s, e), the state and the error of its reading, which is fresh at every tick:

    z = (s, e),   z' = (mu~(s, pi(s + e)), e'),   e' ~ N(0, R),

so that the transforms of ``edtorch.transform`` (eqs. 1 and 2) know what errors of readings do to
the actions, and need no knowledge of them.  nu~ is what the posterior leaves unknown of the
accelerations, as if it were drawn anew at each tick; imagined trials hold it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import torch
from torch import Tensor
from torch.nn.functional import pad

from edtorch.circle import wrapped
from edtorch.derivatives import rowwise_jacobian
from edtorch.model.mechanism import Structure, acceleration_cov
from edtorch.policy.bounded import BoundedPolicy
from edtorch.search.plan import Cost
from edtorch.search.target import mean_start
from edtorch.search.tick_costs import TickCosts
from edtorch.search.tick_model import TickModel
from edtorch.search.ticks import CompiledTicks
from edtorch.transform import Transform
from edtorch.types import Belief, Parameters
from edtorch.value.unroll import course


@dataclass(frozen=True, eq=False)
class Gaussians:
    """mean ``[G, n]``, cov ``[G, n, n]`` and share ``[G]`` of a mixture of starts."""

    mean: Tensor
    cov: Tensor
    share: Tensor


def points(starts: Tensor) -> Gaussians:
    """Each of ``starts`` ``[G, n]``, known exactly."""
    return Gaussians(starts, torch.diag_embed(torch.zeros_like(starts)), _equal(len(starts)))


def gaussians(starts: Tensor, period: Tensor, count: int) -> Gaussians:
    """At most ``count`` Gaussians with the moments of the starts ``[k, n]`` next to each.

    Centres are as far from each other as they can be, the first one the first start, and then
    means (Lloyd's algorithm).  Differences of angles are the short way round, ``period`` ``[n]``.
    """
    centres = starts[:1]
    while len(centres) < count:
        nearest = _distances(starts, centres, period).min(-1).values
        if nearest.max() <= 0:
            break
        centres = torch.cat([centres, starts[nearest.argmax()].unsqueeze(0)])
    own = _distances(starts, centres, period).argmin(-1)
    for _ in range(_ROUNDS):
        centres = torch.stack([mean_start(starts[own == g], period) for g in own.unique()])
        own = _distances(starts, centres, period).argmin(-1)
    found = [starts[own == g] for g in own.unique()]
    mean = torch.stack([mean_start(each, period) for each in found])
    away = [wrapped(each - m, period) for each, m in zip(found, mean, strict=True)]
    cov = torch.stack([a.mT @ a / len(a) for a in away])
    share = torch.tensor([len(a) / len(starts) for a in away], dtype=starts.dtype)
    return Gaussians(mean, cov, share)


_ROUNDS = 5


def _distances(starts: Tensor, centres: Tensor, period: Tensor) -> Tensor:
    return wrapped(starts.unsqueeze(1) - centres, period).norm(dim=-1)


def _equal(count: int) -> Tensor:
    return torch.full((count,), 1 / count, dtype=torch.float64)


@dataclass(frozen=True, eq=False)
class ReadLoop:
    """z' of z ``[*more, B, 2 n]`` under B policies, without e'."""

    ticks: CompiledTicks
    policy: BoundedPolicy
    parameters: Parameters

    def raw(self, z: Tensor) -> Tensor:
        """The raw action ``[*more, B, m]`` on the reading s + e."""
        state, error = z.chunk(2, dim=-1)
        return self.policy.raw(self.parameters, state + error)

    def action(self, z: Tensor) -> Tensor:
        """pi(s + e), ``[*more, B, m]``."""
        return self.policy.squash(self.raw(z))

    def __call__(self, z: Tensor) -> Tensor:
        """``[*more, B, 2 n]``."""
        state, error = z.chunk(2, dim=-1)
        after = self.ticks(state, self.action(z))
        return torch.cat([after, torch.zeros_like(error)], dim=-1)

    def jacobian(self, z: Tensor) -> Tensor:
        """dz'/dz ``[*more, B, 2 n, 2 n]``, of s' by the chain rule."""
        state, _ = z.chunk(2, dim=-1)
        n = state.shape[-1]
        by = self.ticks.jacobian(state, self.action(z))
        upon = by[..., n:] @ rowwise_jacobian(self.action, z)
        return pad(upon + pad(by[..., :n], (0, n)), (0, 0, 0, n))


@dataclass(frozen=True, eq=False)
class UnknownModel:
    """nu of z' ``[*more, B, 2 n, 2 n]``: of s' by the covariance of the weights ``[L, K, K]``, an
    error of an acceleration being held for a tick; of e' the ``reading`` ``[n]``, deviations."""

    loop: ReadLoop
    cov: Tensor
    reading: Tensor
    positive: ClassVar[bool] = True

    def __call__(self, z: Tensor) -> Tensor:
        """See the class."""
        model = self.loop.ticks.model
        structure, n = model.structure, len(self.reading)
        state, _ = z.chunk(2, dim=-1)
        weight = torch.from_numpy(model.weight)
        of_rates = acceleration_cov(structure, weight, self.cov, state, self.loop.action(z))
        moved = _moved(structure, model.dt)
        errors = pad(self.reading.square().diag(), (n, 0, n, 0))
        return pad(moved @ of_rates @ moved.mT, (0, n, 0, n)) + errors


def _moved(structure: Structure, dt: float) -> Tensor:
    """By how much an acceleration that is held for ``dt`` moves the state, ``[n, L]``."""
    found = torch.zeros(len(structure.source), len(structure.learned), dtype=torch.float64)
    for place, learned in enumerate(structure.learned):
        found[learned, place] = dt
        for i, source in enumerate(structure.source):
            if source == learned:
                found[i, place] = float(structure.ratio[i]) * dt**2 / 2
    return found


@dataclass(frozen=True, eq=False)
class ExpectedCost:
    """Of B policies, ``[B]``, over the horizon of ``cost``.

    starts: where beliefs begin; cov ``[L, K, K]``: of the model's weights; reading ``[n]``:
    deviations of the errors of readings.  Both count where ``transform`` propagates a covariance.
    """

    model: TickModel
    policy: BoundedPolicy
    cost: Cost
    transform: Transform
    starts: Gaussians
    cov: Tensor
    reading: Tensor

    def beliefs(self, parameters: Parameters) -> Belief:
        """Of z at each tick: mean ``[H + 1, G, B, 2 n]``, cov ``[H + 1, G, B, 2 n, 2 n]``."""
        loop = ReadLoop(CompiledTicks(self.model), self.policy, parameters)
        size = len(next(iter(parameters.values())))
        mean, cov = self.starts.mean.unsqueeze(1), self.starts.cov.unsqueeze(1)
        n = mean.shape[-1]
        errors = pad(self.reading.square().diag(), (n, 0, n, 0))
        found, _ = course(
            Belief(
                pad(mean, (0, n)).expand(-1, size, -1),
                (pad(cov, (0, n, 0, n)) + errors).expand(-1, size, -1, -1),
            ),
            loop,
            transform=self.transform,
            noise=UnknownModel(loop, self.cov, self.reading),
            steps=self.cost.ticks,
        )
        return Belief(torch.stack([b.mean for b in found]), torch.stack([b.cov for b in found]))

    def __call__(self, parameters: Parameters) -> Tensor:
        """``[B]``, differentiable with respect to the parameters ``[B, ...]``."""
        loop = ReadLoop(CompiledTicks(self.model), self.policy, parameters)
        costs = TickCosts(self.model.structure.lift, self.cost)

        def reward(z: Tensor, raw: Tensor) -> Tensor:
            return -costs(z.chunk(2, dim=-1)[0], raw)

        gain = self.transform.reward(reward, self.beliefs(parameters), loop.raw)
        return -(self.starts.share.unsqueeze(-1) * gain.sum(0)).sum(0)
