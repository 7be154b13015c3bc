"""Fresh episodes of finished policies: no exploration, no learning.

Where something lasts a learner's whole life (``sims.base.Lasting``), a policy is tried in the world
in which its seed learned.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import torch
from torch import Tensor

from edtorch.learner import Actor
from edtorch.records import Episode
from edtorch.streams import Purpose, Streams, learning_streams, stream_key
from edtorch.types import Parameters, select
from edtorch.world import World
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
) -> list[list[Episode]]:
    """Run ``episodes`` fresh episodes of each policy, without exploration and without learning.

    parameters: ``[S, ...]``, one policy per seed.  Returns the episodes of each policy, in order;
    episode e of a seed is the same whatever else is evaluated beside it.  watch: see ``Watch``.
    """
    expanded = {k: p.repeat_interleave(episodes, dim=0) for k, p in parameters.items()}

    def act(state: Tensor, observation: Tensor) -> Tensor:
        return policy.action(expanded, observation)

    return _run(act, world, seeds, episodes, watch)


def evaluate_yardstick(
    control: Callable[[Tensor], Tensor], world: World, seeds: Sequence[int], episodes: int
) -> list[list[Episode]]:
    """The same episodes with a controller that sees all: full states ``[N, k]`` to actions
    ``[N, m]``, physical units (``sims.base.Measured``)."""
    return _run(
        lambda state, observation: world.scaled(control(state)),
        world,
        seeds,
        episodes,
        None,
    )


def starts(world: World, seeds: Sequence[int], episodes: int, uniform: Tensor) -> Tensor:
    """Start states ``[S episodes, k]`` from uniforms ``[S episodes, u]``."""
    if not (isinstance(world.sim, Lasting) and world.sim.lasting):
        return world.initial(uniform)
    born = world.initial(learning_streams(world, seeds).at(0).uniform)
    born = born.repeat_interleave(episodes, dim=0)
    everybody = torch.ones(len(born), dtype=torch.bool, device=born.device)
    return world.restart(born, everybody, uniform)


def _run(
    act: Callable[[Tensor, Tensor], Tensor],
    world: World,
    seeds: Sequence[int],
    episodes: int,
    watch: Watch | None,
) -> list[list[Episode]]:
    keys = [stream_key(s, Purpose.EVALUATION, e) for s in seeds for e in range(episodes)]
    streams = Streams(keys, world.uniforms, 0, world.dtype, world.device)
    finished: list[list[Episode]] = [[] for _ in seeds]
    with torch.inference_mode():
        start = state = starts(world, seeds, episodes, streams.at(0).uniform)
        observation = world.observe(state)
        active = torch.ones(len(keys), dtype=torch.bool, device=world.device)
        clock = torch.zeros((), dtype=torch.int64, device=world.device)
        while bool(active.any()):
            clock += 1
            draw = streams.at(int(clock))
            action = world.clip(act(state, observation))
            state = select(active, world.step(state, action, draw.uniform), state)
            if watch is not None:
                watch(state)
            observation = world.observe(state, observation)
            outcome = world.outcome(state, clock)
            ended = active & (outcome != int(Outcome.RUNNING))
            if bool(ended.any()):
                seconds = (clock.to(torch.float64) * world.dt).expand(len(keys))
                measures = world.sim.measures(start, state, seconds)
                for index in ended.nonzero().flatten().tolist():
                    row, number = divmod(index, episodes)
                    finished[row].append(
                        Episode(
                            row=row,
                            number=number,
                            start=0.0,
                            seconds=float(seconds[index]),
                            outcome=Outcome(int(outcome[index])),
                            measures={k: float(m[index]) for k, m in measures.items()},
                        )
                    )
                active = active & ~ended
    for row in finished:
        row.sort(key=lambda e: e.number)
    return finished
