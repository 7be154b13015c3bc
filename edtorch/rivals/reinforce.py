"""REINFORCE (Williams, "Simple statistical gradient-following algorithms for connectionist
reinforcement learning", 1992): the likelihood ratio's gradient, from whole episodes.

Each action has Gaussian noise of its own, a = theta phi(o) + sigma e, so that one episode gives

    g = sum_t (R_t - b(o_t)) l_t,   l_t = d log pi(a_t | o_t) / d theta = e phi(o)' / sigma,

with the discounted reward-to-go R_t and a baseline b that the batch before has taught: the least
squares fit of R_t by the squares of the components of the observation and 1 (Sutton & Barto,
"Reinforcement learning", 2nd ed., section 13.4).  Any b of the state leaves the mean of g as it is.

No step of an episode is kept.  With the traces z = gamma z + l and y = gamma y + psi,

    sum_t R_t l_t = sum_t r_t z_t   and   sum_t R_t psi_t = sum_t r_t y_t

(Baxter & Bartlett, "Infinite-horizon policy-gradient estimation", 2001, section 3), so that a few
sums do.  A failure costs ``failure_cost`` per second for ever: one more reward, -failure_cost /
log(1 / gamma).  An episode that is cut off earns nothing more, like one at the goal.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from edtorch.model.features import FeatureMap
from edtorch.rivals.base import LinearSearch, Problem
from edtorch.rivals.episodes import Ended, EpisodeTick
from edtorch.rivals.returns import SparseReward
from edtorch.rivals.runs import Runs
from edtorch.run.hashing import Use, hash_key
from sims.base import Outcome


@dataclass(frozen=True)
class Reinforce:
    """batch: episodes for one step; updates: steps in a piece of work; deviation: sigma, scaled;
    alpha, beta: of the step alpha g / (beta + norm of g), g being the mean over the episodes;
    horizon: seconds after which an episode is cut off; discount: gamma, per second, below 1;
    failure_cost: per second, above what any state costs."""

    batch: int = 100
    updates: int = 10
    deviation: float = 0.3
    alpha: float = 0.1
    beta: float = 1.0
    horizon: float = 20.0
    discount: float = 0.8
    failure_cost: float = 20.0

    def __post_init__(self) -> None:
        """Refuse impossible arguments."""
        for name in ("batch", "updates"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}={getattr(self, name)}: expected an integer >= 1")
        for name in ("deviation", "alpha", "horizon"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}={getattr(self, name)}: expected a number > 0")
        for name in ("beta", "failure_cost"):
            if not getattr(self, name) >= 0:
                raise ValueError(f"{name}={getattr(self, name)}: expected a number >= 0")
        if not 0 < self.discount < 1:
            raise ValueError(
                f"discount={self.discount}: expected a number between 0 and 1 (per second)"
            )

    def begin(self, problem: Problem) -> ReinforceSearch:
        """All seeds from the zero policy."""
        return ReinforceSearch(self, problem)


def squares(observation: Tensor) -> Tensor:
    """psi: 1 and the square of each component, ``[*batch, 1 + n]``."""
    return torch.cat((torch.ones_like(observation[..., :1]), observation.square()), dim=-1)


@dataclass(frozen=True)
class LikelihoodRatio:
    """``edtorch.rivals.episodes.Accumulator``: the sums that gradient and baseline are made of.

    features: phi, of the policy; states, actions: n and m; discount: gamma of a tick; dt: s.
    """

    reward: SparseReward
    features: FeatureMap
    states: int
    actions: int
    deviation: float
    discount: float
    dt: float
    kernel = "likelihood_sums"

    @property
    def numbers(self) -> dict[str, float]:
        """See ``Accumulator``."""
        return {"DISCOUNT": self.discount}

    def begin(self, episodes: int) -> tuple[Tensor, ...]:
        """z and sum r z ``[S, m k]``; y and sum r y ``[S, q]``; sum d log pi psi' ``[S, m k, q]``,
        sum psi psi' ``[S, q, q]``."""
        p, q = self.actions * self.features.outputs, 1 + self.states
        shapes = ((p,), (p,), (q,), (q,), (p, q), (q, q))
        return tuple(torch.zeros(episodes, *shape, dtype=torch.float64) for shape in shapes)

    def add(self, sums: tuple[Tensor, ...], tick: EpisodeTick) -> tuple[Tensor, ...]:
        """One tick more."""
        z, g, y, c, crossed, squared = sums
        phi = self.features(tick.observation)
        score = (tick.normal.unsqueeze(-1) * phi.unsqueeze(-2) / self.deviation).flatten(-2)
        psi = squares(tick.observation)
        earned = (self.dt * self.reward(tick.observation, tick.action)).unsqueeze(-1)
        z = self.discount * z + score
        y = self.discount * y + psi
        return (
            z,
            g + earned * z,
            y,
            c + earned * y,
            crossed + score.unsqueeze(-1) * psi.unsqueeze(-2),
            squared + psi.unsqueeze(-1) * psi.unsqueeze(-2),
        )


