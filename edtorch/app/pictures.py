"""The pictures of a run folder."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from edtorch.interact import Episode, Training
from edtorch.report.animation import save_animation
from edtorch.report.figures import Ride, learning_curve, save_figure
from sims.base import Pictured


def last_ride(training: Training) -> Episode | None:
    """The ride that ended last; without any, the episode that ended last."""
    rides = [e for e in training.episodes if e.is_ride] or training.episodes
    return max(rides, key=lambda e: (e.start + e.seconds, -e.row)) if rides else None


def _headline(training: Training, episode: Episode) -> Ride:
    spec, sim = training.world.spec, training.world.sim
    index = [q.name for q in spec.state].index(spec.headline)
    states = training.trail.states(episode.row, *episode.trail)
    values = sim.observe(states)[:, index].numpy()
    step = training.trail.stride * spec.dt
    seconds = episode.seconds - step * np.arange(len(values))[::-1]
    seed = training.seeds[episode.row]
    title = f"seed {seed}, episode {episode.number + 1}, after {episode.start:.0f} s of training"
    return Ride(seconds, values, spec.headline, spec.state[index].unit, title)


def draw(training: Training, folder: Path, *, animate: bool) -> Figure:
    """Write ``learning_curve.png``, ``.svg`` and, if the sim can draw itself, ``ride.webp``."""
    episode = last_ride(training)
    has_trail = episode is not None and episode.trail[1] - episode.trail[0] > 1
    ride = _headline(training, episode) if episode is not None and has_trail else None
    title = f"{training.world.spec.name}: {len(training.seeds)} learners"
    figure = learning_curve(training.episodes, len(training.seeds), ride, title)
    save_figure(figure, folder, "learning_curve")
    sim = training.world.sim
    if animate and episode is not None and has_trail and isinstance(sim, Pictured):
        states = training.trail.states(episode.row, *episode.trail)
        save_animation(sim, states, folder / "ride.webp")
    return figure
