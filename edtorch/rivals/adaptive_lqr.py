"""Adaptive linear-quadratic control: recursive least squares, and Riccati's equation at every tick.

The self-tuning regulator of Astrom & Wittenmark, "Adaptive Control", chapter 4 (section 1.1 of the
paper), with certainty equivalence: the model that fits best is taken for the truth.  A little noise
is added to the actions, so that all of it stays identifiable.  The derivative of the observation is
learned, do/dt = W (o, a), as by the learner, from every tick; the gain is the first of 2^doublings
ticks', which there is for every model.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

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
from edtorch.run.rollout import Happened, rollout
from edtorch.run.scaled_sim import World
from edtorch.run.tick import Tick
from edtorch.run.trees import tensors_of, with_tensors
from edtorch.types import Parameters, Transition, replace, select
from edtorch.value.linear.lqr import doubled_lqr
from sims.base import Outcome

_SECONDS_BETWEEN_PAUSES = 0.5


@dataclass(frozen=True)
class AdaptiveLqr:
    """exploration: standard deviation of the noise added to the actions, scaled; prior, forgetting:
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
        check_regulated(problem.policy, problem.weights)
        return AdaptiveLqrSearch(self, problem)


@dataclass(frozen=True)
class _Regulating:
    """The regulators of all seeds (``edtorch.run.tick.Source``).

    They remember gain ``[S, m, n]`` (scaled), model W ``[S, n, n + m]`` (per second), and what the
    estimator remembers.
    """

    settings: AdaptiveLqr
    world: World
    model: DerivativeModel
    fit: RecursiveLeastSquares
    costs: tuple[Tensor, Tensor]

    def initial(self, seeds: int) -> Parameters:
        """Without knowledge."""
        n, m = self.model.states, self.model.actions
        gain = torch.zeros(seeds, m, n, dtype=torch.float64)
        model = torch.zeros(seeds, n, n + m, dtype=torch.float64)
        return {"gain": gain, "model": model, **self.fit.initial(model)}

    def begin(self, memory: Parameters, fresh: Tensor, observation: Tensor, /) -> Parameters:
        """Nothing is forgotten."""
        return memory

    def act(self, memory: Parameters, observation: Tensor, normal: Tensor, /) -> Tensor:
        """The regulator's action, and a little noise."""
        action = matvec(memory["gain"].to(self.world.dtype), observation)
        return explore(action, normal, self.settings.exploration)

    def step(
        self, memory: Parameters, transition: Transition, /, *, improve: bool
    ) -> tuple[Parameters, None]:
        """Fit, then solve; a gain that is not finite leaves the one before."""
        learns = transition.valid
        phi = torch.cat((transition.state, transition.action), dim=-1).to(torch.float64)
        y = self.model.target(transition).to(torch.float64)
        fitted = self.fit.update(memory["model"], memory, phi, y, transition.dt)
        new = {"model": fitted.weight, **fitted.memory}
        memory = memory | {name: select(learns, p, memory[name]) for name, p in new.items()}
        n = transition.state.shape[-1]
        drift, G = (self.world.dt * memory["model"]).split((n, phi.shape[-1] - n), dim=-1)
        F = drift + torch.eye(n, dtype=drift.dtype)
        gain = doubled_lqr(F, G, *self.costs, doublings=self.settings.doublings)
        good = learns & gain.isfinite().all(-1).all(-1)
        return memory | {"gain": select(good, gain, memory["gain"])}, None


class AdaptiveLqrSearch(LinearSearch):
    """All seeds in lockstep; a piece of work is some simulated seconds.

    Seeds that are over stand still; those that go on have then lived for equally many ticks.
    """

    def __init__(self, settings: AdaptiveLqr, problem: Problem) -> None:
        world, count = problem.world, len(problem.seeds)
        n, m = len(world.spec.state), len(world.spec.action)
        super().__init__(problem)
        model = DerivativeModel(n, m, Identity(n + m), period=world.period)
        reward = problem.weights
        costs = (reward.state_cost.to(torch.float64), reward.action_cost.to(torch.float64))
        source = _Regulating(settings, world, model, settings.fit(), costs)
        self._streams = learning_streams(world, problem.seeds)
        self._tick = Tick(source, world)
        start = world.initial(self._streams.at(0).uniform)
        self._here = self._tick.first(source.initial(count), start)
        self._weight = self._here.learners["gain"]
        self._ticks_of_a_piece = max(1, round(settings.piece / world.dt))
        self._clock = 0
        self._lived = [0 for _ in problem.seeds]

    @property
    def model(self) -> Tensor:
        """W ``[S, n, n + m]``, per second."""
        return self._here.learners["model"]

    @property
    def done(self) -> list[bool]:
        """Never: it can always go on."""
        return [False for _ in self.accounts]

    def state(self) -> dict[str, Any]:
        """See ``Resumable``."""
        return {
            **super().state(),
            "clock": self._clock,
            "lived": list(self._lived),
            "population": tensors_of(self._here),
            "world": self._tick.world.memory(),
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """See ``Resumable``."""
        super().restore(state)
        self._clock, self._lived = state["clock"], list(state["lived"])
        here = with_tensors(self._here, state["population"])
        world = self._tick.world.recall(here.worlds.world, state["world"])
        self._here = replace(here, worlds=replace(here.worlds, world=world))

    def advance(self, going: Sequence[bool], pause: Callable[[], None]) -> None:
        """Some seconds."""
        rows = [row for row, goes in enumerate(going) if goes]
        worlds = replace(self._here.worlds, active=torch.tensor(list(going)))
        self._here = replace(self._here, worlds=worlds)
        paused = time.monotonic()
        with torch.inference_mode():
            for happened in rollout(
                self._tick,
                self._here,
                self._streams.at,
                clock=self._clock,
                ticks=self._ticks_of_a_piece,
            ):
                self._clock, self._here = happened.clock, happened.population
                self._weight = self._here.learners["gain"]
                self._pay(rows, happened)
                if time.monotonic() - paused > _SECONDS_BETWEEN_PAUSES:
                    paused = time.monotonic()
                    pause()

    def _pay(self, rows: Sequence[int], happened: Happened[Parameters]) -> None:
        dt = self._tick.world.dt
        for row in rows:
            # From whole ticks, so that no sum of many small numbers drifts.
            self._lived[row] += 1
            self.accounts[row].seconds = self._lived[row] * dt
        if happened.ended:
            outcome = happened.outcome
            success = self._tick.world.success(happened.after.world, outcome) != 0
            for row in outcome.nonzero().flatten().tolist():
                seconds = (happened.clock - int(happened.before.begun[row])) * dt
                end = Outcome(int(outcome[row]))
                self.accounts[row].end(end, seconds, success=bool(success[row]))
