"""Any Gymnasium environment with boxes for observations and actions, as a sim."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from torch import Tensor

from sims.base import Outcome, Quantity, Spec

_TERMINATED, _TRUNCATED, _SUCCESS, _RETURN = -4, -3, -2, -1


class GymnasiumSim:
    """The Gymnasium environment ``env_id``, one copy of it for each row of the batch.

    ======== ==================================================================================
    state    ``[*batch, n + 4]``: the observation; terminated, truncated (0 or 1); success (1 or
             0 by ``info["is_success"]``, -1 where there is none); the return (sum of rewards) so
             far.  Only the first n are observed
    action   ``[*batch, m]``, in the environment's own units
    start    the environment's, seeded by the one uniform number of a restart
    end      terminated: FAILED (or SUCCEEDED, by ``termination``); truncated: TIMED_OUT
    success  as the environment says, else a return of at least its registered threshold, else
             ``sims.base.Spec.survival``
    measures ``return``
    ======== ==================================================================================

    The copies have a memory of their own, so ``step`` and ``restart`` take only the state that was
    returned last; ``initial`` starts everything anew.  A row that has ended stays as it is until
    it is restarted.

    Arguments: ``env_id``: as for ``gymnasium.make``; ``dt``: seconds per step, to be given unless
    the environment has a ``dt``; ``time_limit`` in s, to be given unless the environment has a
    limit of steps; ``state_scale``, ``action_scale``: a divisor for each component (default: the
    greatest size within the bounds where they are finite, else 1); ``state_names``,
    ``action_names``; ``headline``: the component that figures show (default: the first);
    ``clip_action``: whether actions are held within the box; ``termination``: what the
    environment's termination means, "failure" or "success"; ``env_kwargs``: more arguments for
    ``gymnasium.make``.
    """

    def __init__(
        self,
        env_id: str,
        *,
        dt: float | None = None,
        time_limit: float | None = None,
        state_scale: Sequence[float] | None = None,
        action_scale: Sequence[float] | None = None,
        state_names: Sequence[str] | None = None,
        action_names: Sequence[str] | None = None,
        headline: str | None = None,
        clip_action: bool = True,
        termination: Literal["failure", "success"] = "failure",
        env_kwargs: Mapping[str, Any] | None = None,
    ) -> None:
        """Make one copy, to see what it is like."""
        if termination not in ("failure", "success"):
            raise ValueError(
                f"termination={termination!r}: expected 'failure' or 'success' ({env_id})"
            )
        self._id = env_id
        self._kwargs = dict(env_kwargs or {})
        self._ended = Outcome.FAILED if termination == "failure" else Outcome.SUCCEEDED
        try:
            env = self._make()
        except gymnasium.error.Error as error:
            raise ValueError(
                f"env_id={env_id}: expected a Gymnasium environment ({error})"
            ) from error
        self._envs = [env]
        self._last: Tensor | None = None
        observation = _box(env_id, "observation", env.observation_space)
        self._box = _box(env_id, "action", env.action_space)
        if dt is None:
            dt = getattr(env.unwrapped, "dt", None)
        if dt is None:
            raise ValueError(f"dt=None: expected the seconds per step, {env_id} does not say them")
        if not (math.isfinite(dt) and dt > 0):
            raise ValueError(f"dt={dt!r}: expected a finite number of seconds above 0 ({env_id})")
        if time_limit is None:
            steps = env.spec.max_episode_steps if env.spec is not None else None
            if steps is None:
                raise ValueError(f"time_limit=None: expected seconds, {env_id} has no limit")
            time_limit = steps * dt
        if not time_limit >= dt:
            raise ValueError(f"time_limit={time_limit!r}: expected at least dt, {dt} s ({env_id})")
        state = _quantities("state", observation, state_names, state_scale)
        self._spec = Spec(
            name=env_id,
            state=state,
            action=_quantities("action", self._box, action_names, action_scale),
            dt=float(dt),
            time_limit=float(time_limit),
            disturbance_dim=0,
            reset_dim=1,
            clip_action=clip_action,
            headline=state[0].name if headline is None else headline,
            success_return=None if env.spec is None else env.spec.reward_threshold,
            survival=False if termination == "success" else None,
        )
        if self._spec.headline not in [quantity.name for quantity in state]:
            names = ", ".join(quantity.name for quantity in state)
            raise ValueError(f"headline={headline!r}: expected one of {names}")

    @property
    def spec(self) -> Spec:
        """The facts of the domain."""
        return self._spec

    def initial(self, uniforms: Tensor) -> Tensor:
        """Start states ``[*batch, n + 4]``; uniforms ``[*batch, 1]`` in [0, 1) seed the copies."""
        seeds = uniforms.reshape(-1, 1)
        while len(self._envs) < len(seeds):
            self._envs.append(self._make())
        rows = torch.stack([self._reset(k, seeds[k]) for k in range(len(seeds))])
        return self._return(rows.reshape(*uniforms.shape[:-1], -1))

    def restart(self, state: Tensor, mask: Tensor, uniforms: Tensor) -> Tensor:
        """``state`` with a new start where ``mask`` ``[*batch]``, unchanged elsewhere."""
        rows = self._rows(state)
        seeds = uniforms.reshape(-1, 1)
        for k in mask.reshape(-1).nonzero()[:, 0].tolist():
            rows[k] = self._reset(k, seeds[k])
        return self._return(rows.reshape(state.shape))

    def step(self, state: Tensor, action: Tensor, uniforms: Tensor) -> Tensor:
        """The state one step later; action ``[*batch, m]``; uniforms ``[*batch, 0]``."""
        rows = self._rows(state)
        actions = action.detach().cpu().reshape(len(rows), -1).numpy()
        for k, row in enumerate(rows):
            if row[_TERMINATED] or row[_TRUNCATED]:
                continue
            observation, reward, terminated, truncated, info = self._envs[k].step(
                actions[k].astype(self._box.dtype)
            )
            row[:_TERMINATED] = torch.as_tensor(np.asarray(observation))
            row[_TERMINATED], row[_TRUNCATED] = float(terminated), float(truncated)
            if "is_success" in info:
                row[_SUCCESS] = float(bool(info["is_success"]))
            row[_RETURN] += float(reward)
        return self._return(rows.reshape(state.shape))

    def observe(self, state: Tensor) -> Tensor:
        """The observation ``[*batch, n]``."""
        return state[..., :_TERMINATED]

    def outcome(self, state: Tensor) -> Tensor:
        """``Outcome`` of each row as int64 ``[*batch]``; numbers that are not finite are FAILED."""
        outcome = torch.where(state[..., _TRUNCATED] != 0, int(Outcome.TIMED_OUT), 0)
        ended = torch.where(state[..., _SUCCESS] == 0, int(Outcome.FAILED), int(self._ended))
        outcome = torch.where(state[..., _TERMINATED] != 0, ended, outcome)
        return torch.where(state.isfinite().all(-1), outcome, int(Outcome.FAILED))

    def total_reward(self, state: Tensor) -> Tensor:
        """The sum of the environment's rewards so far, ``[*batch]``."""
        return state[..., _RETURN]

    def succeeded(self, state: Tensor) -> Tensor:
        """What ``info["is_success"]`` last was, int64 ``[*batch]``: 1, 0, or -1 without it."""
        return state[..., _SUCCESS].to(torch.int64)

    def measures(self, start: Tensor, final: Tensor, seconds: Tensor) -> dict[str, Tensor]:
        """``return``: the sum of the environment's rewards, ``[*batch]``."""
        return {"return": final[..., _RETURN].clone()}

    def close(self) -> None:
        """Close the copies."""
        for env in self._envs:
            env.close()

    def _make(self) -> gymnasium.Env[Any, Any]:
        return gymnasium.make(self._id, **self._kwargs)

    def _reset(self, k: int, uniform: Tensor) -> Tensor:
        observation, _ = self._envs[k].reset(seed=int(float(uniform) * 2**31))
        row = torch.zeros(len(self._spec.state) + 4, dtype=uniform.dtype)
        row[:_TERMINATED] = torch.as_tensor(np.asarray(observation))
        row[_SUCCESS] = -1.0
        return row

    def _rows(self, state: Tensor) -> Tensor:
        last = self._last
        if last is None:
            raise ValueError(f"state: {self._id} has not been started; expected initial first")
        if state is not last and not (
            state.shape == last.shape and torch.allclose(state, last, 0.0, 0.0, equal_nan=True)
        ):
            raise ValueError(
                f"state: not the one that {self._id} returned last; expected that one, since the"
                " environment has a memory of its own"
            )
        return state.reshape(-1, state.shape[-1]).clone()

    def _return(self, state: Tensor) -> Tensor:
        # A copy, so that changes made outside are noticed.
        self._last = state.clone()
        return state


