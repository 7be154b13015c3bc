"""From values to follow, by component, to a reward that planners take."""

from __future__ import annotations

import math
import reprlib
from collections.abc import Mapping
from typing import Any

from edtorch.app.arguments import RATE_WEIGHT
from edtorch.app.errors import ConfigError
from edtorch.model.told import Told
from sims.base import Sim, Spec

_EXPECTED = "expected a function of seconds to finite numbers, or such numbers, one a tick"


def following_reward(
    sim: Sim,
    reference: Mapping[str, Any],
    target: Mapping[str, float] | None,
    weights: Mapping[str, float] | None,
) -> dict[str, Any]:
    """Settings of the group ``reward``: squared distances from values that change with time.

    reference: by component a function of the seconds since the start of an episode, or values, one
    a tick; physical units.  target: values of others, which stay.  Each has weight 1 / scale^2;
    rates that are not named, and actions, ``RATE_WEIGHT`` / scale^2; weights of components replace
    these.  Between angles the distance is the chord, which has no seam.  Raises ConfigError.
    """
    spec, told = sim.spec, Told.of(sim.spec)
    scales = {q.name: q.scale for q in spec.state}
    wanted = {name: _values(f"reference.{name}", own, spec) for name, own in reference.items()}
    for name, value in (target or {}).items():
        if name in wanted:
            raise ConfigError(f"target.{name}={value}: expected none beside its reference")
        wanted[name] = _values(f"target.{name}", [value], spec)
    unknown = [name for name in wanted if name not in scales]
    if unknown:
        raise ConfigError(f"reference.{unknown[0]}: expected one of {', '.join(scales)}")
    damped = {q.name for q in spec.state if q.rate_of} - set(wanted)
    weight = {name: 1 / scales[name] ** 2 for name in wanted}
    weight |= {name: RATE_WEIGHT / scales[name] ** 2 for name in damped}
    for name, value in (weights or {}).items():
        if name not in weight:
            raise ConfigError(
                f"weights.{name}={value}: expected one of {', '.join(weight)} with a reference"
            )
        weight[name] = float(value)
    rows: list[dict[str, Any]] = [{name: 1.0, "weight": weight[name]} for name in sorted(damped)]
    for name, values in wanted.items():
        angle = told.angle[told.names.index(name)]
        parts = {f"{f.__name__} {name}": list(map(f, values)) for f in (math.sin, math.cos)}
        for entry, own in (parts if angle else {name: values}).items():
            rows.append({entry: 1.0, "reference": own, "weight": weight[name]})
    return {"_target_": "edtorch.rewards.LiftedReward", "rows": rows, "action": RATE_WEIGHT}


def _values(key: str, told: Any, spec: Spec) -> list[float]:
    """What is wanted at each tick of an episode."""
    ticks = range(round(spec.time_limit / spec.dt) + 1)
    try:
        found: Any = [told(spec.dt * tick) for tick in ticks] if callable(told) else told
        values = [float(value) for value in found]
    except Exception as error:
        why = " ".join(str(error).split())
        raise ConfigError(f"{key}: {_EXPECTED} ({type(error).__name__}: {why})") from error
    if not values or not all(math.isfinite(value) for value in values):
        raise ConfigError(f"{key}={reprlib.repr(values)}: {_EXPECTED}")
    return values
