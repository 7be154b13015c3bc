"""Any Gymnasium environment with boxes for observations and actions, as a sim."""

from __future__ import annotations

import logging
import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Any, Literal

import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from torch import Tensor

from sims.angle_hint import AngleHint
from sims.angle_view import Angles, AngleView, angle_view, with_rates
from sims.base import Outcome, Quantity, SimulatorFailed, Spec, are_names, expect_action
from sims.gymnasium_copy import Actions, Copy, packed, unpacked
from sims.gymnasium_source import (
    Env,
    Factory,
    action_box,
    belongs_to,
    bounds,
    finite_but_none,
    observation_box,
    source_of,
    stated_dt,
    stated_limit,
    stated_threshold,
    taken_by,
)

logger = logging.getLogger("edtorch")

_TERMINATED, _TRUNCATED, _SUCCESS, _LOST, _RETURN = -5, -4, -3, -2, -1
_UNSTATED_LIMIT = 1000
"""Steps of an episode where the environment states no limit."""
_FOUR_VALUES = "not enough values to unpack (expected 5, got 4)"
_HOPELESS = 10
"""Episodes lost at their first step, and none other before, after which the environment is
refused."""


class GymnasiumSim:
    """A Gymnasium environment, one copy of it for each row of the batch.

    ======== ==================================================================================
    state    ``[*batch, k + 5]``: the environment's observation; terminated, truncated, also by
             ``time_limit`` (0 or 1); success (1 or 0 by ``info["is_success"]``, -1 where there is
             none); lost (0 or 1); the return (sum of rewards) so far
    observed ``[*batch, n]``: the first k, or the view of them in which ``angles`` are angles
    action   ``[*batch, m]``, in the environment's own units
    start    the environment's, seeded by the one uniform number of a restart
    end      terminated: FAILED (or SUCCEEDED, by ``termination``); truncated: TIMED_OUT
    success  as the environment says, else a return of at least its registered threshold (not with a
             ``time_limit`` below its own), else ``sims.base.Spec.survival``
    lost     the environment raised an error, or gave numbers that are not finite, or an observation
             of another shape: the episode ends there and counts for nothing
    measures ``return``
    ======== ==================================================================================

    The copies have a memory of their own, so ``step`` and ``restart`` take only the state that was
    returned last; ``initial`` starts everything anew.  A row that has ended stays as it is until
    it is restarted.  ``recall`` resets new copies with the seeds of the episodes and repeats their
    actions: where that leads elsewhere, the environment does not repeat itself under its seed, and
    the episode is lost.  What an environment keeps from one episode to the next without showing it
    may go unnoticed: after some episodes, BipedalWalker-v3 goes on with other digits.

    Arguments: ``env_id``: as for ``gymnasium.make``, with ``env_kwargs``; or ``env``: a factory
    without arguments, or an environment, which is copied by its spec where it has one.  ``dt``:
    seconds per step, to be given unless the environment states them (``dt``, ``tau``, or
    ``control_timestep`` of dm_control); ``time_limit`` in s (default: the environment's limit of
    steps, or 1000 where it states none; ``notes`` says so); ``state_names``, ``action_names``;
    ``angles``: see ``sims.angle_view``; ``rates``: components by the names of their rates;
    ``state_scale``, ``action_scale``: a divisor for each component, in order or by name (default:
    the greatest size within the bounds where they are finite, else 1; a bound of at least 1e30, or
    the largest number of its type, counts as infinite, as ``notes`` says; an action without bounds
    needs one); ``headline``: the component that figures show (default: the first); ``clip_action``:
    whether actions are held within the box; ``termination``: what the environment's termination
    means, "failure" (then lasting to the time limit is a success) or "success" (then it is none);
    by default it is a failure where the environment does not say or pay otherwise.  ``notes``: what
    a user should know of these defaults, and of pairs that look like cosine and sine where no
    ``angles`` are given, one line each.
    """

    def __init__(
        self,
        env_id: str | None = None,
        *,
        env: Env | Factory | None = None,
        dt: float | None = None,
        time_limit: float | None = None,
        state_scale: Sequence[float] | Mapping[str, float] | None = None,
        action_scale: Sequence[float] | Mapping[str, float] | None = None,
        state_names: Sequence[str] | None = None,
        action_names: Sequence[str] | None = None,
        angles: Angles | None = None,
        rates: Mapping[str, str] | None = None,
        headline: str | None = None,
        clip_action: bool = True,
        termination: Literal["failure", "success"] | None = None,
        env_kwargs: Mapping[str, Any] | None = None,
    ) -> None:
        """Make one copy, to see what it is like."""
        if termination not in ("failure", "success", None):
            raise ValueError(f"termination={termination!r}: expected 'failure' or 'success'")
        self._source = source_of(env_id, env, env_kwargs or {})
        self._ended = Outcome.SUCCEEDED if termination == "success" else Outcome.FAILED
        name, first = self._source.name, self._source.first
        self._copies = [Copy(first)]
        self._last: Tensor | None = None
        self._lost_at_once, self._has_lost, self._has_stepped = 0, False, False
        self.notes: list[str] = []
        observation = observation_box(name, first.observation_space)
        self._box = action_box(name, first.action_space)
        self._size = observation.shape[0]
        dt = stated_dt(first) if dt is None else dt
        if dt is None:
            raise ValueError(f"dt=None: expected the seconds per step, {name} does not say them")
        if not (math.isfinite(dt) and dt > 0):
            raise ValueError(f"dt={dt!r}: expected a finite number of seconds above 0 ({name})")
        threshold = stated_threshold(first)
        time_limit, own = self._limits(time_limit, dt, stated_limit(first))
        if threshold is not None and time_limit < own - dt / 2:
            self.notes.append(
                f"time_limit={time_limit:g} s is below the {own:g} s of {name}, so that its return"
                f" of {threshold:g} for a success does not apply; eval.success_return=... sets one"
            )
            threshold = None
        self._most_steps = round(time_limit / dt)
        state = _named("state", observation, state_names)
        none = [q.name for q, none in zip(state, finite_but_none(observation), strict=True) if none]
        self._observed = [q.name for q in state]
        self._hint = None if angles else AngleHint(self._observed)
        self._view: AngleView | None = None
        if angles:
            self._view, state = angle_view(state, angles)
        state = _scaled("state", with_rates(state, rates or {}), state_scale)
        action = _named("action", self._box, action_names)
        none += [q.name for q, none in zip(action, finite_but_none(self._box), strict=True) if none]
        if none:
            self.notes.append(
                f"{name}: the bounds of {', '.join(none)} count as none: they are at least 1e30, or"
                " the largest number of their type"
            )
        action = _scaled("action", action, action_scale)
        for name in {q.name for q in action} & {q.name for q in state}:
            raise ValueError(f"action_names: {name!r} is a component of the state, too")
        self._spec = Spec(
            name=name,
            state=state,
            action=action,
            dt=float(dt),
            time_limit=float(time_limit),
            disturbance_dim=0,
            reset_dim=1,
            clip_action=clip_action,
            headline=state[0].name if headline is None else headline,
            success_return=threshold,
            survival=None if termination is None else termination == "failure",
        )
        if self._spec.headline not in [quantity.name for quantity in state]:
            names = ", ".join(quantity.name for quantity in state)
            raise ValueError(f"headline={headline!r}: expected one of {names}")

    def _limits(self, given: float | None, dt: float, steps: int | None) -> tuple[float, float]:
        """Seconds after which an episode ends, and those after which the environment ends it."""
        name, own = self._source.name, math.inf if steps is None else steps * dt
        if given is None and steps is None:
            given = _UNSTATED_LIMIT * dt
            self.notes.append(
                f"{name} states no limit of steps: an episode ends after {_UNSTATED_LIMIT} of them"
                f" ({given:g} s); time_limit=... sets another"
            )
        if given is not None and not (math.isfinite(given) and given >= dt):
            raise ValueError(
                f"time_limit={given!r}: expected a finite number of at least dt, {dt} s ({name})"
            )
        if given is not None and given > own + dt / 2:
            self.notes.append(
                f"time_limit={given:g} s is above the {own:g} s after which {name} ends an episode"
            )
        return (own if given is None else min(given, own)), own

    @property
    def spec(self) -> Spec:
        """The facts of the domain."""
        return self._spec

    @property
    def most_rows(self) -> int | None:
        """How many copies there can be, None for any number."""
        return 1 if self._source.more is None else None

    @property
    def rows_at_once(self) -> int:
        """How many copies are used side by side where fewer do as well: one of MuJoCo's takes
        2 MB."""
        return self.most_rows or 1000

    @property
    def action_dtype(self) -> np.dtype[Any]:
        """The number type of the environment's actions."""
        return self._box.dtype

    def viewed(self, observation: Tensor) -> Tensor:
        """What a learner sees ``[*batch, n]`` of the observation ``[*batch, k]``."""
        if observation.shape[-1:] != (self._size,):
            raise ValueError(
                f"observation: has shape {tuple(observation.shape)}, expected {self._size} numbers"
                f" in the last dimension, those of {self._source.name}"
            )
        return observation if self._view is None else self._view(observation)

    def initial(self, uniforms: Tensor) -> Tensor:
        """Start states ``[*batch, k + 5]``; uniforms ``[*batch, 1]`` in [0, 1) seed the copies."""
        drawn = uniforms.reshape(-1)
        self._take(len(drawn))
        rows = torch.stack([self._begin(k, number) for k, number in enumerate(drawn)])
        return self._return(rows.reshape(*uniforms.shape[:-1], -1))

    def restart(self, state: Tensor, mask: Tensor, uniforms: Tensor) -> Tensor:
        """``state`` with a new start where ``mask`` ``[*batch]``, unchanged elsewhere."""
        rows = self._rows(state)
        drawn = uniforms.reshape(-1)
        for k in mask.reshape(-1).nonzero()[:, 0].tolist():
            if rows[k, _LOST] and self._source.more is not None:
                self._copies[k] = Copy(self._source.another())
                taken_by(self._copies[k].env, self)
            rows[k] = self._begin(k, drawn[k])
        return self._return(rows.reshape(state.shape))

    def step(self, state: Tensor, action: Tensor, uniforms: Tensor) -> Tensor:
        """The state one step later; action ``[*batch, m]``; uniforms ``[*batch, 0]``."""
        expect_action(state, action, self._box.shape[0])
        rows = self._rows(state)
        actions = action.detach().cpu().reshape(len(rows), -1).numpy()
        for k, row in enumerate(rows):
            if _over(row):
                continue
            try:
                self._move(k, row, actions[k].astype(self._box.dtype))
            except Exception as error:  # whatever the environment does, it loses this episode only
                self._lose(row, error)
                continue
            self._has_stepped = True
            self._look_for_angles(row)
        return self._return(rows.reshape(state.shape))

    def observe(self, state: Tensor) -> Tensor:
        """The observation ``[*batch, n]``."""
        return self.viewed(state[..., :_TERMINATED])

    def outcome(self, state: Tensor) -> Tensor:
        """``Outcome`` of each row as int64 ``[*batch]``; a lost one is FAILED."""
        outcome = torch.where(state[..., _TRUNCATED] != 0, int(Outcome.TIMED_OUT), 0)
        ended = torch.where(state[..., _SUCCESS] == 0, int(Outcome.FAILED), int(self._ended))
        outcome = torch.where(state[..., _TERMINATED] != 0, ended, outcome)
        return torch.where(self.lost(state), int(Outcome.FAILED), outcome)

    def lost(self, state: Tensor) -> Tensor:
        """Whether the episode was lost to a fault of the environment, bool ``[*batch]``."""
        return state[..., _LOST] != 0

    def stepped(self, state: Tensor) -> Tensor:
        """Whether the step to ``state`` was one, bool ``[*batch]``: not where it was lost."""
        return ~self.lost(state)

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
        for copy in self._copies:
            copy.env.close()

    def memory(self) -> dict[str, Tensor]:
        """Seeds and actions of the episodes under way, and what decides which lines are still to be
        said."""
        if self._last is None:
            raise ValueError(f"memory: {self._source.name} has not been started")
        rows = self._last.reshape(-1, self._last.shape[-1])
        episodes: list[tuple[int, Actions]] = [
            (0, []) if _over(row) else (copy.seed, copy.actions)
            for copy, row in zip(self._copies, rows, strict=False)
        ]
        said = [self._lost_at_once, self._has_lost, self._has_stepped]
        hint = {} if self._hint is None else self._hint.memory()
        return {
            **packed(episodes, self._box.shape[0]),
            "said": torch.tensor(said, dtype=torch.int64),
            **{f"hint.{name}": tensor for name, tensor in hint.items()},
        }

    def recall(self, state: Tensor, memory: dict[str, Tensor]) -> Tensor:
        """See ``sims.base.Remembering``; warns once of the episodes that are lost."""
        self._lost_at_once, lost, stepped = memory["said"].tolist()
        self._has_lost, self._has_stepped = bool(lost), bool(stepped)
        if self._hint is not None:
            hint = {name: memory[f"hint.{name}"] for name in self._hint.memory()}
            self._hint.recall(hint)
            self._note(self._hint.line)
        rows = state.reshape(-1, state.shape[-1]).clone()
        self._take(len(rows))
        episodes = unpacked(memory, self._box.dtype)
        running = [k for k, row in enumerate(rows) if not _over(row)]
        failed = {k: why for k in running if (why := self._repeat(k, *episodes[k], rows[k]))}
        if failed:
            rows[list(failed), _LOST] = 1.0
            logger.warning(
                "%s: %d of %d episodes are dropped: the environment does not repeat itself under"
                " its seed (%s)",
                self._source.name,
                len(failed),
                len(running),
                next(iter(failed.values())),
            )
        return self._return(rows.reshape(state.shape))

    def _repeat(self, k: int, seed: int, actions: Actions, wanted: Tensor) -> str | None:
        """Bring a copy to the row ``wanted`` by these actions; why not, if that is not where they
        lead."""
        try:
            row = self._reset(k, seed, wanted.dtype)
            for action in actions:
                if _over(row):
                    return "an episode ended early"
                self._move(k, row, action)
        except Exception as error:  # as in an episode
            return _why(error)
        same = row.numpy().tobytes() == wanted.numpy().tobytes()
        return None if same else "the same actions led elsewhere"

    def env_seed(self, uniform: float) -> int:
        """The seed that a restart with this uniform number resets a copy with."""
        return int(uniform * 2**31)

    def _take(self, count: int) -> None:
        """As many copies, for this object alone."""
        while len(self._copies) < count:
            self._copies.append(Copy(self._source.another()))
        for copy in self._copies:
            taken_by(copy.env, self)

    def _begin(self, k: int, uniform: Tensor) -> Tensor:
        return self._reset(k, self.env_seed(float(uniform)), uniform.dtype)

    def _move(self, k: int, row: Tensor, action: NDArray[np.floating]) -> None:
        """Step copy ``k`` from ``row``, in place; raises whatever the environment does."""
        observation, reward, terminated, truncated, info = self._copies[k].step(action)
        row[:_TERMINATED] = self._checked(observation)
        row[_RETURN] += _finite_reward(reward)
        success = info.get("is_success")
        # Its learner may be done by then, and leave it in this state.
        late = len(self._copies[k].actions) >= self._most_steps
        row[_TERMINATED], row[_TRUNCATED] = float(terminated), float(truncated or late)
        if success is not None:
            row[_SUCCESS] = float(bool(success))

    def _reset(self, k: int, seed: int, dtype: torch.dtype) -> Tensor:
        try:
            started = self._copies[k].reset(seed)
            if not (isinstance(started, tuple) and len(started) == 2):
                raise ValueError(f"it gave {type(started).__name__}, expected (observation, info)")
            read = self._checked(started[0])
        except Exception as error:
            why = _why(error)
            if isinstance(error, TypeError) and "unexpected keyword argument 'seed'" in why:
                why = f"it takes no seed, expected reset(self, *, seed=None, options=None) ({why})"
            raise SimulatorFailed(f"{self._source.name}: reset failed: {why}") from error
        row = torch.zeros(self._size + 5, dtype=dtype)
        row[:_TERMINATED], row[_SUCCESS] = read, -1.0
        self._check_pairs(row)
        return row

    def _checked(self, observation: Any) -> Tensor:
        read = torch.as_tensor(np.asarray(observation))
        if tuple(read.shape) != (self._size,):
            raise ValueError(
                f"an observation of shape {tuple(read.shape)}, expected {(self._size,)}"
            )
        if not bool(read.isfinite().all()):
            raise ValueError("an observation that is not finite")
        return read

    def _check_pairs(self, row: Tensor) -> None:
        """Refuse a pair far from the unit circle, whose angle would mean nothing."""
        for component in self._view.components if self._view is not None else ():
            if len(component.sources) == 2:
                cosine, sine = (float(row[k]) for k in component.sources)
                if not 0.25 <= cosine**2 + sine**2 <= 4.0:  # noisy sensors included
                    first, second = (self._observed[k] for k in component.sources)
                    raise SimulatorFailed(
                        f"{self._source.name}: angles=({first}, {second}): expected cosine and"
                        f" sine of one angle, and got {cosine:.4g} and {sine:.4g}"
                    )

    def _look_for_angles(self, row: Tensor) -> None:
        if self._hint is not None:
            self._note(self._hint.add(row[:_TERMINATED].numpy()))

    def _note(self, line: str | None) -> None:
        if line is not None:
            self.notes.append(f"{self._source.name}: {line}")

    def _lose(self, row: Tensor, error: Exception) -> None:
        row[_LOST] = 1.0
        if not self._has_stepped and _FOUR_VALUES in str(error):
            # Raised where a wrapper unpacks them, too; no other episode would go better.
            raise SimulatorFailed(
                f"{self._source.name}: step gave four values, as Gym did before 0.26; expected"
                " (observation, reward, terminated, truncated, info)"
            ) from error
        if not self._has_lost:
            logger.warning("%s: an episode is lost: %s", self._source.name, _why(error))
        self._has_lost = True
        self._lost_at_once += not self._has_stepped
        if self._lost_at_once == _HOPELESS:
            raise SimulatorFailed(
                f"{self._source.name}: none of its first {_HOPELESS} steps succeeded: {_why(error)}"
            ) from error

    def _rows(self, state: Tensor) -> Tensor:
        last = self._last
        name = self._source.name
        if last is None:
            raise ValueError(f"state: {name} has not been started; expected initial first")
        if not all(belongs_to(copy.env, self) for copy in self._copies):
            raise SimulatorFailed(
                f"{name}: the one environment that was given has begun other episodes meanwhile; to"
                " evaluate during learning give a factory, a function that returns a new one"
            )
        if state is not last and not (
            state.shape == last.shape and torch.allclose(state, last, 0.0, 0.0, equal_nan=True)
        ):
            raise ValueError(
                f"state: not the one that {name} returned last; expected that one, since the"
                " environment has a memory of its own"
            )
        return state.reshape(-1, state.shape[-1]).clone()

    def _return(self, state: Tensor) -> Tensor:
        # A copy, so that changes made outside are noticed.
        self._last = state.clone()
        return state


