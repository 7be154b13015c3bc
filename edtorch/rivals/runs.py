"""Episodes of linear policies from their starts to their ends, compiled or not."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace

import torch
from torch import Tensor

from edtorch.native.choice import Mode, kernel_for
from edtorch.policy.policies import LinearPolicy
from edtorch.rivals.episodes import Accumulator, EagerEpisodes, Ended, Episodes
from edtorch.rivals.native_episodes import NativeEpisodes
from edtorch.rivals.returns import Return
from edtorch.run.episodes import Episode
from edtorch.run.hashing import Use, hash_key, uniform
from edtorch.run.rollout import finished
from edtorch.run.scaled_sim import World
from edtorch.run.success import all_settled
from sims.base import Lasting, Rewarded

SLOTS = 1024
"""Episodes side by side, where there is no kernel."""
LOOK = 64
"""Ticks after which those that are over are looked for there."""


class Runs:
    """Runs episodes of linear policies, compiled where it can be.

    limit: ticks after which an episode is cut off, which looks like TIMED_OUT; None: only the
    world's own time limit.  slots, look: of ``EagerEpisodes``.  What an episode does depends on its
    weights and its key alone.  ValueError for a sim that is not of tensor functions alone
    (``traceable``), for an episode may then not be stepped in any order, and with native="on" where
    there is no kernel.
    """

    def __init__(
        self,
        world: World,
        policy: LinearPolicy,
        *,
        native: Mode,
        accumulator: Accumulator | None = None,
        limit: int | None = None,
        slots: int = SLOTS,
        look: int = LOOK,
    ) -> None:
        check_runnable(world)
        self._world = world
        parts = (world, policy, accumulator, world.limit_ticks if limit is None else limit)
        found = kernel_for(native, lambda: NativeEpisodes(*parts), "episodes are")
        self._episodes: Episodes = found or EagerEpisodes(*parts, slots=slots, look=look)

    @property
    def steps(self) -> int:
        """Ticks that all episodes have made."""
        return self._episodes.steps

    def __call__(self, weight: Tensor, key: Tensor, pause: Callable[[], None]) -> Ended:
        """Episodes of weights ``[E, m, n]`` with keys ``[E, 2]``, in order; at least one.
        ``pause`` is called about every second, and what it raises ends it."""
        parts: list[tuple[Tensor, ...]] = []
        for ended in self.pieces(weight, key):
            whole = (ended.number, ended.outcome, ended.ticks, ended.state, *ended.sums)
            parts.append(whole)
            pause()
        number, *columns = (torch.cat(column) for column in zip(*parts, strict=True))
        order = number.argsort()
        outcome, ticks, state, *sums = (column[order] for column in columns)
        return Ended(number[order], outcome, ticks, state, tuple(sums))

    @torch.inference_mode()
    def pieces(self, weight: Tensor, key: Tensor) -> Iterator[Ended]:
        """The same, as they end."""
        world, zero = self._world, torch.zeros_like(key)
        # What lasts from one episode to the next is that of the same life for all.
        start = world.initial(uniform(zero, zero[:, 0], world.uniforms))
        everybody = torch.ones_like(zero[:, 0], dtype=torch.bool)
        start = world.restart(start, everybody, uniform(key, zero[:, 0], world.uniforms))
        yield from self._episodes.pieces(weight.detach().to(world.dtype), key, start)


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


def evaluator(world: World, policy: LinearPolicy, *, native: Mode) -> Runs:
    """For ``fresh_episodes``: adds up the return where the world has one by a reward of its own."""
    reward = world.reward
    total = None if reward is None or isinstance(world.sim, Rewarded) else reward
    accumulator = None if total is None else Return(total, 1.0, world.dt)
    return Runs(world, policy, native=native, accumulator=accumulator)


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
