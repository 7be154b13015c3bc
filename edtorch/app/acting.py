"""A learned policy as its user sees it: physical units, numpy in and out."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from edtorch.learner.learner import Actor
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
        self._dtype = getattr(world.sim, "action_dtype", np.dtype(np.float64))
        self._rows = 1
        self._expanded = parameters
        self.reset()

    @property
    def remembers(self) -> bool:
        """Whether an action depends on earlier observations of the episode."""
        return self._observer is not None or self._world.unwraps

    def reset(self) -> None:
        """Forget the episode so far; the next observation is the first of a new one."""
        self._before: Tensor | None = None
        self._memory: Parameters | None = None
        self._action: Tensor | None = None

    def predict(self, observation: ArrayLike) -> NDArray[Any]:
        """The action ``[m]`` for an observation ``[n]``, or actions ``[k, m]`` for ``[k, n]``, of k
        episodes side by side.  Raises ValueError for other shapes, and for what is not a finite
        number."""
        try:
            given = np.asarray(observation, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise ValueError(f"observation={observation!r}: expected numbers") from error
        if given.ndim not in (1, 2):
            raise ValueError(f"observation: has shape {given.shape}, expected [n] or [k, n]")
        if not np.isfinite(given).all():
            raise ValueError(f"observation={observation}: expected finite numbers")
        rows = given[None] if given.ndim == 1 else given
        with torch.inference_mode():
            action = self._act(torch.as_tensor(rows)).numpy().astype(self._dtype)
        return action[0] if given.ndim == 1 else action

    def _act(self, observed: Tensor) -> Tensor:
        # Not len(), which torch answers in Python.
        world, parameters = self._world, self._for_rows(observed.shape[0])
        viewed = getattr(world.sim, "viewed", None)
        observed = observed if viewed is None else viewed(observed)
        if observed.shape[-1] != len(world.spec.state):
            raise ValueError(
                f"observation: has {observed.shape[-1]} components, expected those of"
                f" {world.spec.name}: {', '.join(q.name for q in world.spec.state)}"
            )
        if self._before is not None and self._before.shape[0] != observed.shape[0]:
            raise ValueError(
                f"observation: {len(observed)} rows, expected the {len(self._before)} episodes of"
                " the call before; call reset() at the start of new ones"
            )
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
