"""Where plans start."""

from __future__ import annotations

import numpy as np

from edtorch.model.lift import Lift
from edtorch.model.mechanism import Structure
from edtorch.model.terms import Terms
from edtorch.search.starts import lines, sinusoids
from tests.planning import HANGING, swing_up


def test_waves_are_slow_and_a_seeds_own() -> None:
    found = sinusoids(HANGING, 400, 2, 0.05, 50, np.random.default_rng(0))
    again = sinusoids(HANGING, 400, 2, 0.05, 50, np.random.default_rng(0))
    raw = np.stack([plan.raw for plan in found])
    assert (raw == np.stack([plan.raw for plan in again])).all()
    assert raw.shape == (50, 400, 2) and (found[0].state == HANGING).all()
    power = np.abs(np.fft.rfft(raw * np.hanning(400)[:, None], axis=1)) ** 2
    fast = np.fft.rfftfreq(400, 0.05) > 1.7
    assert power[:, fast].sum() < 1e-3 * power.sum()


def test_sizes_of_waves_are_drawn() -> None:
    """Variance: .09 E[exp(2 U(-2, .5))] times three sinusoids of variance 1/2."""
    found = sinusoids(HANGING, 200, 1, 0.1, 4000, np.random.default_rng(0))
    variance = np.mean([np.mean(plan.raw**2) for plan in found])
    expected = 0.09 * (np.exp(1.0) - np.exp(-4.0)) / (2 * 2.5) * 1.5
    assert abs(variance - expected) < 0.06 * expected


def test_lines_reach_the_goal_both_ways_and_rest_there() -> None:
    model, goal = swing_up(), np.array([0.3, 0.0, 0.0, 0.0])
    generator = np.random.default_rng(0)
    found = lines(model.structure, HANGING, goal, 40, 1, 0.1, generator)
    assert len(found) == 2
    ends = sorted(plan.state[-1, 2] for plan in found)
    np.testing.assert_allclose(ends, [0.0, 2 * np.pi], atol=1e-9)
    for plan in found:
        np.testing.assert_allclose(plan.state[0], HANGING)
        np.testing.assert_allclose(plan.state[31:, 3], 0.0, atol=1e-9)
        np.testing.assert_allclose(plan.state[30:, 0], 0.3)
        # Rates are those of their components: 3 m/s and 6 rad/s are 1.
        for i, rate, unit in ((0, 1, 3.0), (2, 3, 6.0)):
            moved = np.gradient(plan.state[:, i], 0.1) / unit
            np.testing.assert_allclose(plan.state[1:, rate], moved[1:], atol=1e-12)
        assert np.abs(np.diff(plan.state[:, 2], n=2)).max() > 1e-3


def test_without_waves_a_line_is_straight() -> None:
    model, generator = swing_up(), np.random.default_rng(0)
    for plan in lines(model.structure, HANGING, np.zeros(4), 40, 1, 0.1, generator, wave=0.0):
        np.testing.assert_allclose(np.diff(plan.state[:31, 2], n=2), 0.0, atol=1e-12)


def test_lines_that_turn_every_angle_the_same_way_come_first() -> None:
    """From about hanging, where the short way round is the one or the other by chance."""
    names = ("1", "sin p", "cos p", "sin q", "cos q", "u")
    lift = Lift(np.ones(2, bool), np.array([1, 3]), np.ones(2), 5, names)
    terms = Terms(np.array([[5]]), np.array([-1]))
    structure = Structure(lift, terms, np.arange(2), np.full(2, -1), np.zeros(2))
    start, generator = np.array([np.pi + 0.01, np.pi - 0.01]), np.random.default_rng(0)
    found = lines(structure, start, np.zeros(2), 40, 1, 0.1, generator)
    turned = np.array([plan.state[-1] - start for plan in found])
    assert (np.sign(turned) == [[-1, -1], [1, 1], [-1, 1], [1, -1]]).all()
    np.testing.assert_allclose(np.cos(start + turned), 1.0)
