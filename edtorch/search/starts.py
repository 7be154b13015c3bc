"""Starts of planning: sinusoidal raw actions, and straight lines through the state space."""

from __future__ import annotations

from itertools import product

import numpy as np
from torch import from_numpy

from edtorch.model.mechanism import Structure
from edtorch.search.plan import Plan

REST = 1.0
"""Seconds for which a goal is held at the end of a line."""


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
    rest: float = REST,
    wave: float = 0.3,
) -> list[Plan]:
    """Straight lines from a state to another ``[n]``, for multiple shooting.

    The goal is reached ``rest`` seconds before the end, and held.  One line for each choice of the
    directions in which the angles turn, those first that turn all of them the same way; with three
    sinusoids of ``wave`` rad in each angle.  Components whose derivative is another's value move at
    that rate; the rates follow from their components.
    """
    lift, n = structure.lift, len(start)
    turn = np.where(lift.angle, 2 * np.pi / lift.unit, 0.0)
    way = structure.difference(from_numpy(goal), from_numpy(start)).numpy()
    back = way - np.where(way > 0, turn, 0.0)
    seconds = dt * np.arange(ticks + 1)
    moving = max(dt, dt * ticks - rest)
    part = np.minimum(seconds / moving, 1.0)[:, None]
    plans = []
    choices = product((0.0, 1.0), repeat=int(lift.angle.sum()))
    for forward in sorted(choices, key=lambda choice: len(set(choice))):
        chosen = np.zeros(n)
        chosen[lift.angle] = forward
        state = start + part * (back + chosen * turn)
        waves = _waves(seconds, n, generator) * np.sin(np.pi * part)
        state += np.where(lift.angle, wave / lift.unit, 0.0) * waves
        for i in np.flatnonzero(structure.source >= 0):
            state[:, structure.source[i]] = np.gradient(state[:, i], dt) / structure.ratio[i]
        state[0] = start
        plans.append(Plan(state, np.zeros((ticks, actions)), np.zeros((ticks, actions, n)), np.inf))
    return plans


def _waves(seconds: np.ndarray, width: int, generator: np.random.Generator) -> np.ndarray:
    """Sums of three sinusoids ``[T, width]``."""
    amplitude = generator.standard_normal((3, width))
    frequency = generator.uniform(0.1, 1.5, (3, width))
    phase = generator.uniform(0.0, 2 * np.pi, (3, width))
    return (amplitude * np.sin(2 * np.pi * frequency * seconds[:, None, None] + phase)).sum(1)
