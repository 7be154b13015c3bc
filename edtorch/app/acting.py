"""A learned policy as its user sees it: physical units, numpy in and out."""

from __future__ import annotations

from functools import cached_property
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from edtorch.law import Law, law_of
from edtorch.learner.learner import Actor
from edtorch.policy.clock import EpisodeClock
from edtorch.policy.memory import EpisodeMemory
from edtorch.run.scaled_sim import World
from edtorch.types import Parameters, Transition


class LearnedPolicy:
    """One learned policy.

    ``predict`` takes an observation as the environment gives it and returns the action to take, in
    the environment's units, within its bounds.  Where angles are counted on beyond half a turn, or
    an observer estimates the state, the policy remembers its episode: call ``reset`` before the
    first observation of each one.

    parameters: ``[1, ...]``, those of this policy; observer: None if it takes what it observes for
    the state.
    """

    def __init__(
        self,
        world: World,
        actor: Actor,
        parameters: Parameters,
        observer: EpisodeMemory | None = None,
    ) -> None:
        self.parameters = parameters
        self._world = world
        self._actor = actor
        self._observer = observer
        self._viewed = getattr(world.sim, "viewed", None)
        self._dtype = getattr(world.sim, "action_dtype", np.dtype(np.float64))
        self._rows, self._expanded = 1, parameters
        self.reset()

    def __getstate__(self) -> dict[str, Any]:
        # A law is made again: its functions cannot be pickled.
        return {name: value for name, value in vars(self).items() if name != "_law"}

    @cached_property
    def _law(self) -> Law | None:
        # Other observers are left to torch, as is other precision.
        is_plain = self._observer is None or type(self._observer) is EpisodeClock
        if not is_plain or self._world.dtype != torch.float64:
            return None
        return law_of(self._actor, self.parameters)

    @property
    def remembers(self) -> bool:
        """Whether an action depends on earlier observations of the episode."""
        return self._observer is not None or self._world.unwraps

    def reset(self) -> None:
        """Forget the episode so far; the next observation is the first of a new one."""
        self._episodes: int | None = None
        self._before: Tensor | None = None
        self._memory: Parameters | None = None
        self._action: Tensor | None = None
        self._reading: NDArray[Any] | None = None
        self._ticks = 0

    def predict(self, observation: ArrayLike) -> NDArray[Any]:
        """The action ``[m]`` for an observation ``[n]``, or actions ``[k, m]`` for ``[k, n]``, of k
        episodes side by side.  Raises ValueError for other shapes, and for what is not a finite
        number."""
        try:
            # A copy: the caller may write its next reading into the same array.
            given = np.asarray(observation, dtype=np.float64).copy()
        except (TypeError, ValueError) as error:
            raise ValueError(f"observation={observation!r}: expected numbers") from error
        if given.ndim not in (1, 2):
            raise ValueError(f"observation: has shape {given.shape}, expected [n] or [k, n]")
        if not np.isfinite(given).all():
            raise ValueError(f"observation={observation}: expected finite numbers")
        rows = self._seen(given[None] if given.ndim == 1 else given)
        if self._law is not None and len(rows) == 1:
            action = self._act_alone(self._law, rows[0])[None]
        else:
            with torch.inference_mode():
                action = self._act(torch.from_numpy(rows)).numpy()
        action = action.astype(self._dtype)
        return action[0] if given.ndim == 1 else action

    def _seen(self, rows: NDArray[Any]) -> NDArray[Any]:
        """What the learner sees of observations, ``[k, n]``, checked."""
        spec = self._world.spec
        if self._viewed is not None:
            rows = self._viewed(torch.from_numpy(rows)).numpy()
        if rows.shape[1] != len(spec.state):
            raise ValueError(
                f"observation: has {rows.shape[1]} components, expected those of"
                f" {spec.name}: {', '.join(q.name for q in spec.state)}"
            )
        if self.remembers:
            if self._episodes not in (None, len(rows)):
                raise ValueError(
                    f"observation: {len(rows)} rows, expected the {self._episodes} episodes of the"
                    " call before; call reset() at the start of new ones"
                )
            self._episodes = len(rows)
        return rows

    def _act_alone(self, law: Law, observed: NDArray[Any]) -> NDArray[Any]:
        """``_act`` of one episode, on numpy."""
        state = self._world.counted_array(observed, self._reading)
        self._reading = state
        if self._observer is not None:
            state = np.concatenate((state, (self._ticks,)))
            self._ticks += 1
        return self._world.physical_array(law(state))

    def _act(self, observed: Tensor) -> Tensor:
        # Not len(), which torch answers in Python.
        world, parameters = self._world, self._for_rows(observed.shape[0])
        now = world.counted(observed, self._before)
        state = now
        if self._observer is not None:
            state = self._estimate(self._observer, parameters, now)
        action = world.clip(self._actor.action(parameters, state))
        if self.remembers:
            self._before, self._action = now, action
        return world.physical(action)

    def _estimate(self, observer: EpisodeMemory, parameters: Parameters, now: Tensor) -> Tensor:
        if self._memory is None or self._before is None or self._action is None:
            self._memory = observer.initial(now)
        else:
            valid = torch.ones(now.shape[0], dtype=torch.bool)
            seconds = self._world.seconds
            happened = Transition(self._before, self._action, now, seconds, valid)
            self._memory = observer.follow(parameters, self._memory, happened)
        return observer.now(parameters, self._memory, now)

    def _for_rows(self, rows: int) -> Parameters:
        if rows != self._rows:
            self._rows = rows
            self._expanded = {
                name: p.repeat_interleave(rows, dim=0) for name, p in self.parameters.items()
            }
        return self._expanded
