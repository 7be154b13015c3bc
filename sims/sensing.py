"""Noisy and delayed sensors for any sim."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import Any

import torch
from torch import Tensor

from sims.base import (
    Actuated,
    Controller,
    Fallible,
    Invertible,
    Jointed,
    Judged,
    JudgesStates,
    Lasting,
    Losing,
    Pictured,
    Quantity,
    Remembering,
    Rewarded,
    Sim,
    Spec,
    baselines_of,
)
from sims.normal import normal_quantile, normal_quantile_over
from sims.rows import Function, Namespace, NoRows, Rows, first_over, joined


@dataclass(frozen=True)
class Sensed:
    """``sim`` observed through sensors: y_t = observe(s_t) + noise; a learner gets y_{t - delay}.

    A new episode begins with one reading of its start, which is repeated until the first delayed
    reading arrives; transitions before that are masked (``stepped``).  Angles that wrap stay within
    their period, bounded components within their bounds.  Ends, measures, pictures and baselines
    are those of the sim itself.

    A full state is that of the sim, followed by the delayed readings, the oldest first: each the
    ``n`` components observed, and whether the step to it is a valid transition.  ``traceable`` if
    the sim is; a sim with a memory of its own is given a part of the tensor that it returned.

    Arguments: ``noise``: standard deviations by name of a component of the sim's observation, in
    its unit; ``delay``: whole number of steps.
    """

    sim: Sim
    noise: Mapping[str, float] = field(default_factory=dict, hash=False)
    delay: int = 0

    def __post_init__(self) -> None:
        """Refuse impossible arguments; offer what the sim offers beside the protocol."""
        spec = self.sim.spec
        names = [quantity.name for quantity in spec.state]
        for name, deviation in self.noise.items():
            if name not in names:
                raise ValueError(f"noise={name!r}: expected names of {', '.join(names)}")
            if name in spec.goal:
                raise ValueError(f"noise={name!r}: expected no goal, which is given and not sensed")
            if not (_is_number(deviation) and deviation >= 0):
                raise ValueError(f"noise.{name}={deviation!r}: expected a finite number, 0 or more")
        if not (_is_number(self.delay) and self.delay == int(self.delay) and self.delay >= 0):
            raise ValueError(f"delay={self.delay!r}: expected a whole number of steps, 0 or more")
        for name, offered in _offers(self.sim, self._memory).items():
            object.__setattr__(self, name, offered)

    @property
    def traceable(self) -> bool:
        """Whether the sim's ticks can be compiled."""
        return bool(getattr(self.sim, "traceable", False))

    @property
    def spec(self) -> Spec:
        """The facts of the domain: the sim's, and a uniform number more for each component at each
        step and start (whatever its noise, so that other noise leaves the other numbers alone)."""
        return self._spec

    @cached_property
    def _spec(self) -> Spec:
        inner = self.sim.spec
        return replace(
            inner,
            disturbance_dim=inner.disturbance_dim + len(inner.state),
            reset_dim=inner.reset_dim + len(inner.state),
        )

    @property
    def lasting(self) -> tuple[int, ...]:
        """Which components of a full state last a life: those of the sim."""
        return self.sim.lasting if isinstance(self.sim, Lasting) else ()

    @property
    def _reading(self) -> int:
        """How many components a reading has."""
        return len(self.sim.spec.state) + 1

    @property
    def _memory(self) -> int:
        """How many components all readings under way have."""
        return (int(self.delay) + 1) * self._reading

    def _inner(self, state: Tensor) -> Tensor:
        """The sim's part of a full state."""
        return state[..., : state.shape[-1] - self._memory]

    def _read(self, inner: Tensor, uniforms: Tensor, valid: Tensor) -> Tensor:
        """A reading ``[n + 1, *batch]`` of the sim's state, from uniforms ``[*batch, n]``."""
        seen = self.sim.observe(inner).movedim(-1, 0).contiguous()
        draws = uniforms.movedim(-1, 0).contiguous()
        rows = [
            _sensed(value, draw, self.noise.get(quantity.name, 0.0), quantity)
            for value, draw, quantity in zip(
                seen.unbind(0), draws.unbind(0), self.sim.spec.state, strict=True
            )
        ]
        return torch.stack((*rows, valid.to(seen.dtype)))

    def _begin(self, inner: Tensor, uniforms: Tensor) -> Tensor:
        nothing = torch.zeros(inner.shape[:-1], dtype=torch.bool, device=inner.device)
        readings = [self._read(inner, uniforms, nothing)] * (int(self.delay) + 1)
        return torch.cat((inner.movedim(-1, 0), *readings)).movedim(0, -1)

    def initial(self, uniforms: Tensor) -> Tensor:
        """Start states ``[*batch, k]`` from uniforms ``[*batch, reset_dim]``."""
        drawn = self.sim.spec.reset_dim
        return self._begin(self.sim.initial(uniforms[..., :drawn]), uniforms[..., drawn:])

    def restart(self, state: Tensor, mask: Tensor, uniforms: Tensor) -> Tensor:
        """``state`` with a new start where ``mask`` ``[*batch]``, unchanged elsewhere."""
        drawn = self.sim.spec.reset_dim
        inner = self.sim.restart(self._inner(state), mask, uniforms[..., :drawn])
        return torch.where(mask[..., None], self._begin(inner, uniforms[..., drawn:]), state)

    def step(self, state: Tensor, action: Tensor, uniforms: Tensor) -> Tensor:
        """The state ``spec.dt`` later; uniforms ``[*batch, disturbance_dim]``."""
        drawn = self.sim.spec.disturbance_dim
        inner = self.sim.step(self._inner(state), action, uniforms[..., :drawn])
        if isinstance(self.sim, Fallible):
            valid = self.sim.stepped(inner)
        else:
            valid = torch.ones(inner.shape[:-1], dtype=torch.bool, device=inner.device)
        reading = self._read(inner, uniforms[..., drawn:], valid)
        later = state.movedim(-1, 0)[inner.shape[-1] + self._reading :]
        return torch.cat((inner.movedim(-1, 0), later, reading)).movedim(0, -1)

    def observe(self, state: Tensor) -> Tensor:
        """The oldest reading under way, ``[*batch, n]``."""
        readings = state[..., state.shape[-1] - self._memory :]
        return readings[..., : self._reading - 1]

    def stepped(self, state: Tensor) -> Tensor:
        """Whether the step to what is now observed was one, bool ``[*batch]``."""
        readings = state[..., state.shape[-1] - self._memory :]
        return readings[..., self._reading - 1] > 0.5

    def outcome(self, state: Tensor) -> Tensor:
        """That of the sim."""
        return self.sim.outcome(self._inner(state))

    def measures(self, start: Tensor, final: Tensor, seconds: Tensor) -> dict[str, Tensor]:
        """Those of the sim."""
        return self.sim.measures(self._inner(start), self._inner(final), seconds)

    def rows(self, xp: Namespace) -> Rows:
        """Those of the sim, read without a delay.  Raises NoRows where there is one, or the sim has
        none."""
        offered = getattr(self.sim, "rows", None)
        if offered is None:
            raise NoRows(f"{type(self.sim).__name__} is not written over rows")
        if self.delay:
            raise NoRows("delayed readings")
        inner: Rows = offered(xp)
        spec, n, width = self.sim.spec, len(self.sim.spec.state), inner.width
        move, begin, ended = xp.jit(inner.step), xp.jit(inner.start), xp.jit(inner.outcome)
        body, seen = first_over(xp, width), xp.jit(inner.observe)
        step_draws = first_over(xp, spec.disturbance_dim)
        start_draws = first_over(xp, spec.reset_dim)
        after_step = self._reading_over(xp, spec.disturbance_dim)
        after_start = self._reading_over(xp, spec.reset_dim)
        took = xp.jit(lambda s, c: 1.0)
        if inner.stepped is not None:
            happened = xp.jit(inner.stepped)
            took = xp.jit(lambda s, c: xp.as_number(happened(s, c)))

        def step(s, action, u, c):
            moved = move(body(s), action, step_draws(u), c)
            return (*moved, *after_step(seen(moved, c), u), took(moved, c))

        def start(s, u, c):
            begun = begin(body(s), start_draws(u), c)
            return (*begun, *after_start(seen(begun, c), u), 0.0)

        born = xp.jit(inner.start if inner.birth is None else inner.birth)

        def birth(u, c):
            begun = born(start_draws(u), c)
            return (*begun, *after_start(seen(begun, c), u), 0.0)

        read = joined(xp, *(xp.jit(lambda s, c, i=i: (s[width + i],)) for i in range(n)))
        return Rows(
            width=width + n + 1,
            step=step,
            observe=read,
            outcome=lambda s, c: ended(body(s), c),
            start=start,
            birth=None if inner.birth is None else birth,
            stepped=lambda s, c: s[width + n] > 0.5,
            constants=inner.constants,
        )

    def _reading_over(self, xp: Namespace, first: int) -> Function:
        """``_sensed`` of all components over rows, from the uniforms from ``first`` on."""
        quantile = normal_quantile_over(xp)

        def read(quantity: Quantity, i: int) -> Function:
            deviation, period = float(self.noise.get(quantity.name, 0.0)), quantity.period
            low, high = float(quantity.low), float(quantity.high)
            if deviation == 0:
                return xp.jit(lambda seen, u: (seen[i],))
            if period:

                @xp.jit
                def wrapped(seen, u):
                    value = seen[i] + deviation * quantile(u[first + i])
                    value = value - period * xp.floor(value / period + 0.5)
                    return (xp.maximum(xp.minimum(value, period / 2), -period / 2),)

                return wrapped

            @xp.jit
            def bounded(seen, u):
                value = seen[i] + deviation * quantile(u[first + i])
                return (xp.maximum(xp.minimum(value, high), low),)

            return bounded

        return joined(xp, *(read(q, i) for i, q in enumerate(self.sim.spec.state)))


