"""Where the copies of a Gymnasium environment come from, and what an environment says of itself."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

Env = gymnasium.Env[Any, Any]
Factory = Callable[[], Env]

_FACTORY = "give a factory, a function without arguments that returns a new environment"
_UNBOUNDED = 1e30
"""A bound of this size or more counts as infinite, and so does the largest number of the box's
type, which some environments write for a component without bounds (not of integers below 32 bits,
where it is a real bound: 255)."""

_users: weakref.WeakKeyDictionary[Env, weakref.ref[object]] = weakref.WeakKeyDictionary()


@dataclass(frozen=True)
class Source:
    """name: for messages and tables; first: a copy to look at, and the first to be used; more:
    makes another one, None where ``first`` is all there is."""

    name: str
    first: Env
    more: Factory | None

    def another(self) -> Env:
        """One more copy; ValueError where there can be none."""
        if self.more is None:
            raise ValueError(
                f"env: {self.name} cannot be copied, having no spec to be rebuilt from; {_FACTORY}"
            )
        return self.more()


def source_of(env_id: str | None, env: Env | Factory | None, kwargs: Mapping[str, Any]) -> Source:
    """From an id of ``gymnasium.make`` with its arguments, an environment, or a factory."""
    if (env_id is None) == (env is None):
        raise ValueError(f"env_id={env_id}: expected either an id or an environment (env)")
    if env_id is not None:
        # Without the module to import: the environment is the same wherever it is registered.
        name = env_id.rpartition(":")[2]
        return Source(name, made(env_id, kwargs), lambda: made(env_id, kwargs))
    if kwargs:
        raise ValueError(f"env_kwargs={dict(kwargs)}: expected none without an env_id")
    if isinstance(env, gymnasium.Env):
        return Source(_name(env), env, _rebuilding(env))
    if not callable(env):
        raise ValueError(f"env={env!r}: expected an environment, or a factory without arguments")
    factory, label = env, getattr(env, "__name__", type(env).__name__)

    def build() -> Env:
        try:
            found = factory()
        except Exception as error:
            why = " ".join(f"{type(error).__name__}: {error}".split())
            raise ValueError(f"env={label}: the factory raised {why}") from error
        if not isinstance(found, gymnasium.Env):
            raise ValueError(
                f"env={label}: expected a factory of gymnasium.Env, it gave a"
                f" {type(found).__name__}"
            )
        return found

    first = build()
    return Source(_name(first), first, build)


def made(env_id: str, kwargs: Mapping[str, Any]) -> Env:
    """``gymnasium.make``, with a ValueError for what it refuses."""
    try:
        return gymnasium.make(env_id, **kwargs)
    except (gymnasium.error.Error, ImportError, TypeError) as error:
        why = " ".join(str(error).split())
        raise ValueError(f"env_id={env_id}: expected a Gymnasium environment ({why})") from error


def _name(env: Env) -> str:
    try:
        spec = env.spec
    except ValueError:  # a wrapper that does not record its arguments
        spec = None
    return type(env.unwrapped).__name__ if spec is None else spec.id


def _rebuilding(env: Env) -> Factory | None:
    """What makes environments like ``env`` from its spec; None where that is impossible."""
    try:
        spec = env.spec
        if spec is None:
            return None
        gymnasium.make(spec).close()
    except Exception:  # whatever stands in the way, there is no second copy
        return None
    return lambda: gymnasium.make(spec)


def taken_by(env: Env, user: object) -> None:
    """Assign ``env`` to ``user``; a former user would disturb its episode."""
    _users[env] = weakref.ref(user)


def belongs_to(env: Env, user: object) -> bool:
    """Whether nobody has taken ``env`` since ``user`` did."""
    owner = _users.get(env)
    return owner is not None and owner() is user


def stated_dt(env: Env) -> float | None:
    """Seconds per step where the environment states them: ``dt`` (MuJoCo, Pendulum), ``tau``
    (CartPole), or ``control_timestep()`` of a dm_control environment; None elsewhere."""
    inner = env.unwrapped
    for name in ("dt", "tau"):
        value = getattr(inner, name, None)
        if isinstance(value, int | float) and not isinstance(value, bool):
            return float(value)
    control = getattr(getattr(inner, "_env", None), "control_timestep", None)
    return None if control is None else float(control())


def stated_limit(env: Env) -> int | None:
    """Steps after which the environment is truncated, where a wrapper, its spec or its attribute
    ``max_episode_steps`` states them."""
    layer = env
    while isinstance(layer, gymnasium.Wrapper):
        if isinstance(layer, gymnasium.wrappers.TimeLimit):
            return layer._max_episode_steps
        layer = layer.env
    registered = None if layer.spec is None else layer.spec.max_episode_steps
    return getattr(layer, "max_episode_steps", None) if registered is None else registered


def stated_threshold(env: Env) -> float | None:
    """The registered return from which the environment counts as solved."""
    spec = env.unwrapped.spec
    return None if spec is None else spec.reward_threshold


def observation_box(name: str, space: gymnasium.Space[Any]) -> spaces.Box:
    """The space of observations, a vector; ValueError with the way to wrap any other."""
    if isinstance(space, spaces.Box) and len(space.shape) == 1 and space.shape[0]:
        return space
    flatten = "wrap it in gymnasium.wrappers.FlattenObservation"
    remedy = "supported are vectors of numbers"
    if isinstance(space, spaces.Dict | spaces.Tuple):
        remedy = f"supported are vectors; {flatten}"
    elif isinstance(space, spaces.Box) and (len(space.shape) >= 3 or space.dtype.kind == "u"):
        remedy = (
            "images are not supported; wrap it in gymnasium.wrappers.TransformObservation with a"
            " function that extracts a vector"
        )
    elif isinstance(space, spaces.Box):
        remedy = f"supported are vectors; {flatten}"
    elif isinstance(space, spaces.Discrete | spaces.MultiDiscrete | spaces.MultiBinary):
        remedy = "discrete observations are not supported"
    raise ValueError(f"env_id={name}: observation space {_short(space)}: {remedy}")


def action_box(name: str, space: gymnasium.Space[Any]) -> spaces.Box:
    """The space of actions, a vector; ValueError with the way to wrap any other."""
    remedy = "supported is a one-dimensional Box"
    discrete = isinstance(space, spaces.Discrete | spaces.MultiDiscrete | spaces.MultiBinary)
    if discrete or (isinstance(space, spaces.Box) and space.dtype.kind != "f"):
        remedy = (
            "discrete actions are not supported; use a version with continuous actions, or map"
            " numbers to them with gymnasium.wrappers.TransformAction"
        )
    elif isinstance(space, spaces.Box) and len(space.shape) == 1:
        if space.shape[0] and (space.low < space.high).all():
            return space
        remedy = "expected at least one action, and bounds that leave it a range"
    elif isinstance(space, spaces.Dict | spaces.Tuple | spaces.Box):
        remedy = (
            "supported is a one-dimensional Box; map one to it with"
            " gymnasium.wrappers.TransformAction"
        )
    raise ValueError(f"env_id={name}: action space {_short(space)}: {remedy}")


def _short(space: gymnasium.Space[Any], most: int = 80) -> str:
    text = " ".join(str(space).split())
    return text if len(text) <= most else f"{text[:most]}..."


def bounds(box: spaces.Box) -> NDArray[np.float64]:
    """Bounds (low, high) of each component, ``[n, 2]``, infinite where the box has none."""
    given = _given_bounds(box)
    return np.where(np.abs(given) >= _unbounded(box), np.copysign(np.inf, given), given)


def finite_but_none(box: spaces.Box) -> list[bool]:
    """Whether each component, ``[n]``, has a finite bound that counts as infinite."""
    size = np.abs(_given_bounds(box))
    counts = (size >= _unbounded(box)) & np.isfinite(size)
    return [bool(row.any()) for row in counts]


def _given_bounds(box: spaces.Box) -> NDArray[np.float64]:
    return np.stack([box.low, box.high], axis=-1).astype(np.float64)


def _unbounded(box: spaces.Box) -> float:
    """The size from which on a bound of the box is none."""
    largest: Any = np.inf
    kind: Any = box.dtype.type
    if box.dtype.kind == "f":
        largest = np.finfo(kind).max
    elif box.dtype.itemsize >= 4:
        largest = np.iinfo(kind).max
    return min(_UNBOUNDED, float(largest))