def _box(env_id: str, which: str, space: gymnasium.Space[Any]) -> spaces.Box:
    if not isinstance(space, spaces.Box) or len(space.shape) != 1:
        raise ValueError(
            f"env_id={env_id}: expected a one-dimensional Box as {which} space, not {space}"
        )
    return space


def _quantities(
    which: str,
    box: spaces.Box,
    names: Sequence[str] | None,
    scales: Sequence[float] | None,
) -> tuple[Quantity, ...]:
    (size,) = box.shape
    if names is None:
        names = [f"{which}_{k}" for k in range(size)]
    if scales is None:
        scales = [
            float(max(abs(low), abs(high))) if np.isfinite([low, high]).all() else 1.0
            for low, high in zip(box.low.astype(float), box.high.astype(float), strict=True)
        ]
    for argument, given in ((f"{which}_names", names), (f"{which}_scale", scales)):
        if len(given) != size:
            raise ValueError(f"{argument}={list(given)}: expected {size} of them")
    for scale in scales:
        if not (math.isfinite(scale) and scale > 0):
            raise ValueError(f"{which}_scale={list(scales)}: expected finite numbers above 0")
    return tuple(
        Quantity(name, "1", float(scale), float(low), float(high))
        for name, scale, low, high in zip(names, scales, box.low, box.high, strict=True)
    )
