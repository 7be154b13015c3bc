"""Plans executed without a clock, and a goal that is held as long as a trial lasts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from edtorch.errors import NoPlan
from edtorch.policy.knots import KnotPolicy
from edtorch.policy.memory import EpisodeMemory
from edtorch.policy.policies import Policy
from edtorch.policy.squash import Squash
from edtorch.search.execution import Carried
from edtorch.search.imagination import Futures, Knots, imagine_knots
from edtorch.search.plan import Cost, Plan
from edtorch.search.problem import Left, SearchProblem
from edtorch.search.tick_model import TickModel
from edtorch.types import Parameters
from edtorch.value.linear.lqr import NotConverged
from edtorch.value.linear.stationary import NoEquilibrium, StationaryRegulator, regulator_at


@dataclass(frozen=True)
class Stationary:
    """A policy with knots at the states of a plan, each with its raw action and gain, and one at
    the goal (``edtorch.policy.knots``).

    The goal's is the regulator of the learned model about its equilibrium there; its distance
    counts ``attraction`` times.  width: of the radial functions, in units of rad, of positions and
    of the scales of rates.
    """

    attraction: float = 0.35
    width: float = 0.1

    def actor(self, problem: SearchProblem, ticks: int) -> tuple[Policy, EpisodeMemory | None]:
        """See ``Execution``."""
        problem.check_constant("search.policy=stationary")
        problem.check_prices("search.policy=stationary")
        squash, metric = Squash(problem.middle, problem.half), _metric(problem)
        policy = KnotPolicy(ticks + 1, squash, problem.period, metric, self.width)
        return policy, None

    def carried(
        self,
        problem: SearchProblem,
        model: TickModel,
        cost: Cost,
        plans: Sequence[Plan],
        futures: Futures,
    ) -> list[Carried]:
        """See ``Execution``."""
        goal, metric = goal_knot(problem, model, cost), _metric(problem).numpy()
        found = []
        for plan in plans:
            parameters = {
                "state": np.concatenate((plan.state[:-1], goal.state[:1])),
                "raw": np.concatenate((plan.raw, goal.raw)),
                "gain": np.concatenate((plan.gain, goal.gain)),
                "factor": np.append(np.ones(len(plan.raw)), self.attraction),
            }
            knots = Knots(**parameters, metric=metric, width=self.width)
            found.append(Carried(parameters, imagine_knots(model, cost, knots, futures)))
        return found

    def left(self, problem: SearchProblem, parameters: Parameters, limit: float) -> Left | None:
        """See ``Execution``: never, as it follows no clock."""
        return None


def goal_knot(problem: SearchProblem, model: TickModel, cost: Cost) -> Plan:
    """The regulator at the goal as a plan of one tick, in raw actions.

    Where no action holds all that the goal names (a pole leans a little on a model that errs), only
    components of which the model is independent stay there, and the rest is the nearest
    equilibrium.  Raises NoPlan where there is none, or it cannot be held.
    """
    lift, rows = model.structure.lift, np.array(cost.rows[-1])
    acts = np.zeros(lift.size, bool)
    acts[model.structure.terms.factors] = True
    named = (rows[:, lift.at] != 0).any(0)
    try:
        try:
            found = _regulator(problem, model, cost, named)
        except NoEquilibrium:
            found = _regulator(problem, model, cost, named & ~acts[lift.at])
    except (NoEquilibrium, NotConverged) as error:
        raise NoPlan(f"the goal cannot be held: {error}") from error
    raw, gain = Squash(problem.middle, problem.half).inverse(found.action, found.gain)
    state = found.state.numpy()
    return Plan(np.stack([state, state]), raw.numpy()[None], gain.numpy()[None], 0.0)


def _regulator(
    problem: SearchProblem, model: TickModel, cost: Cost, held: np.ndarray
) -> StationaryRegulator:
    return regulator_at(
        model.structure,
        torch.from_numpy(model.weight),
        problem.goal[-1],
        torch.from_numpy(held),
        problem.middle,
        problem.half,
        problem.dt,
        torch.from_numpy(np.array(cost.rows[-1])),
        torch.from_numpy(cost.action),
    )


def _metric(problem: SearchProblem) -> torch.Tensor:
    """``[n]``: a radian of angles, 1 of what else there is, scaled."""
    angle = problem.period > 0
    return torch.where(angle, problem.period / (2 * torch.pi), torch.ones_like(problem.period))
