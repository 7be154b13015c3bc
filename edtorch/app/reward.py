"""From the group ``reward`` to a reward, in scaled units."""

from __future__ import annotations

import inspect
import math
from collections.abc import Callable, Mapping, Sequence
from copy import deepcopy
from functools import partial
from typing import Any, cast

import torch
from hydra.utils import get_object
from torch import Tensor, nn

from edtorch.app.checks import at_least, check_component, preset_hint
from edtorch.app.construct import construct, given_part, is_given, known_keys
from edtorch.app.errors import ConfigError, under
from edtorch.app.settings import Settings
from edtorch.inverse.forward import distance_cost
from edtorch.rewards import PhysicalReward, QuadraticReward, Reward, quadratic_form_of
from sims.base import Quantity, Sim, Spec

QUADRATIC = "edtorch.rewards.QuadraticReward"
KEYS = {"_target_", "state", "action", "goal", "target", "cross", "linear", "by_scale"}
"""Of the quadratic reward, all by the names of components."""


def build_reward(
    config: Any, sim: Sim, dtype: torch.dtype, device: torch.device | None = None
) -> Reward:
    """The shaping reward, in scaled units.

    A quadratic one by name; any other callable by its ``_target_``, of physical states
    ``[*batch, n]`` and actions ``[*batch, m]``.  Raises ConfigError.
    """
    if is_given(config):
        return physical_reward(given_part("reward", config), sim.spec, dtype, device)
    if is_named(config):
        return _quadratic(config, sim.spec, dtype, device)
    found = _callable(config, sim.spec, dtype, device)
    return physical_reward(found, sim.spec, dtype, device, f"reward._target_={config._target_}")


def build_plain_reward(config: Any, sim: Sim, dtype: torch.dtype) -> QuadraticReward:
    """``build_reward`` for what knows only weights of squares.  Raises ConfigError."""
    reward = build_reward(config, sim, dtype)
    form = quadratic_form_of(reward)
    if not is_named(config) or form is None or not form.is_plain:
        raise ConfigError(
            "reward: expected weights alone with a rival (reward.state, reward.action), without a"
            " _target_, target, cross or linear terms"
        )
    return cast(QuadraticReward, reward)


def refuse_timed(reward: Reward) -> None:
    """ConfigError for a reward that depends on the time of an episode, for all but planners."""
    if getattr(reward, "timed", False):
        raise ConfigError(
            "reward: expected none with a reference, whose value depends on the time of an episode;"
            " search=planned follows one"
        )


def is_named(config: Any) -> bool:
    """Whether the reward is the quadratic one, given by names of components."""
    return not is_given(config) and config.get("_target_") in (None, QUADRATIC)


def physical_reward(
    found: Callable[..., Tensor],
    spec: Spec,
    dtype: torch.dtype,
    device: torch.device | None = None,
    what: str = "reward",
) -> PhysicalReward:
    """Any callable of physical states and actions as a reward of scaled ones.

    It is tried once: ConfigError, which begins with ``what``, where it does not give one finite,
    differentiable number a row.
    """
    state = torch.tensor([q.scale for q in spec.state], dtype=dtype, device=device)
    action = torch.tensor([q.scale for q in spec.action], dtype=dtype, device=device)
    if not callable(found):
        raise ConfigError(f"{what}: {type(found).__name__} cannot be called (state, action)")
    if isinstance(found, nn.Module):
        found = deepcopy(found).to(device, dtype)
    reward = PhysicalReward(found, state, action)
    for rows in ((3,), (2, 3)):
        # Not zero, where many a distance has no derivative.
        s = torch.full((*rows, len(spec.state)), 0.1, dtype=dtype, device=device)
        a = torch.full((*rows, len(spec.action)), 0.1, dtype=dtype, device=device)
        with torch.enable_grad():
            s.requires_grad_()
            a.requires_grad_()
            try:
                value = reward(s, a)
            except Exception as error:
                why = " ".join(str(error).split())
                raise ConfigError(f"{what}: {type(error).__name__}: {why}") from error
        shape = tuple(value.shape) if isinstance(value, Tensor) else type(value).__name__
        if not isinstance(value, Tensor) or shape != rows:
            raise ConfigError(
                f"{what}: gives {shape} for states of shape {tuple(s.shape)} and actions of shape"
                f" {tuple(a.shape)}, expected {rows}"
            )
        if not bool(value.isfinite().all()):
            raise ConfigError(f"{what}: is not finite at states of 0.1 of their scales")
        if not value.requires_grad:
            raise ConfigError(
                f"{what}: cannot be differentiated with respect to states and actions"
            )
    return reward