def _sensed(value: Tensor, draw: Tensor, deviation: float, quantity: Quantity) -> Tensor:
    if deviation == 0:
        return value
    value = value + deviation * normal_quantile(draw)
    if quantity.period:
        half = quantity.period / 2
        turns = (value / quantity.period + 0.5).floor()
        return (value - quantity.period * turns).clamp(-half, half)
    return value.clamp(quantity.low, quantity.high)


def _is_number(value: Any) -> bool:
    number = isinstance(value, (int, float)) and not isinstance(value, bool)
    return number and math.isfinite(value)


def _offers(sim: Sim, memory: int) -> dict[str, Any]:
    """What ``sim`` offers beside the protocol, for states with ``memory`` components more."""
    offers: dict[str, Any] = {}
    if isinstance(sim, Actuated):
        offers["applied"] = partial(_of_inner, sim.applied, memory)
    if isinstance(sim, Invertible):
        offers["inverse_dynamics"] = partial(_of_inner, sim.inverse_dynamics, memory)
    if isinstance(sim, Rewarded):
        offers["total_reward"] = partial(_of_inner, sim.total_reward, memory)
    if isinstance(sim, Judged):
        offers["succeeded"] = partial(_of_inner, sim.succeeded, memory)
    if isinstance(sim, JudgesStates):
        # Of true states, which no sensor has changed.
        offers["judge"] = sim.judge
    if isinstance(sim, Losing):
        offers["lost"] = partial(_of_inner, sim.lost, memory)
    if isinstance(sim, Remembering):
        offers["memory"] = sim.memory
        offers["recall"] = partial(_recall, sim, memory)
    if hasattr(sim, "baselines") or hasattr(sim, "yardsticks"):
        offers["baselines"] = partial(_baselines, sim, memory)
    if isinstance(sim, Jointed):
        offers["chain"] = sim.chain
    if isinstance(sim, Pictured):
        offers["frame"] = partial(_of_inner, sim.frame, memory)
    return offers


def _of_inner(method: Callable[..., Any], memory: int, state: Tensor, *others: Any) -> Any:
    return method(state[..., : state.shape[-1] - memory], *others)


def _recall(sim: Remembering, readings: int, state: Tensor, memory: dict[str, Tensor]) -> Tensor:
    size = state.shape[-1] - readings
    return torch.cat((sim.recall(state[..., :size], memory), state[..., size:]), -1)


def _baselines(sim: Sim, memory: int) -> Mapping[str, Controller]:
    return {
        name: partial(_of_inner, control, memory) for name, control in baselines_of(sim).items()
    }
