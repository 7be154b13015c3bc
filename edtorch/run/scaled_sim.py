"""A sim in a learner's units: states and actions divided by the domain's scales, what an episode
earns and when it is a success."""

from __future__ import annotations

import math
from functools import cached_property
from typing import Any

import numpy as np
import torch
from jaxtyping import Float
from numpy.typing import NDArray
from torch import Tensor

from edtorch.rewards import Reward
from edtorch.run.success import SuccessRule
from edtorch.shapes import Actions, Features, States
from edtorch.types import Transition
from sims.base import Actuated, Fallible, Losing, Outcome, Remembering, Rewarded, Sim


class World:
    """Wraps ``sim``; all states and actions seen here are scaled, in ``dtype`` on ``device``.

    The sim itself computes in float64: positions of a kilometre and angles of a microradian meet in
    it, whatever precision the learner works in.

    unwrap: how far (rad) beyond half a turn an angle is counted on before it is wrapped again; None
    wraps it always.  A policy linear in a wrapped angle reverses its command behind the back, where
    half a turn to the left becomes one to the right.

    reward: of scaled states and actions, per second, for the return of an episode where the sim has
    none of its own (``sims.base.Rewarded``); success_return: the return from which an episode is a
    success, None for the domain's (``edtorch.run.success``).
    """

    def __init__(
        self,
        sim: Sim,
        dtype: torch.dtype = torch.float64,
        device: torch.device | None = None,
        unwrap: float | None = None,
        reward: Reward | None = None,
        success_return: float | None = None,
    ) -> None:
        if unwrap is not None and not 0 <= unwrap < math.pi:
            raise ValueError(f"unwrap={unwrap}: expected a number in [0, pi) (rad), or null")
        self.sim = sim
        self.reward = reward
        self.has_return = reward is not None or isinstance(sim, Rewarded)
        if success_return is not None and not self.has_return:
            raise ValueError(
                f"success_return={success_return}: expected null for {sim.spec.name} without a"
                " reward, whose episodes have no return"
            )
        self.rule = SuccessRule.of(sim.spec, success_return)
        self.spec = sim.spec
        self.dtype = dtype
        self.device = device or torch.device("cpu")
        self.dt = sim.spec.dt
        self.seconds = self._tensor(sim.spec.dt)
        self.limit_ticks = round(sim.spec.time_limit / sim.spec.dt)
        state, action = sim.spec.state, sim.spec.action
        self._state_scale = torch.tensor(
            [q.scale for q in state], dtype=torch.float64, device=self.device
        )
        self._action_scale = self._tensor([q.scale for q in action])
        self._low = self._tensor([q.low / q.scale for q in action])
        self._high = self._tensor([q.high / q.scale for q in action])
        self.period = self._tensor([q.period / q.scale for q in state])
        self.unwraps = unwrap is not None and any(q.period for q in state)
        beyond = 0.0 if unwrap is None else unwrap / (2 * math.pi)
        farthest = [(0.5 + beyond) * q.period / q.scale for q in state]
        self.farthest = self._tensor(farthest)
        self.turns = self._tensor([q.scale / q.period if q.period else 0.0 for q in state])

    @property
    def action_middle(self) -> Tensor:
        """The middle of the range of each action ``[m]``, scaled; 0 where it is unbounded."""
        bounded = self._low.isfinite() & self._high.isfinite()
        return torch.where(bounded, (self._low + self._high) / 2, 0.0)

    @property
    def action_half_range(self) -> Tensor:
        """Half the range of each action ``[m]``, scaled; 1 where it is unbounded."""
        bounded = self._low.isfinite() & self._high.isfinite()
        return torch.where(bounded, (self._high - self._low) / 2, 1.0)

    def _tensor(self, numbers: float | list[float]) -> Tensor:
        return torch.tensor(numbers, dtype=self.dtype, device=self.device)

    @property
    def uniforms(self) -> int:
        """Uniform numbers that a tick consumes: the disturbances, then those of a restart."""
        return self.spec.disturbance_dim + self.spec.reset_dim

    def initial(self, uniform: Float[Tensor, "*batch u"]) -> Features:
        """Start states of the sim, ``[B, k]``, from a tick's uniforms ``[B, u]``."""
        return self.sim.initial(uniform[..., self.spec.disturbance_dim :].to(torch.float64))

    def restart(self, state: Tensor, mask: Tensor, uniform: Tensor) -> Tensor:
        """New starts where ``mask`` ``[B]``."""
        reset = uniform[..., self.spec.disturbance_dim :].to(torch.float64)
        return self.sim.restart(state, mask, reset)

    def observe(self, state: Features, before: States | None = None) -> States:
        """Scaled observation ``[B, n]``; before ``[B, n]``: the one that angles are counted on
        from, None at the start of an episode."""
        return self.counted(self.sim.observe(state), before)

    def counted(self, observed: States, before: States | None = None) -> States:
        """``observe`` of what the sim lets a learner see, ``[B, n]`` in physical units."""
        wrapped = (observed / self._state_scale).to(self.dtype)
        if before is None or not self.unwraps:
            return wrapped
        turns = torch.round((before - wrapped) * self.turns)
        counted = wrapped + turns * self.period
        return torch.where(counted.abs() <= self.farthest, counted, wrapped)

    def counted_array(self, observed: NDArray[Any], before: NDArray[Any] | None) -> NDArray[Any]:
        """``counted`` of one observation ``[n]`` on numpy, for worlds in float64."""
        scale, _, _, _, turns, period, farthest = self._arrays
        wrapped = observed / scale
        if before is None or not self.unwraps:
            return wrapped
        counted = wrapped + np.rint((before - wrapped) * turns) * period
        return np.where(np.abs(counted) <= farthest, counted, wrapped)

    def physical_array(self, action: NDArray[Any]) -> NDArray[Any]:
        """``physical`` of ``clip`` of one action ``[m]`` on numpy."""
        _, unit, low, high, *_ = self._arrays
        if self.spec.clip_action:
            action = np.minimum(np.maximum(action, low), high)
        return action * unit

    @cached_property
    def _arrays(self) -> tuple[NDArray[Any], ...]:
        own = self._state_scale, self._action_scale, self._low, self._high
        return tuple(each.numpy() for each in (*own, self.turns, self.period, self.farthest))

    def clip(self, action: Actions) -> Actions:
        """The scaled action as it acts: within its bounds where the domain clips."""
        if not self.spec.clip_action:
            return action
        return torch.clamp(action, self._low, self._high)

    def step(
        self, state: Features, action: Actions, uniform: Float[Tensor, "*batch u"]
    ) -> Features:
        """The sim's state one tick later; action ``[B, m]`` scaled, from ``clip``."""
        disturbance = uniform[..., : self.spec.disturbance_dim].to(torch.float64)
        return self.sim.step(state, self.physical(action), disturbance)

    def physical(self, action: Actions) -> Actions:
        """A scaled action ``[B, m]`` in physical units, float64."""
        return (action * self._action_scale).to(torch.float64)

    def scaled(self, action: Actions) -> Actions:
        """An action in physical units ``[B, m]``, scaled."""
        return action.to(self.dtype) / self._action_scale

    def applied(self, state: Tensor, action: Tensor) -> Tensor:
        """What the step to ``state`` applied, scaled; ``action`` if the sim cannot say."""
        if not isinstance(self.sim, Actuated):
            return action
        return self.scaled(self.sim.applied(state))

    def stepped(self, state: Tensor, active: Tensor) -> Tensor:
        """Whether the step to ``state`` of those that are ``active`` ``[B]`` really was one."""
        if not isinstance(self.sim, Fallible):
            return active
        return active & self.sim.stepped(state)

    def earned(self, before: Tensor, state: Tensor, transition: Transition) -> Tensor:
        """Return of each episode so far, float64 ``[B]``: the sim's own sum of rewards up to
        ``state``, else ``before`` plus dt r(s, a) of the transition that led there; ``before``
        where there is neither (``has_return``)."""
        if isinstance(self.sim, Rewarded):
            return self.sim.total_reward(state).to(torch.float64)
        if self.reward is None:
            return before
        reward = self.reward(transition.state, transition.action)
        return before + self.dt * reward.to(torch.float64)

    def outcome(self, state: Tensor, ticks: Tensor, earned: Tensor | None = None) -> Tensor:
        """``Outcome`` of each episode, ``[B]``, its time limit included; ticks ``[B]`` so far;
        earned ``[B]``: its return so far, None for the sim's own."""
        outcome = self.sim.outcome(state)
        late = (outcome == int(Outcome.RUNNING)) & (ticks >= self.limit_ticks)
        outcome = torch.where(late, int(Outcome.TIMED_OUT), outcome)
        if earned is None and isinstance(self.sim, Rewarded):
            earned = self.sim.total_reward(state)
        return self.rule.outcome(self.sim, state, outcome, earned)

    def success(self, state: Tensor, outcome: Tensor) -> Tensor:
        """See ``SuccessRule.success``; state ``[B, k]``: the last one of each episode."""
        return self.rule.success(self.sim, state, outcome)

    def memory(self) -> dict[str, Tensor]:
        """What the future depends on beside the state, see ``sims.base.Remembering``; of most sims
        nothing."""
        return self.sim.memory() if isinstance(self.sim, Remembering) else {}

    def recall(self, state: Tensor, memory: dict[str, Tensor]) -> Tensor:
        """Go on, in a new world, from the sim's state ``[B, k]`` that another one returned last;
        memory: what it then was there.  Returns the state, in which episodes that could not be
        brought back are lost."""
        return self.sim.recall(state, memory) if isinstance(self.sim, Remembering) else state

    def lost(self, state: Tensor) -> Tensor:
        """Whether each episode was lost to a fault of the simulator, bool ``[B]``."""
        if isinstance(self.sim, Losing):
            return self.sim.lost(state)
        return torch.zeros(state.shape[:-1], dtype=torch.bool, device=state.device)
