"""Events against balls, whose flights between bounces are parabolas."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from sims.rows import TORCH, Function, Namespace
from sims.tasks.events import events_over

GRAVITY = 9.81


def ball(xp: Namespace, back: float, substeps: int, events: int) -> Function:
    """Rows: height, speed up, seconds, bounces, each of which leaves ``back`` of the speed."""

    def move(s, h):
        return s[0] + h * s[1] - GRAVITY / 2 * h * h, s[1] - GRAVITY * h, s[2] + h, s[3]

    def land(s, guard):
        hit = guard > -0.5
        return (
            xp.where(hit, 0.0, s[0]),
            xp.where(hit, -back * s[1], s[1]),
            s[2],
            s[3] + xp.as_number(hit),
        )

    return events_over(
        xp,
        move,
        lambda s: (s[0], s[1]),
        land,
        width=4,
        guards=1,
        substeps=substeps,
        events=events,
    )


def thrown(height: Tensor, speed: Tensor) -> tuple[Tensor, ...]:
    return height, speed, torch.zeros_like(height), torch.zeros_like(height)


def test_a_ball_that_bounces() -> None:
    height = torch.linspace(0.01, 1.0, 30).double()
    speed, back, seconds = 0.3 * torch.ones(30).double(), 0.9, 0.7
    found = ball(TORCH, back, 7, 12)(thrown(height, speed), seconds)
    for k in range(30):
        h, v = float(height[k]), float(speed[k])
        now = (v + math.sqrt(v * v + 2 * GRAVITY * h)) / GRAVITY
        leaves, bounces = back * (GRAVITY * now - v), 1
        while now + 2 * leaves / GRAVITY < seconds:
            now, leaves, bounces = now + 2 * leaves / GRAVITY, back * leaves, bounces + 1
        flown = seconds - now
        assert bounces <= 12 and int(found[3][k]) == bounces
        expected = leaves * flown - GRAVITY / 2 * flown**2
        assert float(found[0][k]) == pytest.approx(expected, abs=1e-12)
        assert float(found[1][k]) == pytest.approx(leaves - GRAVITY * flown, abs=1e-11)


def test_time_advances_through_infinitely_many_bounces() -> None:
    # At rest after v (1 + back) / (1 - back) / g seconds and infinitely many bounces.
    s = thrown(torch.zeros(1).double(), -torch.ones(1).double())
    step = ball(TORCH, 0.5, 2, 3)
    for k in range(1, 101):
        s = step(s, 0.01)
        assert float(s[2]) == pytest.approx(0.01 * k, abs=1e-12)
        assert float(s[3]) <= 3 * k
    # What falls through in a last piece is put back within the next tick.
    assert -GRAVITY / 2 * 0.01**2 < float(s[0]) <= 0.01
    assert abs(float(s[1])) < 0.2


def test_one_without_an_event_is_the_motion_itself() -> None:
    s = thrown(torch.tensor([1.0, 2.0]).double(), torch.tensor([0.0, -1.0]).double())
    found = ball(TORCH, 0.0, 4, 3)(s, 0.1)
    torch.testing.assert_close(found[0], s[0] + 0.1 * s[1] - GRAVITY / 2 * 0.01, atol=1e-14, rtol=0)
    assert found[2].tolist() == pytest.approx([0.1, 0.1], abs=1e-15)


def test_the_derivative_through_an_event() -> None:
    # Height after a bounce by the height before, by autograd and by finite differences.
    height = torch.tensor([0.2], dtype=torch.float64, requires_grad=True)

    def after(height: Tensor) -> Tensor:
        return ball(TORCH, 0.6, 3, 2)(thrown(height, torch.zeros_like(height)), 0.3)[0]

    assert torch.autograd.gradcheck(after, height, eps=1e-6, atol=1e-6)