def _callable(
    config: Settings, spec: Spec, dtype: torch.dtype, device: torch.device | None
) -> Callable[..., Tensor]:
    """An object of a class with its options, or a function with them bound."""
    name = config._target_
    try:
        target = get_object(name)
    except Exception as error:
        why = " ".join(str(error).split())
        raise ConfigError(
            f"reward._target_={name}: expected the full name of a class or function ({why})"
        ) from error
    more = {
        "names": [q.name for q in spec.state],
        "states": len(spec.state),
        "actions": len(spec.action),
        "spec": spec,
        "dtype": dtype,
    }
    if inspect.isclass(target):
        made = construct("reward", config, **more)
        if not callable(made):
            raise ConfigError(f"reward._target_={name}: has no __call__(state, action)")
        return cast(Callable[..., Tensor], made)
    if not callable(target):
        raise ConfigError(f"reward._target_={name}: expected a class or a function")
    accepted = set(list(inspect.signature(target).parameters)[2:])
    known_keys("reward", config, (accepted - set(more)) | {"_target_"})
    options = config.plain()
    options |= {key: value for key, value in more.items() if key in accepted}
    bound = {key: value for key, value in options.items() if key != "_target_"}
    return cast(Callable[..., Tensor], partial(target, **bound))


def _named(config: Settings, key: str) -> dict[str, Any]:
    """A part of the configuration that older ones lack."""
    part = config.get(key)
    if part is None:
        return {}
    if not isinstance(part, Settings):
        raise ConfigError(f"reward.{key}={part}: expected a mapping {{NAME: VALUE}}")
    return part.plain()


