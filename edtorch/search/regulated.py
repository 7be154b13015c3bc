"""Search for a regulator: the stationary one at a named equilibrium of the learned model."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor

from edtorch.errors import NoPlan
from edtorch.policy.knots import KnotPolicy
from edtorch.policy.memory import EpisodeMemory
from edtorch.policy.policies import Policy
from edtorch.policy.squash import Squash
from edtorch.search.knowledge import Knowledge
from edtorch.search.problem import Improvement, Left, SearchProblem
from edtorch.search.random_first import RandomFirst
from edtorch.types import Parameters
from edtorch.value.linear.lqr import NotConverged
from edtorch.value.linear.stationary import NoEquilibrium, regulator_about, standing

_STILL = 1e-2
"""Scaled change per second that a learned model may have in the state that is held: the regulator
makes up for it."""


@dataclass(frozen=True)
class RegulatedSearch(RandomFirst):
    """Holds components of the state at values, each trial by the regulator of the model so far.

    held: wanted values by name, physical units: a pole upright, a wheel at its cruising speed;
    empty: those of the reward.  The others are where the model then stands still
    (``edtorch.value.linear.stationary``).  A model of little data may stand still nowhere near;
    then the regulator is that about the wanted values themselves, and a note says so.
    """

    held: Mapping[str, float] = field(default_factory=dict)

    figures = ("transitions", "terms", "model_error", "largest_gain")

    @property
    def prior(self) -> str:
        """See ``TrialLengths``."""
        held = ", ".join(f"{name} {value:g}" for name, value in self.held.items())
        return f"held: {held}" if held else ""

    def actor(self, problem: SearchProblem) -> tuple[Policy, EpisodeMemory | None]:
        """See ``TrialSearch``: one local linear policy.  ValueError for unknown names held, for
        actions that cost nothing, and for a reward with a reference."""
        self._target(problem)
        problem.check_constant("search=regulated")
        problem.check_prices("search=regulated")
        squash = Squash(problem.middle, problem.half)
        return KnotPolicy(1, squash, problem.period, torch.ones_like(problem.period)), None

    def left(self, problem: SearchProblem, parameters: Parameters) -> Left | None:
        """See ``TrialSearch``: never."""
        return None

    def improve(
        self, problem: SearchProblem, knowledge: Knowledge, seed: int, trial: int
    ) -> Improvement:
        """See ``TrialSearch``."""
        target, held = self._target(problem)
        learned = problem.learn(knowledge.transitions(problem.dt), knowledge.trial)
        structure = problem.structures[learned.name]
        weight, notes = learned.posterior.weight, list(learned.notes)
        rows, action = torch.from_numpy(problem.rows[-1].copy()), problem.middle
        try:
            target, action = standing(structure, weight, target, held, action, problem.half, _STILL)
        except NoEquilibrium as error:
            cause = str(error).partition(";")[0]
            notes.append(f"{cause}; regulated about the targets themselves")
        price = torch.from_numpy(problem.action) / problem.half.square()
        try:
            found = regulator_about(structure, weight, target, action, problem.dt, rows, price)
        except NotConverged as error:
            raise NoPlan(str(error)) from error
        raw, gain = Squash(problem.middle, problem.half).inverse(found.action, found.gain)
        return Improvement(
            {
                "state": found.state.unsqueeze(0),
                "raw": raw.unsqueeze(0),
                "gain": gain.unsqueeze(0),
                "factor": gain.new_ones(1),
            },
            knowledge,
            {
                "transitions": float(learned.count),
                "terms": float(structure.terms.count),
                "model_error": learned.error,
                "largest_gain": float(gain.abs().max()),
            },
            tuple(notes),
        )

    def _target(self, problem: SearchProblem) -> tuple[Tensor, Tensor]:
        """Wanted values ``[n]``, scaled, and which of them count; ValueError for unknown names."""
        if not self.held:
            return problem.goal[-1], _named(problem)
        target = torch.zeros(len(problem.names), dtype=torch.float64)
        held = torch.zeros(len(problem.names), dtype=torch.bool)
        for name, value in self.held.items():
            if name not in problem.names:
                raise ValueError(f"held.{name}={value}: expected one of {', '.join(problem.names)}")
            place = problem.names.index(name)
            target[place], held[place] = value / problem.scale[place], True
        return target, held


def _named(problem: SearchProblem) -> Tensor:
    """The components that the reward names, bool ``[n]``, without the rates of those."""
    structure = next(iter(problem.structures.values()))
    named = torch.from_numpy((problem.rows[-1][:, structure.lift.at] != 0).any(0))
    of_named = structure.source[named.numpy() & (structure.source >= 0)]
    named[torch.from_numpy(of_named)] = False
    return named
