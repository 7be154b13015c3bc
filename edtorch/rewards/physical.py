"""A reward of physical states and actions, seen from the scaled ones of a learner."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor

from edtorch.rewards.base import Reward, quadratic_form_of, target_of
from edtorch.rewards.form import QuadraticForm
from edtorch.shapes import Actions, States
from edtorch.types import Belief


class PhysicalReward:
    """r(s, a) = reward(s * state_scale, a * action_scale).

    What the reward offers beside its value is offered here too, in scaled units.  state_scale
    ``[n]``, action_scale ``[m]``.
    """

    def __init__(self, reward: Reward, state_scale: Tensor, action_scale: Tensor) -> None:
        self.reward = reward
        self.state_scale = state_scale
        self.action_scale = action_scale
        self.actions = action_scale.shape[0]
        self.smooth = getattr(reward, "smooth", True)
        self.timed = getattr(reward, "timed", False)
        self.lifted_squares = getattr(reward, "lifted_squares", None)  # of scaled states already

    def __call__(self, state: States, action: Actions, /) -> Tensor:
        """``[*batch]``."""
        return self.reward(state * self.state_scale, action * self.action_scale)

    @property
    def quadratic_form(self) -> QuadraticForm | None:
        """The reward's, None where it has none."""
        form = quadratic_form_of(self.reward)
        return None if form is None else form.scaled(self.state_scale, self.action_scale)

    @property
    def target(self) -> Tensor | None:
        """The reward's, None where it has none."""
        target = target_of(self.reward)
        return None if target is None else target.to(self.state_scale) / self.state_scale

    @property
    def expected(self) -> Callable[[Belief], Tensor] | None:
        """The reward's expectation of scaled beliefs, None where it has none."""
        offered = getattr(self.reward, "expected", None)
        if offered is None:
            return None
        scale = self.state_scale

        def expected(belief: Belief) -> Tensor:
            cov = belief.cov * scale.unsqueeze(-1) * scale
            return offered(Belief(belief.mean * scale, cov))

        return expected
