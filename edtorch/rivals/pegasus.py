"""PEGASUS: policy search against fixed scenarios (Ng & Jordan, UAI 2000; section 6, footnote 2).

The simulator is a function f of the policy's weights and of a sequence of random numbers.  A few
sequences, the scenarios, are drawn once and used for every policy (common random numbers), so that
the estimated value

    V(theta) = 1/m sum_i f(theta, xi_i)

is a function of the weights alone, which is climbed with finite differences: m simulations for each
weight (footnote 2), and m for each step length that is tried along the gradient.

f is the return of an episode: the integral of gamma^t r(s, a) over up to ``horizon`` seconds.
After a failure the rest of the horizon is charged at ``failure_cost`` per second, so that failing
later is better and never failing best; after the goal the rest costs nothing.

Ng and Jordan had 15 weights and a reward of progress towards the goal; here the weights are those
of the policy that the configuration names, starting at zero, and the reward is the learner's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from edtorch.rivals.base import LinearSearch, Problem
from edtorch.rivals.episodes import Ended
from edtorch.rivals.returns import Return, SparseReward, charge, check_discount
from edtorch.rivals.runs import Runs
from edtorch.run.hashing import Use, hash_key
from sims.base import Outcome


@dataclass(frozen=True)
class Pegasus:
    """gradients: how many; scenarios: m, runs of each policy; difference: by which a weight is
    moved (scaled), halved where no step along the gradient was an improvement; central: whether
    both ways, at nearly twice the runs: a weight that neither way improves then stays as it is, for
    the value has kinks; lengths: of a step along the gradient that are tried, each half the one
    before; longest: the first of them, a Euclidean distance between weights; horizon: seconds of a
    run at most; discount: gamma, per second; failure_cost: per second of the rest of the horizon,
    above what any state costs."""

    gradients: int = 30
    scenarios: int = 30
    difference: float = 0.05
    central: bool = True
    lengths: int = 10
    longest: float = 4.0
    horizon: float = 20.0
    discount: float = 1.0
    failure_cost: float = 20.0

    def __post_init__(self) -> None:
        """Refuse impossible arguments."""
        for name in ("gradients", "scenarios", "lengths"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}={getattr(self, name)}: expected an integer >= 1")
        for name in ("difference", "longest", "horizon"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}={getattr(self, name)}: expected a number > 0")
        if not self.failure_cost >= 0:
            raise ValueError(f"failure_cost={self.failure_cost}: expected a number >= 0")
        check_discount(self.discount)

    def begin(self, problem: Problem) -> PegasusSearch:
        """All seeds from the zero policy."""
        return PegasusSearch(self, problem)


class PegasusSearch(LinearSearch):
    """One search per seed; a piece of work is a gradient and a step along it."""

    def __init__(self, settings: Pegasus, problem: Problem) -> None:
        super().__init__(problem)
        self._settings, self._world = settings, problem.world
        self._limit = min(round(settings.horizon / problem.world.dt), problem.world.limit_ticks)
        self._runs = Runs(
            problem.world,
            problem.policy,
            native=problem.native,
            accumulator=Return(SparseReward(problem.weights), settings.discount, problem.world.dt),
            limit=self._limit,
        )
        scenario = torch.arange(settings.scenarios)
        self._keys = [hash_key(Use.SCENARIO, seed, scenario) for seed in problem.seeds]
        self._weight = torch.zeros(len(problem.seeds), problem.policy.weight.numel())
        self._weight = self._weight.to(torch.float64)
        self._value = [-math.inf for _ in problem.seeds]
        self._difference = [settings.difference for _ in problem.seeds]
        self._made = [0 for _ in problem.seeds]

    @property
    def values(self) -> list[float]:
        """Estimated value of each seed's policy, minus infinity before the first piece."""
        return list(self._value)

    @property
    def done(self) -> list[bool]:
        """Whether all gradients have been made."""
        return [made >= self._settings.gradients for made in self._made]

    def state(self) -> dict[str, Any]:
        """See ``Resumable``; the scenarios are a function of the seeds."""
        own = {"value": self._value, "difference": self._difference, "made": self._made}
        return {**super().state(), **{name: list(values) for name, values in own.items()}}

    def restore(self, state: Mapping[str, Any]) -> None:
        """See ``Resumable``."""
        super().restore(state)
        self._value, self._difference = list(state["value"]), list(state["difference"])
        self._made = list(state["made"])

    def advance(self, going: Sequence[bool], pause: Callable[[], None]) -> None:
        """A gradient, and the best of some steps along it, if any is better than none."""
        rows = [row for row, on in enumerate(going) if on]
        values = self._values(rows, self._weight[rows].unsqueeze(1) + self._moved(rows), pause)
        direction = torch.stack(
            [self._gradient(row, own) for row, own in zip(rows, values, strict=True)]
        )
        norm = direction.norm(dim=-1, keepdim=True)
        direction = torch.where(norm > 0, direction / norm, torch.zeros_like(direction))
        halves = 0.5 ** torch.arange(self._settings.lengths, dtype=torch.float64)
        step = (self._settings.longest * halves).unsqueeze(-1) * direction.unsqueeze(1)
        tried = self._weight[rows].unsqueeze(1) + step
        found = self._values(rows, tried, pause)
        for place, row in enumerate(rows):
            best = int(found[place].argmax())
            value = float(found[place, best])
            if value > self._value[row]:
                self._weight[row] = tried[place, best]
                self._value[row] = value
            else:
                self._difference[row] /= 2
            self._made[row] += 1

    def _moved(self, rows: Sequence[int]) -> Tensor:
        """What is added to the weights, ``[S, K, p]``: each weight's difference (both ways with
        ``central``), and nothing."""
        eye = torch.eye(self._weight.shape[-1], dtype=torch.float64)
        ways = [eye, -eye] if self._settings.central else [eye]
        own = torch.tensor([self._difference[row] for row in rows], dtype=torch.float64)
        return own[:, None, None] * torch.cat([*ways, torch.zeros_like(eye[:1])])

    def _gradient(self, row: int, values: Tensor) -> Tensor:
        """``[p]`` of one seed, from values ``[K]`` as of ``_moved``."""
        p = self._weight.shape[-1]
        now = values[-1]
        self._value[row] = float(now)
        if not self._settings.central:
            return (values[:p] - now) / self._difference[row]
        up, down = values[:p], values[p:-1]
        slope = (up - down) / (2 * self._difference[row])
        return torch.where((up < now) & (down < now), 0.0, slope)

    def _values(self, rows: Sequence[int], weight: Tensor, pause: Callable[[], None]) -> Tensor:
        """Values ``[S, K]`` of weights ``[S, K, p]`` of the seeds ``rows``; all of it is paid."""
        many, m = weight.shape[1], self._settings.scenarios
        key = torch.cat([self._keys[row].repeat(many, 1) for row in rows])
        shaped = weight.flatten(0, 1).repeat_interleave(m, dim=0)
        ended = self._runs(shaped.unflatten(-1, self._policy.weight.shape), key, pause)
        for place, row in enumerate(rows):
            own = slice(place * many * m, (place + 1) * many * m)
            ended.pay(self.accounts[row], self._world, own)
        returns = self._returns(ended)
        return returns.view(len(rows), many, m).mean(-1)

    def _returns(self, ended: Ended) -> Tensor:
        fell = ended.outcome == int(Outcome.FAILED)
        seconds = ended.ticks.to(torch.float64) * self._world.dt
        rest = charge(seconds, self._limit * self._world.dt, self._settings.discount)
        return ended.sums[0] + torch.where(fell, self._settings.failure_cost * rest, 0.0)
