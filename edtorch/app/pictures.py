"""The pictures of a run folder."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from matplotlib.figure import Figure
from torch import Tensor

from edtorch.learner.learner import Actor
from edtorch.native.choice import Mode
from edtorch.native.evaluation import evaluate_policies
from edtorch.policy.memory import EpisodeMemory
from edtorch.report.animation import save_animation
from edtorch.report.domain import Domain
from edtorch.report.experience import SeedExperience, experience_curve
from edtorch.report.figures import Trace, height, learning_curve, save_figure, shortest_time
from edtorch.report.task_curve import task_curve
from edtorch.run.episodes import Episode
from edtorch.run.evaluation import evaluate
from edtorch.run.scaled_sim import World
from edtorch.run.training import Training
from edtorch.types import Parameters
from sims.base import Pictured


@dataclass(frozen=True)
class _Shown:
    """The episode that is shown: its states ``[T, k]``, its length in seconds, its name."""

    states: Tensor
    seconds: float
    title: str


def last_success(training: Training) -> Episode | None:
    """The success that ended last; without any, the episode that ended last; of those watched."""
    watched = [e for e in training.episodes if e.row < training.trail.size]
    some = [e for e in watched if e.success] or watched
    return max(some, key=lambda e: (e.start + e.seconds, -e.row)) if some else None


def _shown(training: Training) -> _Shown | None:
    """The last success, or episode; the first learner's unfinished one where none has ended yet."""
    episode = last_success(training)
    if episode is None:
        states = training.trail.states(0, 0, training.trail.position(0))
        title = f"seed {training.seeds[0]}, the first episode so far"
        seconds = training.seconds
    else:
        states = training.path(episode)
        seed, number = training.seeds[episode.row], episode.number + 1
        title = f"seed {seed}, episode {number}, after {episode.start:.0f} s of training"
        seconds = episode.seconds
    return _Shown(states, seconds, title) if len(states) > 1 else None


def _headline(training: Training, shown: _Shown) -> Trace:
    spec, sim = training.world.spec, training.world.sim
    index = [q.name for q in spec.state].index(spec.headline)
    values = sim.observe(shown.states)[:, index].numpy()
    step = training.trail.stride * spec.dt
    seconds = shown.seconds - step * np.arange(len(values))[::-1]
    quantity = spec.state[index]
    return Trace(seconds, values, quantity.name, quantity.unit, shown.title, quantity.period)


TASKS = 8
"""So many an animation shows, one after the other."""
SHOWN, MOST_FRAMES = 10.0, 20
"""Seconds of an episode in an animation, and frames in each of them at most."""


def draw_tasks(
    training: Training, domain: Domain, calm: World, folder: Path, *, animate: bool
) -> Figure:
    """For a family of tasks: write ``learning_curve.png``, ``.svg`` as the paper's Figure 3 and,
    if the sim can draw itself, an animation of the first policy at fresh tasks, in ``calm``."""
    size = len(training.seeds)
    name = training.world.spec.name
    title = f"{name}: {size} learner{'s' if size > 1 else ''}, at the end of every episode"
    figure = task_curve({name: (training.episodes, size)}, domain, title)
    save_figure(figure, folder, "learning_curve")
    if animate and isinstance(calm.sim, Pictured):
        learner, states = training.learner, list[Tensor]()
        parameters = {k: p[:1] for k, p in learner.acting(training.learners).items()}
        evaluate(
            learner.policy,
            parameters,
            calm,
            training.seeds[:1],
            TASKS,
            watch=states.append,
            observer=learner.observer,
        )
        _animate(calm.sim, torch.stack(states), calm.dt, 10, folder / _animation(domain))
    return figure


def draw_search(
    experience: Sequence[SeedExperience], wanted: float | None, name: str, folder: Path
) -> Figure:
    """For a search between trials: write ``learning_curve.png``, ``.svg``, success against
    experience; wanted: the rate that counts as solved; name: of the domain."""
    size = len(experience)
    title = f"{name}: {size} seed{'s' if size > 1 else ''}"
    figure = experience_curve(experience, wanted, title)
    save_figure(figure, folder, "learning_curve")
    return figure


def draw_policy(
    actor: Actor,
    parameters: Parameters,
    calm: World,
    seeds: Sequence[int],
    domain: Domain,
    folder: Path,
    observer: EpisodeMemory | None,
    native: Mode,
) -> None:
    """If the sim can draw itself, write an animation of one policy ``[1, ...]`` in a fresh episode
    in ``calm``, of its first ``SHOWN`` seconds in real time."""
    if not isinstance(calm.sim, Pictured):
        return
    states: list[Tensor] = []
    evaluate_policies(
        *(actor, parameters, calm, seeds, 1),
        native=native,
        watch=states.append,
        observer=observer,
        ticks=round(SHOWN / calm.dt),
    )
    path = folder / _animation(domain)
    _animate(calm.sim, torch.stack(states), calm.dt, MOST_FRAMES, path)


def _animate(sim: Pictured, states: Tensor, dt: float, frames: int, path: Path) -> None:
    """Write an animation in real time of episodes ``[T, B, k]``, ``dt`` s a tick, one after the
    other, with at most so many frames a second."""
    stride = max(1, round(1 / (frames * dt)))
    trail = states[::stride].transpose(0, 1).flatten(0, 1)
    save_animation(sim, trail, path, slow=len(trail), fps=round(1 / (stride * dt)))


def _animation(domain: Domain) -> str:
    """File of an animation: ``ride.webp``, ``reach.webp``."""
    return f"{domain.words.success}.webp"


def draw(training: Training, domain: Domain, folder: Path, *, animate: bool) -> Figure:
    """Write ``learning_curve.png``, ``.svg`` and, if the sim can draw itself, an animation of the
    last success."""
    shown = _shown(training)
    trace = _headline(training, shown) if shown is not None else None
    size = len(training.seeds)
    title = f"{training.world.spec.name}: {size} learner{'s' if size > 1 else ''}"
    episodes = training.episodes
    shortest = shortest_time(episodes, training.world.spec.shortest)
    what = height(domain, shortest, episodes)
    figure = learning_curve(episodes, size, domain, what, trace, title)
    save_figure(figure, folder, "learning_curve")
    sim = training.world.sim
    if animate and shown is not None and isinstance(sim, Pictured):
        save_animation(sim, shown.states, folder / _animation(domain))
    return figure
