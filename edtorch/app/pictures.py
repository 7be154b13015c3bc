"""The pictures of a run folder."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure
from torch import Tensor

from edtorch.report.animation import save_animation
from edtorch.report.figures import Ride, learning_curve, save_figure
from edtorch.report.reaching import reaching_curve
from edtorch.run.episodes import Episode
from edtorch.run.evaluation import evaluate
from edtorch.run.scaled_sim import World
from edtorch.run.training import Training
from sims.base import Pictured


@dataclass(frozen=True)
class _Shown:
    """The episode that is shown: its states ``[T, k]``, its length in seconds, its name."""

    states: Tensor
    seconds: float
    title: str


def last_ride(training: Training) -> Episode | None:
    """The ride that ended last; without any, the episode that ended last; of those watched."""
    watched = [e for e in training.episodes if e.row < training.trail.size]
    rides = [e for e in watched if e.is_ride] or watched
    return max(rides, key=lambda e: (e.start + e.seconds, -e.row)) if rides else None


def _shown(training: Training) -> _Shown | None:
    """The last ride or episode; the first learner's unfinished one where none has ended yet."""
    episode = last_ride(training)
    if episode is None:
        states = training.trail.states(0, 0, training.trail.position(0))
        title = f"seed {training.seeds[0]}, the first episode so far"
        seconds = training.seconds
    else:
        states = training.trail.states(episode.row, *episode.trail)
        seed, number = training.seeds[episode.row], episode.number + 1
        title = f"seed {seed}, episode {number}, after {episode.start:.0f} s of training"
        seconds = episode.seconds
    return _Shown(states, seconds, title) if len(states) > 1 else None


def _headline(training: Training, shown: _Shown) -> Ride:
    spec, sim = training.world.spec, training.world.sim
    index = [q.name for q in spec.state].index(spec.headline)
    values = sim.observe(shown.states)[:, index].numpy()
    step = training.trail.stride * spec.dt
    seconds = shown.seconds - step * np.arange(len(values))[::-1]
    quantity = spec.state[index]
    return Ride(seconds, values, quantity.name, quantity.unit, shown.title, quantity.period)


REACHES = 8
"""Tasks that an animation of reaching shows, one after the other."""


def draw_reaching(training: Training, calm: World, folder: Path, *, animate: bool) -> Figure:
    """For a domain with a goal: write ``learning_curve.png``, ``.svg`` as the paper's Figure 3 and,
    if the sim can draw itself, ``reach.webp``: the first policy at fresh tasks, in ``calm``."""
    size = len(training.seeds)
    name = training.world.spec.name
    title = f"{name}: {size} learner{'s' if size > 1 else ''}, at the end of every episode"
    figure = reaching_curve({name: (training.episodes, size)}, title)
    save_figure(figure, folder, "learning_curve")
    if animate and isinstance(calm.sim, Pictured):
        learner, states = training.learner, list[Tensor]()
        parameters = {k: p[:1] for k, p in learner.acting(training.learners).items()}
        evaluate(
            learner.policy,
            parameters,
            calm,
            training.seeds[:1],
            REACHES,
            watch=states.append,
            observer=learner.observer,
        )
        stride = max(1, round(0.1 / calm.dt))
        # [T, REACHES, k]: one task after the other.
        trail = torch.stack(states)[::stride].transpose(0, 1).flatten(0, 1)
        save_animation(calm.sim, trail, folder / "reach.webp", slow=len(trail), fps=10)
    return figure


def draw(training: Training, folder: Path, *, animate: bool) -> Figure:
    """Write ``learning_curve.png``, ``.svg`` and, if the sim can draw itself, ``ride.webp``."""
    shown = _shown(training)
    ride = _headline(training, shown) if shown is not None else None
    size = len(training.seeds)
    title = f"{training.world.spec.name}: {size} learner{'s' if size > 1 else ''}"
    figure = learning_curve(training.episodes, size, ride, title)
    save_figure(figure, folder, "learning_curve")
    sim = training.world.sim
    if animate and shown is not None and isinstance(sim, Pictured):
        save_animation(sim, shown.states, folder / "ride.webp")
    return figure
