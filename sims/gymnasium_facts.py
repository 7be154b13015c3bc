"""The facts of a Gymnasium environment as those of a sim: what it states, and what it is given."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal

from gymnasium import spaces

from sims.angle_view import Angles, AngleView, angle_view, with_rates
from sims.base import Quantity, Spec, are_names
from sims.gymnasium_source import (
    Env,
    action_box,
    bounds,
    finite_but_none,
    observation_box,
    stated_dt,
    stated_limit,
    stated_threshold,
)

_UNSTATED_LIMIT = 1000
"""Steps of an episode where the environment states no limit."""

_Scales = Sequence[float] | Mapping[str, float] | None


@dataclass(frozen=True)
class EnvFacts:
    """observed: names of the components of the observation ``[k]``; view: in which angles are
    angles, None where none are given; actions: their space; notes: see ``GymnasiumSim``."""

    spec: Spec
    observed: Sequence[str]
    view: AngleView | None
    actions: spaces.Box
    notes: Sequence[str]


def env_facts(
    name: str,
    env: Env,
    *,
    dt: float | None,
    time_limit: float | None,
    state_scale: _Scales,
    action_scale: _Scales,
    state_names: Sequence[str] | None,
    action_names: Sequence[str] | None,
    angles: Angles | None,
    rates: Mapping[str, str] | None,
    headline: str | None,
    clip_action: bool,
    termination: Literal["failure", "success"] | None,
) -> EnvFacts:
    """Those of ``env``, which is called ``name``; the arguments are those of ``GymnasiumSim``.

    Raises ValueError, which names the argument.
    """
    if termination not in ("failure", "success", None):
        raise ValueError(f"termination={termination!r}: expected 'failure' or 'success'")
    observations = observation_box(name, env.observation_space)
    actions = action_box(name, env.action_space)
    dt = stated_dt(env) if dt is None else dt
    if dt is None:
        raise ValueError(f"dt=None: expected the seconds per step, {name} does not say them")
    if not (math.isfinite(dt) and dt > 0):
        raise ValueError(f"dt={dt!r}: expected a finite number of seconds above 0 ({name})")
    steps, threshold = stated_limit(env), stated_threshold(env)
    own = math.inf if steps is None else steps * dt
    time_limit, notes = _limit(name, time_limit, dt, own)
    if threshold is not None and time_limit < own - dt / 2:
        notes.append(
            f"time_limit={time_limit:g} s is below the {own:g} s of {name}, so that its return"
            f" of {threshold:g} for a success does not apply; eval.success_return=... sets one"
        )
        threshold = None
    state = _named("state", observations, state_names)
    action = _named("action", actions, action_names)
    none = [
        q.name
        for quantities, box in ((state, observations), (action, actions))
        for q, none in zip(quantities, finite_but_none(box), strict=True)
        if none
    ]
    observed = [q.name for q in state]
    view, state = angle_view(state, angles) if angles else (None, state)
    state = _scaled("state", with_rates(state, rates or {}), state_scale)
    if none:
        notes.append(
            f"{name}: the bounds of {', '.join(none)} count as none: they are at least 1e30, or"
            " the largest number of their type"
        )
    action = _scaled("action", action, action_scale)
    names = [q.name for q in state]
    for q in action:
        if q.name in names:
            raise ValueError(f"action_names: {q.name!r} is a component of the state, too")
    if headline is not None and headline not in names:
        raise ValueError(f"headline={headline!r}: expected one of {', '.join(names)}")
    spec = Spec(
        name=name,
        state=state,
        action=action,
        dt=float(dt),
        time_limit=float(time_limit),
        disturbance_dim=0,
        reset_dim=1,
        clip_action=clip_action,
        headline=names[0] if headline is None else headline,
        success_return=threshold,
        survival=None if termination is None else termination == "failure",
    )
    return EnvFacts(spec, observed, view, actions, notes)


def _limit(name: str, given: float | None, dt: float, own: float) -> tuple[float, list[str]]:
    """Seconds after which an episode ends, and what to say of them; own: those after which the
    environment ends it."""
    notes = []
    if given is None and own == math.inf:
        given = _UNSTATED_LIMIT * dt
        notes.append(
            f"{name} states no limit of steps: an episode ends after {_UNSTATED_LIMIT} of them"
            f" ({given:g} s); time_limit=... sets another"
        )
    if given is not None and not (math.isfinite(given) and given >= dt):
        raise ValueError(
            f"time_limit={given!r}: expected a finite number of at least dt, {dt} s ({name})"
        )
    if given is not None and given > own + dt / 2:
        notes.append(
            f"time_limit={given:g} s is above the {own:g} s after which {name} ends an episode"
        )
    return (own if given is None else min(given, own)), notes


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
    scales: _Scales,
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
