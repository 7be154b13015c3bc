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
from edtorch.value.linear.stationary import NoEquilibrium, regulator_at

_STILL = 1e-2
"""Scaled change per second that a learned model may have in the state that is held: the regulator
makes up for it."""


@dataclass(frozen=True)
class RegulatedSearch(RandomFirst):
    """Holds components of the state at values, each trial by the regulator of the model so far.

    held: wanted values by name, physical units: a pole upright, a wheel at its cruising speed.  The
    others are where the model then stands still (``edtorch.value.linear.stationary``).
    """

    held: Mapping[str, float] = field(default_factory=dict)

    figures = ("transitions", "terms", "model_error", "largest_gain")

    @property
    def prior(self) -> str:
        """See ``RandomFirst``."""
        return f"held: {', '.join(f'{name} {value:g}' for name, value in self.held.items())}"

    def actor(self, problem: SearchProblem) -> tuple[Policy, EpisodeMemory | None]:
        """See ``TrialSearch``: one local linear policy.  ValueError for unknown names held, and for
        actions that cost nothing."""
        self._target(problem)
        problem.check_prices("regulated")
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
        try:
            found = regulator_at(
                structure,
                learned.posterior.weight,
                target,
                held,
                problem.middle,
                problem.half,
                problem.dt,
                torch.from_numpy(problem.rows[-1].copy()),
                torch.from_numpy(problem.action),
                _STILL,
            )
        except (NoEquilibrium, NotConverged) as error:
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
            learned.notes,
        )

    def _target(self, problem: SearchProblem) -> tuple[Tensor, Tensor]:
        """Wanted values ``[n]``, scaled, and which of them count; ValueError for unknown names."""
        target = torch.zeros(len(problem.names), dtype=torch.float64)
        held = torch.zeros(len(problem.names), dtype=torch.bool)
        for name, value in self.held.items():
            if name not in problem.names:
                raise ValueError(f"held.{name}={value}: expected one of {', '.join(problem.names)}")
            place = problem.names.index(name)
            target[place], held[place] = value / problem.scale[place], True
        return target, held
