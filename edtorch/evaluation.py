"""Fresh episodes of finished policies: no exploration, no learning."""

from __future__ import annotations

from collections.abc import Sequence

import torch

from edtorch.policies import LinearPolicy
from edtorch.records import Episode
from edtorch.streams import Purpose, Streams, stream_key
from edtorch.types import Parameters, select
from edtorch.world import World
from sims.base import Outcome


def evaluate(
    policy: LinearPolicy,
    parameters: Parameters,
    world: World,
    seeds: Sequence[int],
    episodes: int,
) -> list[list[Episode]]:
    """Run ``episodes`` fresh episodes of each policy, without exploration and without learning.

    parameters: ``[S, ...]``, one policy per seed.  Returns the episodes of each policy, in order;
    episode e of a seed is the same whatever else is evaluated beside it.
    """
    keys = [stream_key(s, Purpose.EVALUATION, e) for s in seeds for e in range(episodes)]
    streams = Streams(keys, world.uniforms, 0, world.dtype, world.device)
    expanded = {k: p.repeat_interleave(episodes, dim=0) for k, p in parameters.items()}
    finished: list[list[Episode]] = [[] for _ in seeds]
    with torch.inference_mode():
        start = state = world.initial(streams.at(0).uniform)
        observation = world.observe(state)
        active = torch.ones(len(keys), dtype=torch.bool, device=world.device)
        clock = torch.zeros((), dtype=torch.int64, device=world.device)
        while bool(active.any()):
            clock += 1
            draw = streams.at(int(clock))
            action = world.clip(policy.action(expanded, observation))
            state = select(active, world.step(state, action, draw.uniform), state)
            observation = world.observe(state)
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