class ReinforceSearch(LinearSearch):
    """One search per seed; a piece of work is a few steps."""

    def __init__(self, settings: Reinforce, problem: Problem) -> None:
        world, policy = problem.world, problem.policy
        super().__init__(problem)
        self._settings, self._world = settings, world
        self._limit = min(round(settings.horizon / world.dt), world.limit_ticks)
        self._accumulator = LikelihoodRatio(
            SparseReward(problem.weights),
            policy.features,
            len(world.spec.state),
            policy.weight.shape[0],
            settings.deviation,
            settings.discount**world.dt,
            world.dt,
        )
        self._runs = Runs(
            world,
            policy,
            native=problem.native,
            accumulator=self._accumulator,
            limit=self._limit,
        )
        self._seeds = list(problem.seeds)
        self._weight = torch.zeros(len(self._seeds), policy.weight.numel(), dtype=torch.float64)
        self._baseline = torch.zeros(
            len(self._seeds), 1 + len(world.spec.state), dtype=torch.float64
        )
        self._made = [0 for _ in self._seeds]

    @property
    def baseline(self) -> Tensor:
        """w ``[S, q]`` of b(o) = w . psi(o), for the next batch."""
        return self._baseline

    @property
    def done(self) -> list[bool]:
        """Never: it can always go on."""
        return [False for _ in self._seeds]

    def state(self) -> dict[str, Any]:
        """See ``Resumable``; the noise is a function of the seeds and the numbers of batches."""
        return {**super().state(), "baseline": self._baseline, "made": list(self._made)}

    def restore(self, state: Mapping[str, Any]) -> None:
        """See ``Resumable``."""
        super().restore(state)
        self._baseline, self._made = state["baseline"].clone(), list(state["made"])

    def advance(self, going: Sequence[bool], pause: Callable[[], None]) -> None:
        """Some steps, each after a batch of episodes."""
        rows = [row for row, on in enumerate(going) if on]
        for _ in range(self._settings.updates):
            gradient = self.gradient(rows, pause)
            size = self._settings.beta + gradient.norm(dim=-1, keepdim=True)
            self._weight[rows] += self._settings.alpha * gradient / size

    def gradient(self, rows: Sequence[int], pause: Callable[[], None]) -> Tensor:
        """Of the seeds ``rows``, from a batch of episodes each, which are paid; ``[S, m k]``.
        Teaches the baseline for the next batch."""
        batch = self._settings.batch
        number = torch.arange(batch)
        key = torch.cat(
            [hash_key(Use.EPISODE, self._seeds[r], number + batch * self._made[r]) for r in rows]
        )
        shaped = self.parameters["weight"][rows].repeat_interleave(batch, dim=0)
        ended = self._runs(shaped, key, pause)
        for place, row in enumerate(rows):
            own = slice(place * batch, (place + 1) * batch)
            ended.pay(self.accounts[row], self._world, own)
            self._made[row] += 1
        g, c, crossed, squared = (
            part.unflatten(0, (len(rows), batch)).sum(1) for part in self._sums(ended)
        )
        gradient = (g - (crossed @ self._baseline[rows].unsqueeze(-1)).squeeze(-1)) / batch
        # A little of the identity: a component that is always zero has no square to fit.
        ridge = 1e-9 * squared.diagonal(dim1=-2, dim2=-1).sum(-1)[:, None, None]
        eye = torch.eye(c.shape[-1], dtype=torch.float64)
        self._baseline[rows] = torch.linalg.solve(squared + ridge * eye, c)
        return gradient

    def _sums(self, ended: Ended) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """Of each episode, what failing costs included."""
        z, g, y, c, crossed, squared = ended.sums
        last = (
            self._settings.failure_cost
            * self._accumulator.discount
            / math.log(self._settings.discount)
        )
        fell = (ended.outcome == int(Outcome.FAILED)).to(torch.float64).unsqueeze(-1)
        return g + last * fell * z, c + last * fell * y, crossed, squared
