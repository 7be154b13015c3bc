"""Adaptive linear-quadratic control: recursive least squares, and Riccati's equation at every tick.

The self-tuning regulator of Astrom & Wittenmark, "Adaptive Control", chapter 4 (section 1.1 of the
paper), with certainty equivalence: the model that fits best is taken for the truth.  A little noise
is added to the actions, so that all of it stays identifiable.  The derivative of the observation is
learned, do/dt = W (o, a), as by the learner, from every tick; the gain is the first of 2^doublings
ticks', which there is for every model.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from edtorch.linalg import matvec
from edtorch.model.features import Identity
from edtorch.model.fit import RecursiveLeastSquares
from edtorch.model.models import DerivativeModel
from edtorch.policy.policies import explore
from edtorch.rivals.base import LinearSearch, Problem
from edtorch.rivals.lqr import check_regulated
from edtorch.run.random import learning_streams
from edtorch.types import Transition, select
from edtorch.value.linear.lqr import doubled_lqr
from sims.base import Outcome

SECONDS_BETWEEN_PAUSES = 0.5


@dataclass(frozen=True)
class AdaptiveLqr:
    """exploration: standard deviation of what is added to the actions, scaled; prior, forgetting:
    of the least squares (``edtorch.model.fit.RecursiveLeastSquares``); doublings: the horizon is 2
    to this power, in ticks; piece: simulated seconds from one checkpoint to the next.  The costs
    are those of the shaping reward, which must cost every action."""

    exploration: float = 0.05
    prior: float = 1000.0
    forgetting: float = 1.0
    doublings: int = 10
    piece: float = 0.5

    def __post_init__(self) -> None:
        """Refuse impossible arguments."""
        if not self.exploration >= 0:
            raise ValueError(f"exploration={self.exploration}: expected a number >= 0")
        if not 1 <= self.doublings <= 30:
            raise ValueError(f"doublings={self.doublings}: expected an integer from 1 to 30")
        if not self.piece > 0:
            raise ValueError(f"piece={self.piece}: expected a number > 0 (s)")
        self.fit()

    def fit(self) -> RecursiveLeastSquares:
        """The estimator."""
        return RecursiveLeastSquares(self.prior, self.forgetting)

    def begin(self, problem: Problem) -> AdaptiveLqrSearch:
        """Every seed without knowledge.  Raises ValueError for a reward or policy that Riccati's
        equation is not for."""
        check_regulated(problem.policy, problem.reward)
        return AdaptiveLqrSearch(self, problem)


class AdaptiveLqrSearch(LinearSearch):
    """All seeds in lockstep; a piece of work is some seconds of riding.

    Seeds that are over stand still; those that go on have then lived for equally many ticks.
    """

    def __init__(self, settings: AdaptiveLqr, problem: Problem) -> None:
        world, count = problem.world, len(problem.seeds)
        n, m = len(world.spec.state), len(world.spec.action)
        super().__init__(problem)
        self._settings, self._world = settings, world
        self._fit = settings.fit()
        self._model = DerivativeModel(n, m, Identity(n + m), period=world.period)
        self._streams = learning_streams(world, problem.seeds)
        self._costs = tuple(
            c.to(torch.float64) for c in (problem.reward.state_cost, problem.reward.action_cost)
        )
        self._ticks_of_a_piece = max(1, round(settings.piece / world.dt))
        self._clock = 0
        self._state = world.initial(self._streams.at(0).uniform)
        self._observation = world.observe(self._state)
        self._ticks = torch.zeros(count, dtype=torch.int64)
        self._model_weight = torch.zeros(count, n, n + m, dtype=torch.float64)
        self._memory = self._fit.initial(self._model_weight)
        self._weight = torch.zeros(count, m, n, dtype=torch.float64)
        self._lived = [0 for _ in problem.seeds]

    @property
    def model(self) -> Tensor:
        """W ``[S, n, n + m]``, per second."""
        return self._model_weight

    @property
    def done(self) -> list[bool]:
        """Never: it can always go on."""
        return [False for _ in self.accounts]

    def advance(self, going: Sequence[bool], pause: Callable[[], None]) -> None:
        """Some seconds."""
        active = torch.tensor(list(going))
        paused = time.monotonic()
        with torch.inference_mode():
            for _ in range(self._ticks_of_a_piece):
                self._tick(active)
                if time.monotonic() - paused > SECONDS_BETWEEN_PAUSES:
                    paused = time.monotonic()
                    pause()

    def _tick(self, active: Tensor) -> None:
        world = self._world
        self._clock += 1
        draw = self._streams.at(self._clock)
        action = matvec(self._weight.to(world.dtype), self._observation)
        action = world.clip(explore(action, draw.normal, self._settings.exploration))
        moved = world.step(self._state, action, draw.uniform)
        seen = world.observe(moved, self._observation)
        self._learn(active, action, seen)
        self._ticks = self._ticks + active
        ended = active & (world.outcome(moved, self._ticks) != int(Outcome.RUNNING))
        self._pay(active, ended, moved)
        self._state = select(active, moved, self._state)
        self._observation = select(active, seen, self._observation)
        if bool(ended.any()):
            self._state = world.restart(self._state, ended, draw.uniform)
            self._observation = select(ended, world.observe(self._state), self._observation)
            self._ticks = torch.where(ended, 0, self._ticks)

    def _learn(self, active: Tensor, action: Tensor, seen: Tensor) -> None:
        """Fit, then solve; a gain that is not finite leaves the one before."""
        world = self._world
        transition = Transition(self._observation, action, seen, world.seconds, active)
        phi = torch.cat((self._observation, action), dim=-1).to(torch.float64)
        y = self._model.target(transition).to(torch.float64)
        fitted = self._fit.update(self._model_weight, self._memory, phi, y, world.seconds)
        self._model_weight = select(active, fitted.weight, self._model_weight)
        self._memory = {k: select(active, p, self._memory[k]) for k, p in fitted.memory.items()}
        n = seen.shape[-1]
        drift, G = (world.dt * self._model_weight).split((n, phi.shape[-1] - n), dim=-1)
        F = drift + torch.eye(n, dtype=drift.dtype)
        gain = doubled_lqr(F, G, *self._costs, doublings=self._settings.doublings)
        good = active & gain.isfinite().all(-1).all(-1)
        self._weight = select(good, gain, self._weight)

    def _pay(self, active: Tensor, ended: Tensor, moved: Tensor) -> None:
        world = self._world
        outcome = world.outcome(moved, self._ticks)
        for row in active.nonzero().flatten().tolist():
            # From whole ticks, so that no sum of many small numbers drifts.
            self._lived[row] += 1
            self.accounts[row].seconds = self._lived[row] * world.dt
        for row in ended.nonzero().flatten().tolist():
            seconds = int(self._ticks[row]) * world.dt
            self.accounts[row].end(Outcome(int(outcome[row])), seconds)
