"""Episodes of linear policies from their starts to their ends, as many at a time as there is room.

``edtorch.rivals.episodes.Tile`` advances them; here each gets its slot in turn, and its results
their place.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from edtorch.compiled.compilation import CompileMode
from edtorch.policy.policies import LinearPolicy
from edtorch.rivals.episodes import Accumulator, Tile
from edtorch.rivals.ledger import Account, pay
from edtorch.rivals.returns import Return
from edtorch.run.episodes import Episode
from edtorch.run.hashing import Use, hash_key, uniform
from edtorch.run.rollout import finished
from edtorch.run.scaled_sim import World
from edtorch.run.success import all_settled
from sims.base import Lasting, Rewarded

SLOTS = 1024
"""Of a tile: as many as the processor's caches hold, with what a tick makes of them."""
EAGER_TICKS = 5_000
"""Of a tile, before it is compiled: about half as long as compiling takes, once it is cached."""


@dataclass(frozen=True)
class Ended:
    """E episodes from their starts to their ends: outcome, ticks ``[E]`` (int64), final state
    ``[E, k]``, sums of the accumulator, each ``[E, ...]``."""

    outcome: Tensor
    ticks: Tensor
    state: Tensor
    sums: tuple[Tensor, ...]

    def pay(self, account: Account, world: World, own: slice) -> None:
        """Enter the episodes ``own``, which are those of one seed."""
        pay(account, world, self.state[own], self.outcome[own], self.ticks[own])


class Runs:
    """Runs episodes of linear policies, on up to ``slots`` slots looked at every ``look`` ticks.

    limit: ticks after which an episode is cut off, which looks like TIMED_OUT; the rest as of
    ``Tile``.  What an episode does depends on its weights and its key alone.  ValueError for a sim
    that is not of tensor functions alone (``traceable``), for an episode may then not be stepped in
    any order.
    """

    def __init__(
        self,
        world: World,
        policy: LinearPolicy,
        *,
        mode: CompileMode,
        slots: int = SLOTS,
        look: int = 128,
        accumulator: Accumulator | None = None,
        limit: int | None = None,
        eager: int = EAGER_TICKS,
    ) -> None:
        check_runnable(world)
        self._slots = slots
        with torch.inference_mode():
            self._tile = Tile(
                world,
                policy,
                slots=slots,
                look=look,
                mode=mode,
                accumulator=accumulator,
                limit=limit,
                eager=eager,
            )

    def __call__(self, weight: Tensor, key: Tensor, pause: Callable[[], None]) -> Ended:
        """Episodes of weights ``[E, m, n]`` with keys ``[E, 2]``; at least one.  ``pause`` is
        called between two looks, and what it raises ends it."""
        with torch.inference_mode():
            return self._run(weight, key, pause)

    def _run(self, weight: Tensor, key: Tensor, pause: Callable[[], None]) -> Ended:
        tile, count, begun = self._tile, len(key), 0
        # Of an interrupted call before.
        tile.drop(torch.arange(self._slots))
        at = torch.zeros(self._slots, dtype=torch.int64)
        where: list[Tensor] = []
        parts: list[tuple[Tensor, ...]] = []
        while begun < count or tile.busy:
            free = tile.free()[: count - begun]
            if free:
                slot = torch.tensor(free)
                own = torch.arange(begun, begun + len(free))
                tile.place(slot, weight[own], key[own])
                at[slot] = own
                begun += len(free)
            finished = tile.advance()
            where.append(at[finished.slot])
            parts.append((finished.outcome, finished.ticks, finished.state, *finished.sums))
            pause()
        order = torch.cat(where).argsort()
        outcome, ticks, state, *sums = (torch.cat(p)[order] for p in zip(*parts, strict=True))
        return Ended(outcome, ticks, state, tuple(sums))


def check_runnable(world: World) -> None:
    """Raises ValueError for a sim whose episodes cannot be run side by side in any order."""
    if not getattr(world.sim, "traceable", False):
        raise ValueError(
            f"{world.spec.name}: expected a domain of tensor functions alone (traceable), whose"
            " episodes can be run in any order"
        )


def can_try(world: World) -> bool:
    """Whether ``fresh_episodes`` are those of ``edtorch.run.evaluation``, other random numbers
    apart: nothing lasts from one to the next, and no angle is counted on from tick to tick."""
    lasting = isinstance(world.sim, Lasting) and bool(world.sim.lasting)
    return bool(getattr(world.sim, "traceable", False)) and not lasting and not world.unwraps


def evaluator(world: World, policy: LinearPolicy, *, mode: CompileMode, slots: int) -> Runs:
    """For ``fresh_episodes``: adds up the return where the world has one by a reward of its own."""
    reward = world.reward
    total = None if reward is None or isinstance(world.sim, Rewarded) else reward
    accumulator = None if total is None else Return(total, 1.0, world.dt)
    return Runs(world, policy, mode=mode, slots=slots, accumulator=accumulator)


def fresh_episodes(
    runs: Runs,
    world: World,
    weight: Tensor,
    seeds: Sequence[int],
    episodes: int,
    pause: Callable[[], None],
) -> list[list[Episode]]:
    """As ``edtorch.run.evaluation.evaluate`` for linear policies of weights ``[S, m, n]``: fresh
    episodes of each, the same ones of a seed whatever else is tried.  runs: from ``evaluator``."""
    number = torch.arange(episodes)
    key = torch.cat([hash_key(Use.FRESH, seed, number) for seed in seeds])
    ended = runs(weight.detach().repeat_interleave(episodes, dim=0), key, pause)
    start = world.initial(uniform(key, torch.zeros_like(key[:, 0]), world.uniforms))
    earned = torch.full((len(key),), math.nan, dtype=torch.float64)
    if isinstance(world.sim, Rewarded):
        earned = world.sim.total_reward(ended.state)
    elif ended.sums:
        (earned,) = ended.sums
    outcome = world.rule.outcome(world.sim, ended.state, ended.outcome, earned)
    found = finished(world, start, ended.state, ended.ticks, outcome, earned)
    own = [
        [
            replace(e, row=row, number=k)
            for k in range(episodes)
            if (e := found[row * episodes + k]) is not None
        ]
        for row in range(len(seeds))
    ]
    return all_settled(own)
