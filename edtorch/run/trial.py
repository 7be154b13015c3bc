"""One trial of each member of a population: an episode, or a part of one, with all its readings."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import torch
from torch import Tensor

from edtorch.run.episodes import Episode
from edtorch.run.evaluation import starts
from edtorch.run.random import Purpose, Streams, stream_key
from edtorch.run.rollout import finished, rollout
from edtorch.run.scaled_sim import World
from edtorch.run.tick import Source, Tick
from edtorch.search.problem import Left
from sims.base import Outcome

_RUN = 16
"""Bits of the number of a trial: there are fewer than 2^16."""


@dataclass(frozen=True)
class Trial:
    """What a trial gave: readings ``[T + 1, n]`` and actions as applied ``[T, m]``, scaled; valid
    ``[T]``: whether a step is one to learn from; ``episode``: what it was; ``whole``: whether it
    went to its end."""

    readings: Tensor
    actions: Tensor
    valid: Tensor
    episode: Episode
    whole: bool


def run_trials(
    source: Source[Any],
    world: World,
    seeds: Sequence[int],
    number: int,
    ticks: int,
    left: Left | None = None,
    runs: int = 1,
) -> list[Trial | None]:
    """The trial ``number`` of each seed, at most ``ticks`` long, side by side; None where the
    simulator lost it.  With several ``runs``, those of a seed follow each other.

    A trial that is given up ends with that tick.  (Its row of the simulation goes on for as long as
    others do; nothing of that is counted or kept.)  Random numbers are those of (seed, number) and
    the run.
    """
    m = len(world.spec.action)
    places = [number + (run << _RUN) for run in range(runs)]
    keys = [stream_key(seed, Purpose.TRIAL, place) for seed in seeds for place in places]
    seeds = [seed for seed in seeds for _ in places]
    streams = Streams(keys, world.uniforms, m, world.dtype, world.device)
    size = len(seeds)
    length = torch.full((size,), ticks)
    outcome = torch.full((size,), int(Outcome.RUNNING))
    given_up = torch.zeros(size, dtype=torch.bool)
    over = torch.zeros(size, dtype=torch.bool)
    readings, actions, valid = [], [], []
    with torch.inference_mode():
        start = starts(world, seeds, 1, streams.at(0).uniform)
        tick = Tick(source, world, most_episodes=1)
        population = tick.first({}, start)
        final, earned = start.clone(), population.worlds.earned.clone()
        readings.append(population.worlds.observation)
        for happened in rollout(tick, population, streams.at, ticks=ticks):
            after, now = happened.after, happened.clock
            readings.append(after.observation)
            actions.append(happened.transition.action)
            valid.append(happened.transition.valid)
            leaves = torch.zeros_like(over)
            if left is not None and now < ticks:
                leaves = left(now, after.observation) & (happened.outcome == int(Outcome.RUNNING))
            ends = ~over & (leaves | (happened.outcome != int(Outcome.RUNNING)) | (now == ticks))
            final[ends], earned[ends] = after.world[ends], after.earned[ends]
            length[ends], outcome[ends] = now, happened.outcome[ends]
            given_up |= ends & leaves
            over |= ends
            if bool(over.all()):
                break
    cut = outcome == int(Outcome.RUNNING)
    closed = torch.where(cut, int(Outcome.TIMED_OUT), outcome)
    episodes = finished(world, start, final, length, closed, earned)
    table = torch.stack(readings), torch.stack(actions), torch.stack(valid)
    found: list[Trial | None] = []
    for row in range(size):
        episode, T = episodes[row], int(length[row])
        if episode is None:
            found.append(None)
            continue
        if bool(cut[row]):
            episode = replace(episode, success=False)
        found.append(
            Trial(
                readings=table[0][: T + 1, row].clone(),
                actions=table[1][:T, row].clone(),
                valid=table[2][:T, row].clone(),
                episode=episode,
                whole=not bool(given_up[row]),
            )
        )
    return found


def look_at_starts(world: World, seed: int, count: int) -> Tensor:
    """Readings ``[count, n]``, scaled, of the starts of episodes that are not run."""
    keys = [stream_key(seed, Purpose.STARTS, k) for k in range(count)]
    uniform = Streams(keys, world.uniforms, 0, world.dtype, world.device).at(0).uniform
    return world.observe(world.initial(uniform))
