"""Many episodes of many policies on few slots: a tile that stays full.

A tile holds one episode per slot and advances all of them together, without a look at the result;
every few dozen ticks the host looks, takes the finished episodes out and puts new ones in.  What an
episode does depends on its key alone (``edtorch.hashing``): not on its slot, not on the size of the
tile, not on when it began.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch._higher_order_ops.scan import scan

from edtorch.compilation import Wish, compiled
from edtorch.hashing import uniform
from edtorch.policies import LinearPolicy
from edtorch.types import select
from edtorch.world import World
from sims.base import Outcome

IDLE = int(Outcome.TIMED_OUT)
"""How an empty slot looks to the tick: like any episode that is over, it stays as it is."""

Advance = Callable[[Tensor, Tensor, Tensor, Tensor, Tensor], tuple[Tensor, Tensor, Tensor]]
"""(state ``[S, k]``, weight ``[S, m, n]``, key ``[S, 2]``, ticks ``[S]``, outcome ``[S]``) to
(state, ticks, outcome) some ticks later.  An episode that is over stays as it ended."""


def one_tick(world: World, policy: LinearPolicy) -> Advance:
    """All slots, one tick on."""

    def tick(
        state: Tensor, weight: Tensor, key: Tensor, ticks: Tensor, outcome: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        running = outcome == int(Outcome.RUNNING)
        later = ticks + 1
        action = world.clip(policy.action({"weight": weight}, world.observe(state)))
        moved = world.step(state, action, uniform(key, later, world.uniforms))
        return (
            select(running, moved, state),
            torch.where(running, later, ticks),
            torch.where(running, world.outcome(moved, later), outcome),
        )

    return tick


def looped(tick: Advance, count: int) -> Advance:
    """``count`` ticks, one after the other."""

    def advance(
        state: Tensor, weight: Tensor, key: Tensor, ticks: Tensor, outcome: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        for _ in range(count):
            state, ticks, outcome = tick(state, weight, key, ticks, outcome)
        return state, ticks, outcome

    return advance


def scanned(tick: Advance, count: int) -> Advance:
    """``looped`` as a loop in the graph: one tick to compile, however many there are to run."""

    def advance(
        state: Tensor, weight: Tensor, key: Tensor, ticks: Tensor, outcome: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        def body(
            carry: tuple[Tensor, Tensor, Tensor], blank: Tensor
        ) -> tuple[tuple[Tensor, Tensor, Tensor], Tensor]:
            state, ticks, outcome = tick(carry[0], weight, key, carry[1], carry[2])
            # What goes round must not share memory with what came in.
            return (state.clone(), ticks.clone(), outcome.clone()), blank.clone()

        blanks = torch.zeros(count, 2, dtype=torch.int64, device=state.device)
        carry, _ = scan(body, (state, ticks, outcome), blanks)
        return carry

    return advance


@dataclass(frozen=True)
class Finished:
    """Episodes that are over: slot, outcome, ticks ``[F]`` (int64), final state ``[F, k]``."""

    slot: Tensor
    outcome: Tensor
    ticks: Tensor
    state: Tensor


class Tile:
    """``slots`` episodes at a time, looked at every ``look`` ticks; in inference mode."""

    def __init__(
        self, world: World, policy: LinearPolicy, *, slots: int, look: int, wish: Wish
    ) -> None:
        self._world = world
        tick = one_tick(world, policy)
        self._advance = (
            looped(tick, look) if wish == "off" else compiled(scanned(tick, look), wish=wish)
        )
        actions, features = policy.weight.shape
        # The batch last in memory, everywhere: a component is one run of memory.
        self._weight = _batch_last(slots, actions, features)
        self._key = _batch_last(slots, 2, dtype=torch.int64)
        start = world.initial(uniform(self._key, self._zeros(slots), world.uniforms))
        self._state = _batch_last(slots, start.shape[-1]).copy_(start)
        self._ticks = self._zeros(slots)
        self._outcome = torch.full_like(self._ticks, IDLE)
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
        self._weight[slot] = weight
        self._key[slot] = key
        self._ticks[slot] = 0
        self._outcome[slot] = int(Outcome.RUNNING)
        self._busy |= fresh
        numbers = uniform(self._key, torch.zeros_like(self._ticks), self._world.uniforms)
        # Copied, so that the layout in memory is the one that was compiled for.
        self._state.copy_(self._world.restart(self._state, fresh, numbers))

    def drop(self, slot: Tensor) -> None:
        """Free slots ``[F]`` whose episodes are no longer wanted."""
        self._outcome[slot] = IDLE
        self._busy[slot] = False

    def advance(self) -> Finished:
        """``look`` ticks; the episodes that ended in them leave their slots."""
        self._state, self._ticks, self._outcome = self._advance(
            self._state, self._weight, self._key, self._ticks, self._outcome
        )
        slot = (self._busy & (self._outcome != int(Outcome.RUNNING))).nonzero().flatten()
        self._busy[slot] = False
        return Finished(slot, self._outcome[slot], self._ticks[slot], self._state[slot])


def _batch_last(slots: int, *shape: int, dtype: torch.dtype = torch.float64) -> Tensor:
    return torch.zeros(*shape, slots, dtype=dtype).movedim(-1, 0)
