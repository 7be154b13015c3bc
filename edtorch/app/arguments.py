"""From the arguments of ``edtorch.learn`` to settings, and back in messages."""

from __future__ import annotations

import inspect
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from numbers import Real
from typing import Any

from edtorch.app.errors import ConfigError
from edtorch.app.given import Given
from sims.angle_view import PERIODS
from sims.base import Quantity, Sim, Spec

RATE_WEIGHT = 0.01
"""Weight of a rate that ``target`` does not name, on the scale on which a named component has 1."""

ACTION_WEIGHT = 1.0
"""Weight of an action, on the same scale."""

GYMNASIUM = "sims.from_gymnasium.GymnasiumSim"

_ARGUMENTS = (
    (r"domain\.(env_id|env)\b", "env"),
    (r"domain\.state_names\b", "names"),
    (r"domain\.(state|action)_scale\b", "scale"),
    (r"domain\.", ""),
    (r"reward\.target\.", "target."),
    (r"reward\.(state|action)\.", "weights."),
    (r"train\.", ""),
    (r"search\.(?=random|horizon)", ""),
    (r"experiment=", "preset="),
)


def in_arguments(message: str) -> str:
    """A message about a setting, by the name of the argument of ``learn`` that it came from."""
    for pattern, name in _ARGUMENTS:
        found = re.match(pattern, message)
        if found:
            return name + message[found.end() :]
    return message


def check_kinds(told: Mapping[str, Any]) -> None:
    """Refuse arguments of ``learn``, by name, that are of the wrong kind; None is of any."""
    for name, value in told.items():
        fits, expected = _KINDS[name]
        if value is not None and not fits(value):
            raise ConfigError(f"{name}={value!r}: expected {expected}")


def _is_number(value: Any) -> bool:
    return isinstance(value, Real) and not isinstance(value, bool)


def _is_mapping(value: Any) -> bool:
    return isinstance(value, Mapping)


def _is_list(value: Any) -> bool:
    listed = isinstance(value, Sequence) and not isinstance(value, str)
    return listed and all(isinstance(v, str) for v in value)


_KINDS: dict[str, tuple[Callable[[Any], bool], str]] = {
    **dict.fromkeys(("dt", "time_limit", "random", "horizon"), (_is_number, "a number of seconds")),
    **dict.fromkeys(("names", "action_names"), (_is_list, "a list of names")),
    **dict.fromkeys(("target", "weights", "scale"), (_is_mapping, "{NAME: NUMBER, ...}")),
    "reference": (_is_mapping, "{NAME: a function of seconds, or values, ...}"),
    "rates": (_is_mapping, "{RATE: COMPONENT, ...}"),
    "angles": (lambda v: _is_mapping(v) or _is_list(v), "a list of names, or {NAME: 'deg', ...}"),
    "overrides": (_is_list, "a list of texts, ['KEY=VALUE', ...]"),
}


def longest(time_limit: float | None, trial: float | None) -> float | None:
    """Seconds of an episode, or of a trial, which is one.  Raises ConfigError for both."""
    if time_limit is not None and trial is not None:
        raise ConfigError(f"trial={trial}, time_limit={time_limit}: expected one of the two")
    return time_limit if trial is None else trial


@dataclass(frozen=True)
class WorldArguments:
    """The arguments of ``learn`` that describe the environment; see there."""

    dt: float | None = None
    time_limit: float | None = None
    names: Sequence[str] | None = None
    action_names: Sequence[str] | None = None
    angles: Any = None
    rates: Mapping[str, str] | None = None
    scale: Mapping[str, float] | None = None
    termination: str | None = None

    def kinds(self) -> dict[str, Any]:
        """Those of which ``check_kinds`` knows the kind."""
        return {name: value for name, value in vars(self).items() if name in _KINDS}

    def given(self) -> dict[str, Any]:
        """The arguments that are not None."""
        return {name: value for name, value in vars(self).items() if value is not None}


