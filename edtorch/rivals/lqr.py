"""The linear-quadratic regulator that knows the world: Riccati's equation for the sim itself.

Not a learner but what learners are measured against: it spends no second of experience.  The sim's
step and observation are differentiated where an episode begins most calmly (``calmest_start``), in
the middle of every disturbance; the rest is Anderson & Moore, "Optimal Control: Linear Quadratic
Methods", chapter 3.  It knows neither the bounds of the actions, nor where an episode fails, nor
that angles wrap.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from edtorch.model.features import Identity
from edtorch.policy.policies import LinearPolicy
from edtorch.rewards import QuadraticReward
from edtorch.rivals.base import LinearSearch, Problem
from edtorch.run.scaled_sim import World
from edtorch.value.linear.lqr import NotConverged, stationary_lqr

NEWTON_STEPS = 20


@dataclass(frozen=True)
class Lqr:
    """No settings: the costs are those of the shaping reward, which must cost every action."""

    def begin(self, problem: Problem) -> LqrSearch:
        """Raises ValueError for a reward or policy that Riccati's equation is not for, or a sim
        that cannot be differentiated or stabilised."""
        check_regulated(problem.policy, problem.weights)
        F, G = linearised(problem.world)
        Q, R = (c.to(F) for c in (problem.weights.state_cost, problem.weights.action_cost))
        try:
            theta, _ = stationary_lqr(F, G, Q, R)
        except NotConverged as error:
            raise ValueError(f"{problem.world.spec.name}: {error}") from error
        return LqrSearch(problem, theta)


class LqrSearch(LinearSearch):
    """The same gain for every seed, known at once."""

    def __init__(self, problem: Problem, theta: Tensor) -> None:
        """theta ``[m, n]``, scaled."""
        count = len(problem.seeds)
        super().__init__(problem)
        self._weight = theta.to(problem.policy.weight.dtype).expand(count, -1, -1).contiguous()
        self._done = [False] * count

    @property
    def done(self) -> list[bool]:
        """Whether its policy has been asked for."""
        return list(self._done)

    def state(self) -> dict[str, Any]:
        """See ``Resumable``."""
        return {**super().state(), "done": list(self._done)}

    def restore(self, state: Mapping[str, Any]) -> None:
        """See ``Resumable``."""
        super().restore(state)
        self._done = list(state["done"])

    def advance(self, going: Sequence[bool], pause: Callable[[], None]) -> None:
        """Nothing is left to do."""
        self._done = [done or on for done, on in zip(self._done, going, strict=True)]


def check_regulated(policy: LinearPolicy, reward: QuadraticReward) -> None:
    """Raises ValueError unless the policy is linear in the observation and every action costs."""
    if type(policy) is not LinearPolicy or not isinstance(policy.features, Identity):
        raise ValueError("policy: expected policy=linear with policy.features=identity")
    if not torch.linalg.eigvalsh(reward.action_cost)[0].item() > 0:
        raise ValueError("reward.action: expected a cost > 0 of every action")


def linearised(world: World) -> tuple[Tensor, Tensor]:
    """F ``[n, n]`` and G ``[n, m]`` of o' = F o + G a + constant, scaled observations and actions.

    With the Jacobians A of the step and C of the observation, F C = C A wherever the observation
    is a state of its own; C's pseudoinverse solves that for F.  ValueError for a sim that is not of
    tensor functions alone, or of which some component of the observation does not move with the
    rest of the state.
    """
    if not getattr(world.sim, "traceable", False):
        raise ValueError(
            f"{world.spec.name}: expected a domain of tensor functions alone (traceable), which can"
            " be differentiated"
        )
    start = calmest_start(world)
    calm = torch.full((world.uniforms,), 0.5, dtype=torch.float64)
    rest = torch.zeros(len(world.spec.action), dtype=world.dtype)

    def moved(state: Tensor, action: Tensor) -> Tensor:
        return world.observe(world.step(state, action, calm))

    C = torch.func.jacrev(world.observe)(start).to(torch.float64)
    step, G = torch.func.jacrev(moved, (0, 1))(start, rest)
    if int(torch.linalg.matrix_rank(C)) < C.shape[0]:
        raise ValueError(
            f"{world.spec.name}: expected an observation whose components are independent"
        )
    return step.to(torch.float64) @ torch.linalg.pinv(C), G.to(torch.float64)


def calmest_start(world: World) -> Tensor:
    """The start of an episode ``[k]`` whose observation is nearest to zero.

    By the Gauss-Newton method on the uniform numbers that a start is made of, from their middle.
    """
    u = torch.full((world.uniforms,), 0.5, dtype=torch.float64)

    def seen(u: Tensor) -> Tensor:
        return world.observe(world.initial(u)).to(torch.float64)

    for _ in range(NEWTON_STEPS if world.spec.reset_dim else 0):
        slope = torch.func.jacrev(seen)(u)
        u = (u - torch.linalg.pinv(slope) @ seen(u)).clamp(0.0, 1.0)
    return world.initial(u)
