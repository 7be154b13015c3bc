"""Any Gymnasium environment with boxes for observations and actions, as a sim."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import numpy as np
import torch
from torch import Tensor

from sims.angle_hint import AngleHint
from sims.angle_view import Angles
from sims.base import Outcome, SimulatorFailed, Spec, expect_action
from sims.gymnasium_copy import (
    LOST,
    RETURN,
    SUCCESS,
    TERMINATED,
    TRUNCATED,
    Actions,
    Copy,
    is_over,
    packed,
    reason,
    unpacked,
)
from sims.gymnasium_facts import env_facts
from sims.gymnasium_source import Env, Factory, belongs_to, source_of, taken_by

logger = logging.getLogger("edtorch")

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
        self._source = source_of(env_id, env, env_kwargs or {})
        first = self._source.first
        facts = env_facts(
            self._source.name,
            first,
            dt=dt,
            time_limit=time_limit,
            state_scale=state_scale,
            action_scale=action_scale,
            state_names=state_names,
            action_names=action_names,
            angles=angles,
            rates=rates,
            headline=headline,
            clip_action=clip_action,
            termination=termination,
        )
        self._spec, self._view, self._observed = facts.spec, facts.view, facts.observed
        self._box, self._size = facts.actions, len(facts.observed)
        self._most_steps = round(facts.spec.time_limit / facts.spec.dt)
        self._ended = Outcome.SUCCEEDED if termination == "success" else Outcome.FAILED
        self._hint = AngleHint(facts.observed) if facts.view is None else None
        self.notes = [*facts.notes]
        self._copies = [self._copy(first)]
        self._last: Tensor | None = None
        self._lost_at_once, self._has_lost, self._has_stepped = 0, False, False

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
            if rows[k, LOST] and self._source.more is not None:
                self._copies[k] = self._copy(self._source.another())
                taken_by(self._copies[k].env, self)
            rows[k] = self._begin(k, drawn[k])
        return self._return(rows.reshape(state.shape))

    def step(self, state: Tensor, action: Tensor, uniforms: Tensor) -> Tensor:
        """The state one step later; action ``[*batch, m]``; uniforms ``[*batch, 0]``."""
        expect_action(state, action, self._box.shape[0])
        rows = self._rows(state)
        actions = action.detach().cpu().reshape(len(rows), -1).numpy()
        for k, row in enumerate(rows):
            if is_over(row):
                continue
            try:
                self._copies[k].step(row, actions[k].astype(self._box.dtype))
            except Exception as error:  # whatever the environment does, it loses this episode only
                self._lose(row, error)
                continue
            self._has_stepped = True
            self._look_for_angles(row)
        return self._return(rows.reshape(state.shape))

    def observe(self, state: Tensor) -> Tensor:
        """The observation ``[*batch, n]``."""
        return self.viewed(state[..., :TERMINATED])

    def outcome(self, state: Tensor) -> Tensor:
        """``Outcome`` of each row as int64 ``[*batch]``; a lost one is FAILED."""
        outcome = torch.where(state[..., TRUNCATED] != 0, int(Outcome.TIMED_OUT), 0)
        ended = torch.where(state[..., SUCCESS] == 0, int(Outcome.FAILED), int(self._ended))
        outcome = torch.where(state[..., TERMINATED] != 0, ended, outcome)
        return torch.where(self.lost(state), int(Outcome.FAILED), outcome)

    def lost(self, state: Tensor) -> Tensor:
        """Whether the episode was lost to a fault of the environment, bool ``[*batch]``."""
        return state[..., LOST] != 0

    def stepped(self, state: Tensor) -> Tensor:
        """Whether the step to ``state`` was one, bool ``[*batch]``: not where it was lost."""
        return ~self.lost(state)

    def total_reward(self, state: Tensor) -> Tensor:
        """The sum of the environment's rewards so far, ``[*batch]``."""
        return state[..., RETURN]

    def succeeded(self, state: Tensor) -> Tensor:
        """What ``info["is_success"]`` last was, int64 ``[*batch]``: 1, 0, or -1 without it."""
        return state[..., SUCCESS].to(torch.int64)

    def measures(self, start: Tensor, final: Tensor, seconds: Tensor) -> dict[str, Tensor]:
        """``return``: the sum of the environment's rewards, ``[*batch]``."""
        return {"return": final[..., RETURN].clone()}

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
            (0, []) if is_over(row) else (copy.seed, copy.actions)
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
        running = [k for k, row in enumerate(rows) if not is_over(row)]
        failed = {k: why for k in running if (why := self._copies[k].repeat(*episodes[k], rows[k]))}
        if failed:
            rows[list(failed), LOST] = 1.0
            logger.warning(
                "%s: %d of %d episodes are dropped: the environment does not repeat itself under"
                " its seed (%s)",
                self._source.name,
                len(failed),
                len(running),
                next(iter(failed.values())),
            )
        return self._return(rows.reshape(state.shape))

    def env_seed(self, uniform: float) -> int:
        """The seed that a restart with this uniform number resets a copy with."""
        return int(uniform * 2**31)

    def _take(self, count: int) -> None:
        """As many copies, for this object alone."""
        while len(self._copies) < count:
            self._copies.append(self._copy(self._source.another()))
        for copy in self._copies:
            taken_by(copy.env, self)

    def _copy(self, env: Env) -> Copy:
        return Copy(env, self._size, self._most_steps)

    def _begin(self, k: int, uniform: Tensor) -> Tensor:
        try:
            row = self._copies[k].reset(self.env_seed(float(uniform)), uniform.dtype)
        except Exception as error:
            why = reason(error)
            if isinstance(error, TypeError) and "unexpected keyword argument 'seed'" in why:
                why = f"it takes no seed, expected reset(self, *, seed=None, options=None) ({why})"
            raise SimulatorFailed(f"{self._source.name}: reset failed: {why}") from error
        self._check_pairs(row)
        return row

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
            self._note(self._hint.add(row[:TERMINATED].numpy()))

    def _note(self, line: str | None) -> None:
        if line is not None:
            self.notes.append(f"{self._source.name}: {line}")

    def _lose(self, row: Tensor, error: Exception) -> None:
        row[LOST] = 1.0
        if not self._has_stepped and _FOUR_VALUES in str(error):
            # Raised where a wrapper unpacks them, too; no other episode would go better.
            raise SimulatorFailed(
                f"{self._source.name}: step gave four values, as Gym did before 0.26; expected"
                " (observation, reward, terminated, truncated, info)"
            ) from error
        if not self._has_lost:
            logger.warning("%s: an episode is lost: %s", self._source.name, reason(error))
        self._has_lost = True
        self._lost_at_once += not self._has_stepped
        if self._lost_at_once == _HOPELESS:
            raise SimulatorFailed(
                f"{self._source.name}: none of its first {_HOPELESS} steps succeeded:"
                f" {reason(error)}"
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
