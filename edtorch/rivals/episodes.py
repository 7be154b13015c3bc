"""Many episodes of many policies on few slots: a tile that stays full.

A tile holds one episode per slot and advances all of them together, without a look at the result;
every few dozen ticks the host looks, takes the finished episodes out and puts new ones in.  What an
episode does depends on its key alone (``edtorch.run.hashing``): not on its slot, not on the size
of the tile, not on when it began.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor
from torch._higher_order_ops.scan import scan

from edtorch.compiled.compilation import CompileMode, compiled
from edtorch.policy.policies import LinearPolicy, explore
from edtorch.run.hashing import normals, uniform
from edtorch.run.scaled_sim import World
from edtorch.types import select
from sims.base import Outcome

IDLE = int(Outcome.TIMED_OUT)
"""How an empty slot looks to the tick: like any episode that is over, it stays as it is."""

Advance = Callable[..., tuple[Tensor, ...]]
"""(state ``[S, k]``, weight ``[S, m, n]``, key ``[S, 2]``, ticks ``[S]``, outcome ``[S]``, sums...)
to (state, ticks, outcome, sums...) some ticks later.  An episode that is over stays as it ended."""


@dataclass(frozen=True)
class EpisodeTick:
    """One tick of S episodes, for an ``Accumulator``.

    ticks ``[S]`` before it; observation ``[S, n]``, and the action ``[S, m]`` that was applied
    there, scaled; normal ``[S, m]``: the standard normal numbers it explored with, zero without.
    """

    ticks: Tensor
    observation: Tensor
    action: Tensor
    normal: Tensor


class Accumulator(Protocol):
    """What is added up over an episode beside its outcome; and how it explores."""

    @property
    def deviation(self) -> float:
        """Standard deviation of the exploration added to each action, scaled; 0: none."""
        ...

    def begin(self, slots: int) -> tuple[Tensor, ...]:
        """The sums of episodes that begin, zeros, each ``[slots, ...]``."""
        ...

    def add(self, sums: tuple[Tensor, ...], tick: EpisodeTick) -> tuple[Tensor, ...]:
        """The sums one tick later: a function of tensors alone, which can be compiled."""
        ...


def one_tick(
    world: World,
    policy: LinearPolicy,
    accumulator: Accumulator | None = None,
    limit: int | None = None,
) -> Advance:
    """All slots, one tick on.  limit: ticks after which an episode is cut off, as if out of time;
    None: only the world's own time limit."""
    actions = policy.weight.shape[0]
    explores = accumulator is not None and accumulator.deviation > 0
    # Normal numbers come in pairs.
    drawn = world.uniforms + (2 * ((actions + 1) // 2) if explores else 0)

    def tick(
        state: Tensor,
        weight: Tensor,
        key: Tensor,
        ticks: Tensor,
        outcome: Tensor,
        *sums: Tensor,
    ) -> tuple[Tensor, ...]:
        running = outcome == int(Outcome.RUNNING)
        later = ticks + 1
        numbers = uniform(key, later, drawn)
        observation = world.observe(state)
        action = policy.action({"weight": weight}, observation)
        normal = torch.zeros_like(action)
        if accumulator is not None and explores:
            normal = normals(numbers[..., world.uniforms :])[..., :actions].to(action.dtype)
            action = explore(action, normal, accumulator.deviation)
        action = world.clip(action)
        moved = world.step(state, action, numbers[..., : world.uniforms])
        now = world.outcome(moved, later)
        if limit is not None:
            cut = (now == int(Outcome.RUNNING)) & (later >= limit)
            now = torch.where(cut, int(Outcome.TIMED_OUT), now)
        more: tuple[Tensor, ...] = ()
        if accumulator is not None:
            added = accumulator.add(sums, EpisodeTick(ticks, observation, action, normal))
            more = tuple(select(running, a, b) for a, b in zip(added, sums, strict=True))
        return (
            select(running, moved, state),
            torch.where(running, later, ticks),
            torch.where(running, now, outcome),
            *more,
        )

    return tick


def looped(tick: Advance, count: int) -> Advance:
    """``count`` ticks, one after the other."""

    def advance(
        state: Tensor, weight: Tensor, key: Tensor, ticks: Tensor, outcome: Tensor, *sums: Tensor
    ) -> tuple[Tensor, ...]:
        for _ in range(count):
            state, ticks, outcome, *more = tick(state, weight, key, ticks, outcome, *sums)
            sums = tuple(more)
        return state, ticks, outcome, *sums

    return advance


def scanned(tick: Advance, count: int) -> Advance:
    """``looped`` as a loop in the graph: one tick to compile, however many there are to run."""

    def advance(
        state: Tensor, weight: Tensor, key: Tensor, ticks: Tensor, outcome: Tensor, *sums: Tensor
    ) -> tuple[Tensor, ...]:
        def body(carry: tuple[Tensor, ...], blank: Tensor) -> tuple[tuple[Tensor, ...], Tensor]:
            new = tick(carry[0], weight, key, *carry[1:])
            # What goes round must not share memory with what came in.
            return tuple(part.clone() for part in new), blank.clone()

        blanks = torch.zeros(count, 2, dtype=torch.int64, device=state.device)
        carry, _ = scan(body, (state, ticks, outcome, *sums), blanks)
        return tuple(carry)

    return advance


@dataclass(frozen=True)
class Finished:
    """Episodes that are over: slot, outcome, ticks ``[F]`` (int64), final state ``[F, k]``; sums:
    of the accumulator, each ``[F, ...]``."""

    slot: Tensor
    outcome: Tensor
    ticks: Tensor
    state: Tensor
    sums: tuple[Tensor, ...] = ()


class Tile:
    """``slots`` episodes at a time, looked at every ``look`` ticks; in inference mode.

    eager: ticks before it goes on compiled, where ``mode`` lets it: compiling takes half a minute,
    which few ticks are not worth.  accumulator, limit: see ``one_tick``.
    """

    def __init__(
        self,
        world: World,
        policy: LinearPolicy,
        *,
        slots: int,
        look: int,
        mode: CompileMode,
        accumulator: Accumulator | None = None,
        limit: int | None = None,
        eager: int = 0,
    ) -> None:
        self._world = world
        self._look = look
        self._mode: CompileMode = mode
        self._eager = eager
        self._tick = one_tick(world, policy, accumulator, limit)
        self._advance: Advance | None = None
        actions, features = policy.weight.shape
        # The batch last in memory, everywhere: a component is one run of memory.
        self._weight = _batch_last(slots, actions, features, dtype=policy.weight.dtype)
        self._key = _batch_last(slots, 2, dtype=torch.int64)
        start = world.initial(uniform(self._key, self._zeros(slots), world.uniforms))
        self._state = _batch_last(slots, start.shape[-1]).copy_(start)
        self._ticks = self._zeros(slots)
        self._outcome = torch.full_like(self._ticks, IDLE)
        zeros = () if accumulator is None else accumulator.begin(slots)
        self._sums = tuple(_batch_last(slots, *z.shape[1:], dtype=z.dtype) for z in zeros)
        self._busy = torch.zeros(slots, dtype=torch.bool)

    @staticmethod
    def _zeros(slots: int) -> Tensor:
        return torch.zeros(slots, dtype=torch.int64)

    @property
    def busy(self) -> int:
        """Slots with an episode."""
        return int(self._busy.sum())

    def free(self) -> list[int]:
        """Slots without one."""
        return (~self._busy).nonzero().flatten().tolist()

    def place(self, slot: Tensor, weight: Tensor, key: Tensor) -> None:
        """Begin episodes in free slots: slot ``[F]``, weight ``[F, m, n]``, key ``[F, 2]``."""
        fresh = torch.zeros_like(self._busy)
        fresh[slot] = True
        self._weight[slot] = weight.to(self._weight.dtype)
        self._key[slot] = key
        self._ticks[slot] = 0
        self._outcome[slot] = int(Outcome.RUNNING)
        for part in self._sums:
            part[slot] = 0
        self._busy |= fresh
        numbers = uniform(self._key, torch.zeros_like(self._ticks), self._world.uniforms)
        # Copied, so that the layout in memory is the one that was compiled for.
        self._state.copy_(self._world.restart(self._state, fresh, numbers))

    def drop(self, slot: Tensor) -> None:
        """Free slots ``[F]`` whose episodes are no longer wanted."""
        self._outcome[slot] = IDLE
        self._busy[slot] = False

    def _program(self) -> Advance:
        if self._eager > 0:
            self._eager -= self._look
            return looped(self._tick, self._look)
        if self._advance is None:
            self._advance = (
                looped(self._tick, self._look)
                if self._mode == "off"
                else compiled(scanned(self._tick, self._look), mode=self._mode)
            )
        return self._advance

    def advance(self) -> Finished:
        """``look`` ticks; the episodes that ended in them leave their slots."""
        moved = self._program()(
            self._state, self._weight, self._key, self._ticks, self._outcome, *self._sums
        )
        for kept, new in zip(
            (self._state, self._ticks, self._outcome, *self._sums), moved, strict=True
        ):
            kept.copy_(new)
        slot = (self._busy & (self._outcome != int(Outcome.RUNNING))).nonzero().flatten()
        self._busy[slot] = False
        return Finished(
            slot,
            self._outcome[slot],
            self._ticks[slot],
            self._state[slot],
            tuple(part[slot] for part in self._sums),
        )


def _batch_last(slots: int, *shape: int, dtype: torch.dtype = torch.float64) -> Tensor:
    return torch.zeros(*shape, slots, dtype=dtype).movedim(-1, 0)
