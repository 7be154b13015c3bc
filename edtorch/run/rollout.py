"""The loop that steps worlds: for training, evaluation, recording and rivals.

They differ in where the actions come from (``edtorch.run.tick.Source``) and in what they do with
what is yielded.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Generic

from torch import Tensor

from edtorch.run.episodes import Episode
from edtorch.run.random import Draw
from edtorch.run.scaled_sim import World
from edtorch.run.success import as_success
from edtorch.run.tick import Experience, Memory, Population, Tick
from edtorch.types import Transition
from sims.base import Outcome


@dataclass(frozen=True)
class Happened(Generic[Memory]):
    """One tick.

    clock: its number; before, after: the worlds, no new episode begun yet; transition: scaled, not
    ``valid`` where nothing is to be learned from it; outcome ``[B]``: an ``Outcome``, RUNNING where
    no episode has ended; ended: whether any has; population: new episodes begun.
    """

    clock: int
    before: Experience
    after: Experience
    transition: Transition
    outcome: Tensor
    ended: bool
    population: Population[Memory]


def rollout(
    tick: Tick[Memory],
    population: Population[Memory],
    numbers: Callable[[int], Draw],
    *,
    clock: int = 0,
    ticks: int | None = None,
) -> Iterator[Happened[Memory]]:
    """Ticks ``clock + 1`` to ``clock + ticks``, or up to the one after which nobody is active.

    numbers: the random numbers of a tick; ticks: None for no limit.  To be consumed under
    ``torch.inference_mode``, or ``no_grad`` where a learner needs autograd.
    """
    now, last = clock, math.inf if ticks is None else clock + ticks
    anybody = bool(population.worlds.active.any())
    while now < last and anybody:
        now += 1
        draw, before = numbers(now), population.worlds
        improve = tick.schedule.improves(now)
        population, transition, outcome = tick.live(population, draw, now, improve=improve)
        after, ended = population.worlds, bool(outcome.any())
        if ended:
            population = tick.turn(population, outcome, draw, now)
            anybody = bool(population.worlds.active.any())
        yield Happened(now, before, after, transition, outcome, ended, population)


def finished(
    world: World, start: Tensor, final: Tensor, ticks: Tensor, outcome: Tensor, earned: Tensor
) -> list[Episode | None]:
    """An episode for each row that has ended, None for others and for those that were lost.

    start, final ``[E, k]``: the sim's states; ticks, outcome, earned ``[E]``.  ``row`` is that of
    the arguments, and ``success`` may be open (``edtorch.run.success.settled``).
    """
    seconds = ticks.to(final.dtype) * world.dt
    figures = {name: f.tolist() for name, f in world.sim.measures(start, final, seconds).items()}
    success, lost = world.success(final, outcome).tolist(), world.lost(final).tolist()
    lengths, ends, returns = seconds.tolist(), outcome.tolist(), earned.tolist()
    return [
        Episode(
            row=row,
            number=0,
            start=0.0,
            seconds=lengths[row],
            outcome=Outcome(end),
            measures={name: figure[row] for name, figure in figures.items()},
            total_reward=returns[row] if world.has_return else math.nan,
            success=as_success(success[row]),
        )
        if end != Outcome.RUNNING and not lost[row]
        else None
        for row, end in enumerate(ends)
    ]
