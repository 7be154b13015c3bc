"""The pictures of a ride: size, that they show what happens, and that they are quick."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from torch import Tensor

from sims.base import Pictured
from sims.bicycle import Bicycle

RIDER = (slice(10, 195), slice(326, 470))
"""Rows and columns of the rider from behind, labels apart."""


def ride(steps: int = 120) -> Tensor:
    sim = Bicycle(start_heading_low=0.0, start_heading_high=0.0)
    states = [sim.initial(torch.zeros(1).double())]
    for _ in range(steps):
        action = torch.tensor([0.1, 0.01]).double()
        states.append(sim.step(states[-1], action, torch.full((1,), 0.5).double()))
    return torch.stack(states)


def leaning(omega: float, theta: float = 0.0) -> Tensor:
    trail = ride(0)
    trail[-1, 2], trail[-1, 0] = omega, theta
    return trail


def test_is_an_rgb_picture_of_any_trail() -> None:
    sim = Bicycle()
    assert isinstance(sim, Pictured)
    full = ride()
    for trail in (full[:1], full[:2], full, full[::4], full.float()):
        picture = sim.frame(trail)
        assert picture.shape == (270, 480, 3) and picture.dtype == np.uint8


def test_shows_what_happens() -> None:
    sim, trail = Bicycle(), ride()
    assert not np.array_equal(sim.frame(trail[:50]), sim.frame(trail))
    assert np.array_equal(sim.frame(trail), sim.frame(trail))
    at_goal = trail + 0
    at_goal[:, [6, 8]] += 985
    assert not np.array_equal(sim.frame(trail), sim.frame(at_goal))


def test_leaning_left_mirrors_leaning_right() -> None:
    sim = Bicycle()
    left, right, upright = (sim.frame(leaning(lean))[RIDER] for lean in (0.2, -0.2, 0.0))
    ink = [np.argwhere(picture.sum(-1) < 300)[:, 1].mean() for picture in (left, right, upright)]
    assert ink[0] < ink[2] - 3 < ink[2] + 3 < ink[1]
    # The legs are not alike, all the rest is.
    assert np.mean(np.abs(left[:, ::-1].astype(float) - right)) < 0.3 * np.mean(
        np.abs(left.astype(float) - right)
    )


def test_handlebar_and_displacement_show() -> None:
    sim = Bicycle()
    straight, turned = sim.frame(leaning(0.0)), sim.frame(leaning(0.0, 0.6))
    assert not np.array_equal(straight[RIDER], turned[RIDER])
    trail = ride(30)
    hanging = sim.frame(trail)[RIDER]
    # The same last state without the steps before it says nothing of where the rider hangs.
    assert not np.array_equal(hanging, sim.frame(trail[-1:])[RIDER])


def test_a_state_out_of_numbers() -> None:
    trail = ride(10)
    broken = trail.clone()
    broken[-1, 2] = math.nan
    assert np.array_equal(Bicycle().frame(broken), Bicycle().frame(trail[:-1]))
    with pytest.raises(ValueError, match="trail"):
        Bicycle().frame(broken[-1:])
