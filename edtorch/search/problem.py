"""The task as a search between trials sees it, and what it returns."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from torch import Tensor

from edtorch.model.batch_fit import LearnedModel
from edtorch.model.mechanism import Structure
from edtorch.model.stops import Stops
from edtorch.model.told import Told
from edtorch.policy.memory import EpisodeMemory
from edtorch.policy.policies import Policy
from edtorch.search.exploring import Perturbed, RandomActions
from edtorch.search.hybrid_fit import LearnedHybrid
from edtorch.search.knowledge import Knowledge
from edtorch.search.package import Package
from edtorch.search.tick_model import TickModel
from edtorch.types import Parameters, Transition


@dataclass(frozen=True)
class SearchProblem:
    """All in scaled units.

    names, scale ``[n]``: of the components of the state; structures: models to choose from, by
    name, the simpler first; learn: the best of them from transitions and the trial of each; rows
    ``[H + 1, r, A]`` and action ``[m]``: as of ``edtorch.search.plan.Cost``; middle, half ``[m]``:
    of the range of the actions; period ``[n]``: of angles, else 0; dt: s; starts: of a seed to
    readings ``[k, n]`` of starts; judge: of true states ``[*batch, H + 1, n]`` to whether the task
    is done, bool ``[*batch]``, None where the domain has no criterion; noise ``[n]``: standard
    deviations of readings where they are known; goal ``[H + 1, n]``: the target states of the rows;
    told: of the components and actions; stops: None where none are told; hybrid: a model with
    strikes from transitions, over ticks of so many steps, None where no strike is told.
    """

    names: Sequence[str]
    scale: Tensor
    structures: Mapping[str, Structure]
    learn: Callable[[Transition, Tensor], LearnedModel]
    rows: np.ndarray
    action: np.ndarray
    middle: Tensor
    half: Tensor
    period: Tensor
    dt: float
    starts: Callable[[int], Tensor]
    judge: Callable[[Tensor], Tensor] | None
    noise: Tensor | None
    goal: Tensor
    told: Told
    stops: Stops | None = None
    hybrid: Callable[[Transition, int], LearnedHybrid] | None = None

    @property
    def ticks(self) -> int:
        """H, the horizon."""
        return len(self.rows) - 1

    def tick_model(
        self, learned: LearnedModel, substeps: int, *, saltation: bool = True
    ) -> TickModel:
        """The learned model over a tick, in ``substeps`` steps of Runge and Kutta's method."""
        return TickModel(
            self.structures[learned.name],
            learned.posterior.weight.numpy(),
            self.dt,
            self.middle.numpy(),
            self.half.numpy(),
            substeps,
            learned.stops,
            saltation,
        )

    def noise_of(self, learned: LearnedModel) -> Tensor:
        """Standard deviations ``[n]`` of readings: the known ones, else estimates."""
        return learned.reading_noise if self.noise is None else self.noise

    def check_constant(self, group: str) -> None:
        """Reject a reward that follows a reference, for policies without a clock.  ValueError
        begins with ``group``."""
        if bool((self.rows != self.rows[:1]).any()):
            raise ValueError(
                f"{group}: expected a reward without a reference, which search=planned with"
                " policy=timed follows"
            )

    def check_prices(self, group: str) -> None:
        """Reject actions that cost nothing, for regulators.  ValueError begins with ``group``."""
        if not (self.action > 0).all():
            raise ValueError(
                f"{group}: expected a reward in which every action has a weight > 0"
                " (reward.action.NAME)"
            )


def ticks_of(name: str, seconds: float | None, most: int, dt: float, of: str) -> int:
    """Seconds of a setting as ticks, ``most`` for None; of: what the limit belongs to, for the
    message.  Raises ValueError."""
    ticks = most if seconds is None else round(seconds / dt)
    if not 1 <= ticks <= most:
        raise ValueError(
            f"{name}={seconds}: expected seconds from {dt:g} to {dt * most:g}, the length of {of}"
        )
    return ticks


Left = Callable[[int, Tensor], Tensor]
"""(tick, readings ``[B, n]``) to whether each trial is to be aborted, bool ``[B]``."""


@dataclass(frozen=True)
class Improvement:
    """The result of learning from a trial: parameters of the policy, without a population axis; the
    knowledge with its plan; figures by name, for ``metrics.csv``; notes: lines for the user."""

    parameters: Parameters
    knowledge: Knowledge
    figures: Mapping[str, float]
    notes: tuple[str, ...] = ()


class TrialSearch(Protocol):
    """A search that acts for a trial at a time.

    trial: seconds of a trial, None: as long as an episode; random: of the first trials, None: as
    long as any; random_trials: how many there are.  figures: names of those of an ``Improvement``;
    models_strikes: whether it takes a strike that is told.
    """

    trial: float | None
    random: float | None
    random_trials: int
    figures: tuple[str, ...]
    models_strikes: bool

    @property
    def prior(self) -> str:
        """Prior knowledge of the task beyond that of the state's components, in words."""
        ...

    @property
    def packages(self) -> Mapping[str, Package]:
        """Those that it needs, by the setting that needs them."""
        ...

    def runs(self, number: int) -> int:
        """How many runs the trial of this number has, each up to its end or the trial's length."""
        ...

    def explored(
        self, problem: SearchProblem, seeds: Sequence[int], number: int
    ) -> RandomActions | Perturbed:
        """What acts in the first trials, and for seeds without a policy: in each run of each seed,
        those of a seed side by side."""
        ...

    def actor(self, problem: SearchProblem) -> tuple[Policy, EpisodeMemory | None]:
        """The policy that takes the parameters of an improvement, and its memory if it has one."""
        ...

    def left(self, problem: SearchProblem, parameters: Parameters) -> Left | None:
        """When a trial with these parameters ``[B, ...]`` is to be aborted; None: never."""
        ...

    def improve(
        self, problem: SearchProblem, knowledge: Knowledge, seed: int, trial: int
    ) -> Improvement:
        """A policy from all trials so far; trial: the number of the next one."""
        ...
