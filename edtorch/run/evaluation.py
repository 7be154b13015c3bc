"""Fresh episodes of finished policies: no exploration, no learning.

Where something lasts a learner's whole life (``sims.base.Lasting``), a policy is tried in the world
in which its seed learned.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from functools import partial
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
    purpose: Purpose = Purpose.EVALUATION,
) -> list[list[Episode]]:
    """Run ``episodes`` fresh episodes of each policy, without exploration and without learning.

    parameters: ``[S, ...]``, one policy per seed.  Returns the episodes of each policy, in order;
    episode e of a seed is the same whatever else is evaluated beside it.  watch: see ``Watch``;
    observer: what the policies estimate the state with, None if they take what they observe for it;
    among: the other episodes of the run, see ``edtorch.run.success.settled``; purpose: of the
    random numbers.  Lost episodes are left out.
    """
    most = getattr(world.sim, "most_rows", None)
    at_once = episodes if most is None else max(1, most // len(seeds))
    finished: list[list[Episode]] = [[] for _ in seeds]
    for first in range(0, episodes, at_once):
        numbers = range(first, min(first + at_once, episodes))
        expanded = {k: p.repeat_interleave(len(numbers), dim=0) for k, p in parameters.items()}
        rider = _Memoryless(partial(_upon_observation, policy, expanded))
        if observer is not None:
            rider = _Observing(policy, expanded, observer)
        for own, more in zip(
            finished, _run(rider, world, seeds, numbers, watch, purpose), strict=True
        ):
            own += more
    return _settled(finished, among)


def _upon_observation(
    policy: Actor, parameters: Parameters, state: Tensor, observation: Tensor
) -> Tensor:
    return policy.action(parameters, observation)


def _settled(
    finished: Sequence[Sequence[Episode]], among: Sequence[Episode]
) -> list[list[Episode]]:
    everything = [*among, *(e for own in finished for e in own)]
    return [settled(own, everything) for own in finished]


def evaluate_yardstick(
    control: Callable[[Tensor], Tensor], world: World, seeds: Sequence[int], episodes: int
) -> list[list[Episode]]:
    """The same episodes with a controller that sees all: full states ``[N, k]`` to actions
    ``[N, m]``, physical units (``sims.base.Measured``)."""
    rider = _Memoryless(lambda state, observation: world.scaled(control(state)))
    return _settled(_run(rider, world, seeds, range(episodes), None, Purpose.EVALUATION), ())


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
    numbers: range,
    watch: Watch | None,
    purpose: Purpose,
) -> list[list[Episode]]:
    """The episodes ``numbers`` of each seed; whether they are a success may be open."""
    episodes = len(numbers)
    keys = [stream_key(s, purpose, e) for s in seeds for e in numbers]
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
                            number=numbers[number],
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
    return finished
