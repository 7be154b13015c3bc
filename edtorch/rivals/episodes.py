"""Many episodes of many linear policies, some side by side.

What an episode does depends on its weights and its key alone (``edtorch.run.hashing``): not on what
else is run, nor on when it begins.  Here torch steps them; ``edtorch.rivals.native_episodes`` has
the same compiled.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Protocol

import torch
from torch import Tensor

from edtorch.policy.policies import LinearPolicy, explore
from edtorch.rewards import Reward
from edtorch.rivals.ledger import Account, pay
from edtorch.run.hashing import normals, uniform
from edtorch.run.scaled_sim import World
from edtorch.types import select
from sims.base import Outcome


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
    """What is added up over an episode beside its outcome; and how it explores.

    kernel: name of the function in ``edtorch/native/kernels/episodes.py`` that adds the same up,
    and numbers: its own, by name; reward: of scaled observations and actions.
    """

    @property
    def kernel(self) -> str:
        """See the class."""
        ...

    @property
    def numbers(self) -> Mapping[str, float]:
        """See the class."""
        ...

    @property
    def reward(self) -> Reward:
        """See the class."""
        ...

    @property
    def deviation(self) -> float:
        """Standard deviation of the exploration added to each action, scaled; 0: none."""
        ...

    def begin(self, episodes: int) -> tuple[Tensor, ...]:
        """The sums of episodes that begin, zeros, each ``[episodes, ...]``."""
        ...

    def add(self, sums: tuple[Tensor, ...], tick: EpisodeTick) -> tuple[Tensor, ...]:
        """The sums one tick later."""
        ...


@dataclass(frozen=True)
class Ended:
    """F episodes that are over: number of each ``[F]``, in the order of the call; outcome, ticks
    ``[F]`` (all int64), final state ``[F, k]``; sums: of the accumulator, each ``[F, ...]``."""

    number: Tensor
    outcome: Tensor
    ticks: Tensor
    state: Tensor
    sums: tuple[Tensor, ...] = ()

    def pay(self, account: Account, world: World, own: slice) -> None:
        """Enter the episodes ``own``, which are those of one seed."""
        pay(account, world, self.state[own], self.outcome[own], self.ticks[own])


class Episodes(Protocol):
    """Episodes that end piece by piece; each piece takes a second or so at most."""

    steps: int
    """Ticks that all of them have made."""

    def pieces(self, weight: Tensor, key: Tensor, start: Tensor) -> Iterator[Ended]:
        """Of episodes with weights ``[E, m, k]`` and keys ``[E, 2]`` from states ``[E, w]``."""
        ...


class EagerEpisodes:
    """Up to ``slots`` episodes side by side; those that are over are looked for every ``look``
    ticks.  limit: ticks after which an episode is cut off, which looks like TIMED_OUT."""

    def __init__(
        self,
        world: World,
        policy: LinearPolicy,
        accumulator: Accumulator | None,
        limit: int,
        *,
        slots: int,
        look: int,
    ) -> None:
        self.steps = 0
        self._world, self._policy, self._accumulator = world, policy, accumulator
        self._limit, self._slots, self._look = limit, slots, look
        actions = policy.weight.shape[0]
        self._explores = accumulator is not None and accumulator.deviation > 0
        # Normal numbers come in pairs.
        self._drawn = world.uniforms + (2 * ((actions + 1) // 2) if self._explores else 0)

    def pieces(self, weight: Tensor, key: Tensor, start: Tensor) -> Iterator[Ended]:
        """See ``Episodes``."""
        count, zeros = len(key), torch.zeros_like(key[:, 0])
        sums = () if self._accumulator is None else self._accumulator.begin(count)
        # What is kept of an episode while it goes on, and what changes then.
        every = (torch.arange(count), weight, key, start, zeros, zeros, *sums)
        running = tuple(_rows(part, slice(0, 0)) for part in every)
        begun = 0
        while True:
            free = slice(begun, min(count, begun + self._slots - len(running[0])))
            begun = free.stop
            running = tuple(
                torch.cat([part.movedim(0, -1), _rows(whole, free).movedim(0, -1)], -1).movedim(
                    -1, 0
                )
                for part, whole in zip(running, every, strict=True)
            )
            number, own, hashed, *changing = running
            if not len(number):
                return
            for _ in range(self._look):
                changing = self._tick(own, hashed, *changing)
            self.steps += self._look * len(number)
            state, ticks, outcome, *added = changing
            over = (outcome != int(Outcome.RUNNING)).nonzero().flatten()
            yield Ended(
                number[over],
                outcome[over],
                ticks[over],
                state[over],
                tuple(part[over] for part in added),
            )
            left = (outcome == int(Outcome.RUNNING)).nonzero().flatten()
            running = tuple(_rows(part, left) for part in (number, own, hashed, *changing))

    def _tick(
        self,
        weight: Tensor,
        key: Tensor,
        state: Tensor,
        ticks: Tensor,
        outcome: Tensor,
        *sums: Tensor,
    ) -> Sequence[Tensor]:
        """One tick on; an episode that is over stays as it ended."""
        world, accumulator = self._world, self._accumulator
        running = outcome == int(Outcome.RUNNING)
        later = ticks + 1
        numbers = uniform(key, later, self._drawn)
        observation = world.observe(state)
        action = self._policy.action({"weight": weight}, observation)
        normal = torch.zeros_like(action)
        if accumulator is not None and self._explores:
            drawn = normals(numbers[..., world.uniforms :])
            normal = drawn[..., : action.shape[-1]].to(action.dtype)
            action = explore(action, normal, accumulator.deviation)
        action = world.clip(action)
        moved = world.step(state, action, numbers[..., : world.uniforms])
        now = world.outcome(moved, later)
        cut = (now == int(Outcome.RUNNING)) & (later >= self._limit)
        now = torch.where(cut, int(Outcome.TIMED_OUT), now)
        if accumulator is not None:
            added = accumulator.add(sums, EpisodeTick(ticks, observation, action, normal))
            sums = tuple(select(running, a, b) for a, b in zip(added, sums, strict=True))
        return (
            select(running, moved, state),
            torch.where(running, later, ticks),
            torch.where(running, now, outcome),
            *sums,
        )


def _rows(part: Tensor, rows: Tensor | slice) -> Tensor:
    """``part[rows]``, the batch last in memory: a component is one run of memory."""
    return part.movedim(0, -1)[..., rows].contiguous().movedim(-1, 0)
