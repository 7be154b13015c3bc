"""Fresh episodes of finished policies: no exploration, no learning.

Where something lasts a learner's whole life (``sims.base.Lasting``), a policy is tried in the world
in which its seed learned.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from edtorch.learner.learner import Actor
from edtorch.policy.memory import EpisodeMemory
from edtorch.run.episodes import Episode
from edtorch.run.random import Purpose, Streams, learning_streams, stream_key
from edtorch.run.rollout import finished, rollout
from edtorch.run.scaled_sim import World
from edtorch.run.success import all_settled
from edtorch.run.tick import Tick
from edtorch.types import Parameters, Transition
from sims.base import Lasting

Watch = Callable[[Tensor], None]
"""Is shown the sim's states ``[S episodes, k]`` after each tick; those of an episode that has ended
stay as they are."""


def evaluate(
    policy: Actor,
    parameters: Parameters,
    world: World,
    seeds: Sequence[int],
    episodes: int,
    *,
    watch: Watch | None = None,
    observer: EpisodeMemory | None = None,
    among: Sequence[Episode] = (),
    purpose: Purpose = Purpose.EVALUATION,
    ticks: int | None = None,
) -> list[list[Episode]]:
    """Run ``episodes`` fresh episodes of each policy, without exploration and without learning.

    parameters: ``[S, ...]``, one policy per seed.  Returns the episodes of each policy, in order;
    episode e of a seed is the same whatever else is evaluated beside it.  watch: see ``Watch``;
    observer: what the policies estimate the state with, None if they take what they observe for it;
    among: the other episodes of the run, see ``edtorch.run.success.all_settled``; purpose: of the
    random numbers; ticks: how many at most, None for no limit.  Episodes that are lost, or have not
    ended by then, are left out.
    """
    most = getattr(world.sim, "rows_at_once", None)
    at_once = max(1, episodes if most is None else most // len(seeds))
    found: list[list[Episode]] = [[] for _ in seeds]
    for first in range(0, episodes, at_once):
        numbers = range(first, min(first + at_once, episodes))
        expanded = {k: p.repeat_interleave(len(numbers), dim=0) for k, p in parameters.items()}
        tick = Tick(Frozen(policy, expanded, observer), world, most_episodes=1)
        for own, more in zip(found, _run(tick, seeds, numbers, watch, purpose, ticks), strict=True):
            own += more
    return all_settled(found, among)


def evaluate_controller(
    control: Callable[[Tensor], Tensor], world: World, seeds: Sequence[int], episodes: int
) -> list[list[Episode]]:
    """The same episodes with a controller that sees all: full states ``[N, k]`` to actions
    ``[N, m]``, physical units (``sims.base.Measured``)."""
    knowing = Frozen(_Control(control, world), {}, None)
    tick = Tick(knowing, world, most_episodes=1, view=lambda worlds: worlds.world)
    return all_settled(_run(tick, seeds, range(episodes), None, Purpose.EVALUATION))


@dataclass(frozen=True)
class Frozen:
    """A source of actions that learns nothing (``edtorch.run.tick.Source``).

    parameters: of the policy, ``[N, ...]``; observer: what it estimates the state with, None if it
    takes what it observes for it.
    """

    policy: Actor
    parameters: Parameters
    observer: EpisodeMemory | None

    def begin(self, memory: Parameters, fresh: Tensor, observation: Tensor, /) -> Parameters:
        """New episodes of those that are ``fresh``: all of them where nothing is remembered."""
        if self.observer is None:
            return memory
        if not memory:
            return self.observer.initial(observation)
        return self.observer.begin(memory, fresh, observation)

    def act(self, memory: Parameters, observation: Tensor, normal: Tensor, /) -> Tensor:
        """The policy's action, without exploration."""
        if self.observer is not None:
            observation = self.observer.now(self.parameters, memory, observation)
        return self.policy.action(self.parameters, observation)

    def step(
        self, memory: Parameters, transition: Transition, /, *, improve: bool
    ) -> tuple[Parameters, None]:
        """Goes on estimating."""
        if self.observer is None:
            return memory, None
        return self.observer.follow(self.parameters, memory, transition), None


@dataclass(frozen=True)
class _Control:
    """A controller in physical units as an ``Actor``."""

    control: Callable[[Tensor], Tensor]
    world: World

    def action(self, parameters: Parameters, observation: Tensor, /) -> Tensor:
        """Of full states ``[N, k]``, scaled."""
        return self.world.scaled(self.control(observation))


def starts(world: World, seeds: Sequence[int], episodes: int, uniform: Tensor) -> Tensor:
    """Start states ``[S episodes, k]`` from uniforms ``[S episodes, u]``."""
    if not (isinstance(world.sim, Lasting) and world.sim.lasting):
        return world.initial(uniform)
    born = world.initial(learning_streams(world, seeds).at(0).uniform)
    born = born.repeat_interleave(episodes, dim=0)
    everybody = torch.ones(len(born), dtype=torch.bool, device=born.device)
    return world.restart(born, everybody, uniform)


def _run(
    tick: Tick[Parameters],
    seeds: Sequence[int],
    numbers: range,
    watch: Watch | None,
    purpose: Purpose,
    most: int | None = None,
) -> list[list[Episode]]:
    """The episodes ``numbers`` of each seed; whether they are a success may be open."""
    world, episodes = tick.world, len(numbers)
    keys = [stream_key(s, purpose, e) for s in seeds for e in numbers]
    streams = Streams(keys, world.uniforms, 0, world.dtype, world.device)
    found: list[list[Episode]] = [[] for _ in seeds]
    with torch.inference_mode():
        start = starts(world, seeds, episodes, streams.at(0).uniform)
        for happened in rollout(tick, tick.first({}, start), streams.at, ticks=most):
            after = happened.after
            if watch is not None:
                watch(after.world)
            if not happened.ended:
                continue
            ticks = torch.full((len(keys),), happened.clock, device=world.device)
            for ended in finished(world, start, after.world, ticks, happened.outcome, after.earned):
                if ended is not None:
                    row, number = divmod(ended.row, episodes)
                    found[row].append(replace(ended, row=row, number=numbers[number]))
    return [sorted(own, key=lambda e: e.number) for own in found]
