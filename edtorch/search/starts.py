"""Where planning starts: raw actions that swing, and straight lines through the state space."""

from __future__ import annotations

from itertools import product

import numpy as np

from edtorch.model.mechanism import Structure
from edtorch.search.plan import Plan


def still(start: np.ndarray, raw: np.ndarray) -> Plan:
    """Raw actions ``[H, m]`` from a state ``[n]``, without gains; the states are not computed."""
    ticks, n = len(raw), len(start)
    return Plan(np.tile(start, (ticks + 1, 1)), raw, np.zeros((*raw.shape, n)), np.inf)


def sinusoids(
    start: np.ndarray,
    ticks: int,
    actions: int,
    dt: float,
    count: int,
    generator: np.random.Generator,
) -> list[Plan]:
    """``count`` starts from the state ``[n]`` whose raw actions are slow waves.

    .3 exp(U(-2, .5)) times the sum of three sinusoids with amplitudes N(0, 1), frequencies
    U(.1, 1.5) Hz and any phase, for each action.
    """
    seconds = dt * np.arange(ticks)
    plans = []
    for _ in range(count):
        size = 0.3 * np.exp(generator.uniform(-2.0, 0.5, actions))
        waves = _waves(seconds, actions, generator)
        plans.append(still(start, size * waves))
    return plans


def lines(
    structure: Structure,
    start: np.ndarray,
    goal: np.ndarray,
    ticks: int,
    actions: int,
    dt: float,
    generator: np.random.Generator,
    rest: float = 1.0,
    wave: float = 0.3,
) -> list[Plan]:
    """Straight lines from a state to another ``[n]``, for multiple shooting.

    The goal is reached ``rest`` seconds before the end, and held.  One line for each choice of
    direction of the angles: the short way round to the goal, or the other; with three sinusoids of
    ``wave`` rad in each angle.  Components whose derivative is another's value move at that rate;
    the rates follow from their components.
    """
    lift, n = structure.lift, len(start)
    turn = np.where(lift.angle, 2 * np.pi / lift.unit, 0.0)
    way = goal - start
    way[lift.angle] -= (turn * np.rint(way / np.where(lift.angle, turn, 1.0)))[lift.angle]
    other = np.where(lift.angle, way - np.where(way > 0, turn, -turn), way)
    seconds = dt * np.arange(ticks + 1)
    moving = max(dt, dt * ticks - rest)
    part = np.minimum(seconds / moving, 1.0)[:, None]
    plans = []
    for round_ in product((False, True), repeat=int(lift.angle.sum())):
        chosen = np.zeros(n, bool)
        chosen[lift.angle] = round_
        state = start + part * np.where(chosen, other, way)
        fading = np.sin(np.pi * part)
        waves = _waves(seconds, n, generator)
        state += np.where(lift.angle, wave / lift.unit, 0.0) * waves * fading
        for i in np.flatnonzero(structure.source >= 0):
            rate = np.gradient(state[:, i], dt) / structure.ratio[i]
            state[:, structure.source[i]] = rate
        state[0] = start
        raw = np.zeros((ticks, actions))
        plans.append(Plan(state, raw, np.zeros((ticks, actions, n)), np.inf))
    return plans


def _waves(seconds: np.ndarray, width: int, generator: np.random.Generator) -> np.ndarray:
    """Sums of three sinusoids ``[T, width]``."""
    amplitude = generator.standard_normal((3, width))
    frequency = generator.uniform(0.1, 1.5, (3, width))
    phase = generator.uniform(0.0, 2 * np.pi, (3, width))
    return (amplitude * np.sin(2 * np.pi * frequency * seconds[:, None, None] + phase)).sum(1)
