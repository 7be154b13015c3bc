"""Fresh episodes of finished policies: no exploration, no learning.

Where something lasts a learner's whole life (``sims.base.Lasting``), a policy is tried in the world
in which its seed learned.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Protocol

import torch
from torch import Tensor

from edtorch.learner.learner import Actor
from edtorch.learner.observer import Observer
from edtorch.run.episodes import Episode
from edtorch.run.random import Purpose, Streams, learning_streams, stream_key
from edtorch.run.scaled_sim import World
from edtorch.run.success import as_success, settled
from edtorch.types import Parameters, Transition, select
from sims.base import Lasting, Outcome

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
    observer: Observer | None = None,
    among: Sequence[Episode] = (),
) -> list[list[Episode]]:
    """Run ``episodes`` fresh episodes of each policy, without exploration and without learning.

    parameters: ``[S, ...]``, one policy per seed.  Returns the episodes of each policy, in order;
    episode e of a seed is the same whatever else is evaluated beside it.  watch: see ``Watch``;
    observer: what the policies estimate the state with, None if they take what they observe for it;
    among: the other episodes of the run, see ``edtorch.run.success.settled``.  Lost episodes are
    left out.
    """
    expanded = {k: p.repeat_interleave(episodes, dim=0) for k, p in parameters.items()}
    rider = _Memoryless(lambda state, observation: policy.action(expanded, observation))
    if observer is not None:
        rider = _Observing(policy, expanded, observer)
    return _run(rider, world, seeds, episodes, watch, among)


def evaluate_yardstick(
    control: Callable[[Tensor], Tensor], world: World, seeds: Sequence[int], episodes: int
) -> list[list[Episode]]:
    """The same episodes with a controller that sees all: full states ``[N, k]`` to actions
    ``[N, m]``, physical units (``sims.base.Measured``)."""
    rider = _Memoryless(lambda state, observation: world.scaled(control(state)))
    return _run(rider, world, seeds, episodes, None, ())


class _Rider(Protocol):
    """Whoever acts in an episode."""

    def act(self, state: Tensor, observation: Tensor, /) -> Tensor:
        """The action ``[N, m]``, scaled, for full states ``[N, k]`` and observations ``[N, n]``."""
        ...

    def saw(self, transition: Transition) -> None:
        """Is told what happened in the tick."""
        ...


class _Memoryless:
    """Acts upon the moment."""

    def __init__(self, act: Callable[[Tensor, Tensor], Tensor]) -> None:
        self.act = act

    def saw(self, transition: Transition) -> None:
        """Forgets it."""


class _Observing:
    """Acts upon an estimate of the state."""

    def __init__(self, policy: Actor, parameters: Parameters, observer: Observer) -> None:
        self._policy = policy
        self._parameters = parameters
        self._observer = observer
        self._memory: Parameters | None = None

    def act(self, state: Tensor, observation: Tensor, /) -> Tensor:
        """See ``_Rider``; the first observation is that of the start."""
        if self._memory is None:
            self._memory = self._observer.initial(observation)
        now = self._observer.now(self._parameters, self._memory, observation)
        return self._policy.action(self._parameters, now)

    def saw(self, transition: Transition) -> None:
        """Goes on estimating."""
        assert self._memory is not None  # nothing happens before the first action
        self._memory = self._observer.follow(self._parameters, self._memory, transition)


def starts(world: World, seeds: Sequence[int], episodes: int, uniform: Tensor) -> Tensor:
    """Start states ``[S episodes, k]`` from uniforms ``[S episodes, u]``."""
    if not (isinstance(world.sim, Lasting) and world.sim.lasting):
        return world.initial(uniform)
    born = world.initial(learning_streams(world, seeds).at(0).uniform)
    born = born.repeat_interleave(episodes, dim=0)
    everybody = torch.ones(len(born), dtype=torch.bool, device=born.device)
    return world.restart(born, everybody, uniform)


def _run(
    rider: _Rider,
    world: World,
    seeds: Sequence[int],
    episodes: int,
    watch: Watch | None,
    among: Sequence[Episode],
) -> list[list[Episode]]:
    keys = [stream_key(s, Purpose.EVALUATION, e) for s in seeds for e in range(episodes)]
    streams = Streams(keys, world.uniforms, 0, world.dtype, world.device)
    finished: list[list[Episode]] = [[] for _ in seeds]
    with torch.inference_mode():
        start = state = starts(world, seeds, episodes, streams.at(0).uniform)
        observation = world.observe(state)
        active = torch.ones(len(keys), dtype=torch.bool, device=world.device)
        earned = torch.zeros(len(keys), dtype=torch.float64, device=world.device)
        clock = torch.zeros((), dtype=torch.int64, device=world.device)
        while bool(active.any()):
            clock += 1
            draw = streams.at(int(clock))
            action = world.clip(rider.act(state, observation))
            state = select(active, world.step(state, action, draw.uniform), state)
            if watch is not None:
                watch(state)
            before, observation = observation, world.observe(state, observation)
            applied, valid = world.applied(state, action), world.stepped(state, active)
            transition = Transition(before, applied, observation, world.seconds, valid)
            rider.saw(transition)
            earned = torch.where(active, world.earned(earned, state, transition), earned)
            outcome = world.outcome(state, clock, earned)
            ended = active & (outcome != int(Outcome.RUNNING))
            if bool(ended.any()):
                seconds = (clock.to(torch.float64) * world.dt).expand(len(keys))
                measures = world.sim.measures(start, state, seconds)
                success = world.success(state, outcome).tolist()
                for index in (ended & ~world.lost(state)).nonzero().flatten().tolist():
                    row, number = divmod(index, episodes)
                    finished[row].append(
                        Episode(
                            row=row,
                            number=number,
                            start=0.0,
                            seconds=float(seconds[index]),
                            outcome=Outcome(int(outcome[index])),
                            measures={k: float(m[index]) for k, m in measures.items()},
                            total_reward=float(earned[index]) if world.has_return else math.nan,
                            success=as_success(success[index]),
                        )
                    )
                active = active & ~ended
    for row in finished:
        row.sort(key=lambda e: e.number)
    everything = [*among, *(e for own in finished for e in own)]
    return [settled(own, everything) for own in finished]