def domain_settings(env: Any, world: WorldArguments, target: Mapping[str, float]) -> dict[str, Any]:
    """The node ``domain`` for ``env``: an id, a factory, an environment, or a ``Sim``."""
    if inspect.isclass(env) and hasattr(env, "outcome") and hasattr(env, "observe"):
        env = env()
    if not isinstance(env, str) and hasattr(env, "observe") and hasattr(env, "outcome"):
        for name, value in world.given().items():
            raise ConfigError(
                f"{name}={value}: expected none with a Sim, whose spec says it (sims.base.Spec)"
            )
        return {"given": Given(env)}
    node: dict[str, Any] = {"_target_": GYMNASIUM}
    node |= {"env_id": env} if isinstance(env, str) else {"env": Given(env)}
    told = world.given()
    if "names" in told:
        told["state_names"] = list(told.pop("names"))
    if "action_names" in told:
        told["action_names"] = list(told["action_names"])
    if "angles" in told:
        told["angles"] = _around(told["angles"], target)
    if "scale" in told:
        actions = set(told.get("action_names", ()))
        scales = told.pop("scale")
        told["state_scale"] = {k: v for k, v in scales.items() if not _is_action(k, actions)}
        told["action_scale"] = {k: v for k, v in scales.items() if _is_action(k, actions)}
    return node | told


def _is_action(name: str, actions: set[str]) -> bool:
    return name in actions or (not actions and name.startswith("action_"))


def _around(angles: Any, target: Mapping[str, float]) -> dict[str, Any]:
    """``angles`` with the range of each that has a target around that: the difference from it is
    then less than half a turn."""
    wanted = dict(angles) if isinstance(angles, Mapping) else dict.fromkeys(angles, "rad")
    nodes: dict[str, Any] = {}
    for name, told in wanted.items():
        node = told
        if isinstance(told, str) and told in PERIODS:
            node = {"unit": told}
        elif isinstance(told, list | tuple):
            node = {"pair": list(told)}
        if isinstance(node, dict) and name in target:
            node = {"around": float(target[name]), **node}
        nodes[name] = node
    return nodes


def reward_of(
    sim: Sim, target: Mapping[str, float] | None, weights: Mapping[str, float] | None
) -> dict[str, Any]:
    """Settings of the group ``reward``.

    Without a target all components are wanted at zero, each with weight 1 / scale^2; with one,
    those that it names, and rates that it does not name have ``RATE_WEIGHT`` / scale^2.  Weights by
    name replace these.
    """
    spec = sim.spec
    states, actions = ({q.name: q for q in group} for group in (spec.state, spec.action))
    for name, value in (target or {}).items():
        _check_target(name, value, states, spec)
    state: dict[str, float] = {}
    if target is not None:
        rates = {q.name: q for q in spec.state if q.rate_of and q.name not in target}
        state = {name: RATE_WEIGHT / q.scale**2 for name, q in rates.items()}
    elif weights:
        state = {q.name: 1 / q.scale**2 for q in spec.state}
    action: dict[str, float] = {}
    for name, weight in (weights or {}).items():
        if name not in states and name not in actions:
            raise ConfigError(
                f"weights.{name}={weight}: expected one of {', '.join([*states, *actions])}"
            )
        if not _is_number(weight):
            raise ConfigError(f"weights.{name}={weight}: expected a finite number >= 0")
        (state if name in states else action)[name] = float(weight)
    wanted = {name: float(value) for name, value in (target or {}).items()}
    return {"by_scale": True, "state": state, "action": action, "target": wanted}


def with_prices(sim: Sim, weights: Mapping[str, float] | None) -> dict[str, float]:
    """``weights`` with ``RATE_WEIGHT`` / scale^2 for actions that they do not name: plans with
    actions that cost nothing use all of them."""
    return {q.name: RATE_WEIGHT / q.scale**2 for q in sim.spec.action} | dict(weights or {})


def _check_target(name: str, value: Any, states: Mapping[str, Quantity], spec: Spec) -> None:
    if name not in states:
        raise ConfigError(f"target.{name}={value}: expected one of {', '.join(states)}")
    if not (_is_number(value) and math.isfinite(value)):
        raise ConfigError(f"target.{name}={value}: expected a finite number")
    q = states[name]
    if not q.period and not q.low <= value <= q.high:
        raise ConfigError(
            f"target.{name}={value}: expected a value within the bounds of {spec.name}, [{q.low:g},"
            f" {q.high:g}]"
        )


def budget_overrides(seconds: float | None, episodes: int | None) -> list[str]:
    """The budget in overrides; the limits that are not given are none, unless neither is given."""
    if seconds is None and episodes is None:
        return []
    told = {"seconds": seconds, "episodes": episodes, "successes": None}
    return [f"train.{k}={'null' if v is None else v}" for k, v in told.items()]