def _over(row: Tensor) -> bool:
    """Whether the episode in a row has ended or was lost."""
    return bool(row[_TERMINATED] or row[_TRUNCATED] or row[_LOST])


def _why(error: Exception) -> str:
    return " ".join(f"{type(error).__name__}: {error}".split())


def _finite_reward(reward: Any) -> float:
    value = float(np.asarray(reward).item())
    if not math.isfinite(value):
        raise ValueError(f"a reward of {value}")
    return value


def _named(which: str, box: spaces.Box, names: Sequence[str] | None) -> tuple[Quantity, ...]:
    (size,) = box.shape
    names = [f"{which}_{k}" for k in range(size)] if names is None else list(names)
    if len(names) != size or not are_names(names):
        raise ValueError(
            f"{which}_names={names}: expected {size} different ones without dots, one for each"
            " component"
        )
    return tuple(
        Quantity(name, "1", low=low, high=high)
        for name, (low, high) in zip(names, bounds(box).tolist(), strict=True)
    )


def _scaled(
    which: str,
    quantities: tuple[Quantity, ...],
    scales: Sequence[float] | Mapping[str, float] | None,
) -> tuple[Quantity, ...]:
    """``quantities`` with their scales, given in order or by name, else from the bounds."""
    names = [q.name for q in quantities]
    given = {} if scales is None else scales
    if not isinstance(given, Mapping):
        if len(given) != len(names):
            raise ValueError(f"{which}_scale={list(given)}: expected {len(names)} of them")
        given = dict(zip(names, given, strict=True))
    for name, scale in given.items():
        if name not in names:
            raise ValueError(f"{which}_scale.{name}={scale}: expected one of {', '.join(names)}")
        if not (math.isfinite(scale) and scale > 0):
            raise ValueError(f"{which}_scale.{name}={scale}: expected a finite number above 0")
    scaled = []
    for q in quantities:
        size = max(abs(q.low), abs(q.high))
        if q.name not in given and which == "action" and not math.isfinite(size):
            raise ValueError(
                f"action_scale=None: expected a scale for {q.name}, which has no bounds: a typical"
                " size of this action"
            )
        scale = given.get(q.name, size if math.isfinite(size) and size > 0 else 1.0)
        scaled.append(replace(q, scale=float(scale)))
    return tuple(scaled)