def _number(key: str, value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        raise ConfigError(f"{key}={value}: expected a finite number")
    return float(value)


def _known(key: str, name: str, value: Any, quantities: Sequence[Quantity]) -> None:
    check_component(f"{key}.{name}", value, name, [q.name for q in quantities])


def _weights(
    key: str, config: Mapping[str, float], quantities: tuple[Quantity, ...]
) -> dict[str, float]:
    """Weights of squares by name, scaled units."""
    scales = {q.name: q.scale for q in quantities}
    for name, weight in config.items():
        _known(key, name, weight, quantities)
        at_least(f"{key}.{name}", weight, 0)
    return {name: config.get(name, 0.0) * scale**2 for name, scale in scales.items()}


def _distance(weight: float, spec: Spec) -> Tensor:
    """Cost of the squared distance of the tracked components from their goal, scaled units."""
    if weight > 0 and not spec.goal:
        raise ConfigError(
            f"reward.goal={weight}: expected a domain with a goal, not {spec.name}"
            + preset_hint("reward.goal")
        )
    return weight * distance_cost(spec)


def _cross(config: Settings, spec: Spec) -> list[tuple[str, str, float]]:
    """``reward.cross``: triples of two components and a weight."""
    given = config.get("cross")
    if given is None:
        return []
    if not isinstance(given, list):
        raise ConfigError(f"reward.cross={given}: expected a list [[NAME, NAME, WEIGHT], ...]")
    found = []
    for place, triple in enumerate(given):
        key = f"reward.cross[{place}]"
        if not isinstance(triple, list) or len(triple) != 3:
            raise ConfigError(f"{key}={triple}: expected [NAME, NAME, WEIGHT]")
        first, second, weight = triple
        for name in (first, second):
            if name not in [q.name for q in (*spec.state, *spec.action)]:
                known = ", ".join(q.name for q in (*spec.state, *spec.action))
                raise ConfigError(f"{key}={triple}: expected one of {known}, not {name}")
        if first == second:
            raise ConfigError(f"{key}={triple}: expected two components; see reward.state")
        found.append((first, second, _number(key, weight)))
    return found


def _check_target(name: str, value: Any, quantity: Quantity) -> float:
    key = f"reward.target.{name}"
    number = _number(key, value)
    low, high = max(quantity.low, -quantity.limit), min(quantity.high, quantity.limit)
    if quantity.period:
        half, middle = quantity.period / 2, quantity.middle
        low, high = max(low, middle - half), min(high, middle + half)
    if not low <= number <= high:
        raise ConfigError(
            f"{key}={value}: expected a number from {low:g} to {high:g}"
            f"{'' if quantity.unit in ('', '1') else f' {quantity.unit}'}"
        )
    return number


def near_seams(config: Settings, spec: Spec) -> list[str]:
    """A line for each angle with a target nearer to where it wraps than to the middle of its
    range: the difference from the target jumps there."""
    lines = []
    for q in spec.state:
        target = _named(config, "target").get(q.name) if q.period and is_named(config) else None
        if isinstance(target, int | float) and abs(target - q.middle) > q.period / 4:
            seam = q.middle + math.copysign(q.period / 2, target - q.middle)
            lines.append(
                f"reward.target.{q.name}={target}: near {seam:g} {q.unit}, where the angle wraps"
                " and the difference from the target jumps; an angle with"
                f" domain.angles.{q.name}={{..., around: {target:g}}} wraps elsewhere"
            )
    return lines


def _targets(
    config: Settings, spec: Spec, weighed: set[str]
) -> tuple[dict[str, float], dict[str, str]]:
    """``reward.target``: numbers, physical units, and names of other components of the state."""
    quantities = {q.name: q for q in (*spec.state, *spec.action)}
    states = [q.name for q in spec.state]
    given = _named(config, "target")
    numbers, others = {}, {}
    for name, value in given.items():
        key = f"reward.target.{name}"
        _known("reward.target", name, value, tuple(quantities.values()))
        if name not in weighed:
            group = "state" if name in states else "action"
            raise ConfigError(f"{key}={value}: has no effect without reward.{group}.{name} > 0")
        if not isinstance(value, str):
            numbers[name] = _check_target(name, value, quantities[name])
        elif name not in states:
            raise ConfigError(f"{key}={value}: expected a number, the target of an action")
        elif value not in states or value == name:
            raise ConfigError(
                f"{key}={value}: expected a number, or another component of {', '.join(states)}"
            )
        elif isinstance(given.get(value), str):
            raise ConfigError(
                f"{key}={value}: expected a component whose own target is no other component"
            )
        else:
            others[name] = value
    return numbers, others


def _by_scale(of_state: dict[str, Any], target: dict[str, Any], spec: Spec) -> dict[str, Any]:
    """Weights of the state with 1 / scale^2 for each component that has a target and no weight; for
    all components where none has either."""
    scales = {q.name: q.scale for q in spec.state}
    wanted = [name for name in target if name in scales] or (not of_state and scales)
    return {name: 1 / scales[name] ** 2 for name in wanted or ()} | of_state


def held(config: Settings, spec: Spec) -> dict[int, float]:
    """Wanted values by index of the component, scaled units: the targets, or zero for every
    component with a weight where no target is given.  Raises ConfigError."""
    index = {q.name: i for i, q in enumerate(spec.state)}
    target, of_state = _named(config, "target"), _named(config, "state")
    if config.get("by_scale"):
        of_state = _by_scale(of_state, target, spec)
    for name, value in target.items():
        if isinstance(value, str):
            raise ConfigError(
                f"reward.target.{name}={value}: expected a number with unroll.direction=equilibrium"
            )
    named = {name: target[name] for name in target if name in index}
    wanted = named or {name: 0.0 for name, weight in of_state.items() if weight > 0}
    return {index[name]: value / spec.state[index[name]].scale for name, value in wanted.items()}


def _quadratic(
    config: Settings, spec: Spec, dtype: torch.dtype, device: torch.device | None
) -> QuadraticReward:
    known_keys("reward", config, KEYS)
    goal, of_state = config.get("goal") or 0.0, _named(config, "state")
    at_least("reward.goal", goal, 0)
    if config.get("by_scale"):
        of_state = _by_scale(of_state, _named(config, "target"), spec)
    linear, cross = _named(config, "linear"), _cross(config, spec)
    state = _weights("reward.state", of_state, spec.state)
    action = _weights("reward.action", _named(config, "action"), spec.action)
    if not (goal > 0 or any(weight > 0 for weight in of_state.values()) or linear or cross):
        names = ", ".join(q.name for q in spec.state)
        raise ConfigError(f"reward.state={of_state}: expected a weight > 0 for one of {names}")
    weighed = {n for n, w in (*state.items(), *action.items()) if w > 0}
    weighed |= {name for first, second, _ in cross for name in (first, second)}
    numbers, others = _targets(config, spec, weighed)
    parts = _Assembly(spec, state, action)
    for first, second, weight in cross:
        parts.add_cross(first, second, weight)
    for name, weight in linear.items():
        _known("reward.linear", name, weight, (*spec.state, *spec.action))
        parts.add_linear(name, _number(f"reward.linear.{name}", weight))
    parts.follow(others)
    parts.aim(numbers, others)
    with under("reward"):
        return parts.reward(_distance(goal, spec), dtype, device)


class _Assembly:
    """The matrices of a quadratic reward in scaled units, put together from named terms.

    With E s the deviations of components from the components that they follow, the cost is
    (E s)'Q E s + a'R a + 2 (E s)'N a, all about the target; without followers E is the identity.
    """

    def __init__(self, spec: Spec, state: Mapping[str, float], action: Mapping[str, float]) -> None:
        self._scale = {q.name: q.scale for q in (*spec.state, *spec.action)}
        self._state = [q.name for q in spec.state]
        self._action = [q.name for q in spec.action]
        n, m = len(self._state), len(self._action)
        self.Q = torch.diag(torch.tensor([*state.values()], dtype=torch.float64))
        self.R = torch.diag(torch.tensor([*action.values()], dtype=torch.float64))
        self.N = torch.zeros(n, m, dtype=torch.float64)
        self.q = torch.zeros(n, dtype=torch.float64)
        self.p = torch.zeros(m, dtype=torch.float64)
        self.target = torch.zeros(n, dtype=torch.float64)
        self.action_target = torch.zeros(m, dtype=torch.float64)

    def add_cross(self, first: str, second: str, weight: float) -> None:
        """A cost of ``weight`` times the product of two components."""
        half = 0.5 * weight * self._scale[first] * self._scale[second]
        if first in self._action and second in self._state:
            first, second = second, first
        if first in self._state and second in self._action:
            self.N[self._state.index(first), self._action.index(second)] += half
            return
        names, square = (self._state, self.Q) if first in self._state else (self._action, self.R)
        i, j = names.index(first), names.index(second)
        square[i, j] += half
        square[j, i] += half

    def add_linear(self, name: str, weight: float) -> None:
        """A cost of ``weight`` times a component."""
        names, vector = (self._state, self.q) if name in self._state else (self._action, self.p)
        vector[names.index(name)] += weight * self._scale[name]

    def follow(self, others: Mapping[str, str]) -> None:
        """Measure the components ``others`` from the components that they name."""
        if not others:
            return
        E = torch.eye(len(self._state), dtype=torch.float64)
        for name, other in others.items():
            ratio = self._scale[other] / self._scale[name]
            E[self._state.index(name), self._state.index(other)] = -ratio
        self.Q, self.N = E.T @ self.Q @ E, E.T @ self.N

    def aim(self, numbers: Mapping[str, float], others: Mapping[str, str]) -> None:
        """Put the target at ``numbers``, physical units, and followers where what they follow
        is."""
        wanted = {**numbers, **{name: numbers.get(other, 0.0) for name, other in others.items()}}
        for name, value in wanted.items():
            names, vector = (
                (self._state, self.target)
                if name in self._state
                else (self._action, self.action_target)
            )
            vector[names.index(name)] = value / self._scale[name]

    def reward(
        self, more: Tensor, dtype: torch.dtype, device: torch.device | None
    ) -> QuadraticReward:
        """The reward, with the cost ``more`` ``[n, n]`` of the state besides."""

        def present(part: Tensor) -> Tensor | None:
            return part.to(device, dtype) if bool((part != 0).any()) else None

        return QuadraticReward(
            (self.Q + more).to(device, dtype),
            self.R.to(device, dtype),
            target=present(self.target),
            action_target=present(self.action_target),
            cross=present(self.N),
            state_linear=present(self.q),
            action_linear=present(self.p),
        )
