"""Values to follow, by component, as ``edtorch.learn`` takes them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch

import edtorch
from edtorch.app.references import following_reward
from edtorch.rewards import LiftedReward
from sims.tasks.cart_pole_swing_up import CartPoleSwingUp
from sims.tasks.pendulum_swing_up import PendulumSwingUp
from tests.api_envs import Cart
from tests.systems import normal

SMALL = ("search.starts=4", "search.keep=3", "search.draws=20", "eval.episodes=5")


def test_it_is_the_squared_distance_from_what_is_wanted_at_each_tick() -> None:
    sim = CartPoleSwingUp()
    spec, dt = sim.spec, sim.spec.dt
    node = following_reward(
        sim,
        {"angle": lambda seconds: 3 * seconds, "position": np.array([0.5, 1.0])},
        {"speed": 0.25},
        {"angle": 7.0},
    )
    assert node.pop("_target_") == "edtorch.rewards.LiftedReward"
    reward = LiftedReward(spec, **node)
    R, weights = reward.lifted_squares(40)
    state = normal(torch.Generator().manual_seed(0), 41, 4)
    scale = torch.tensor([q.scale for q in spec.state], dtype=torch.float64)
    found = torch.stack(
        [
            (R[t] @ reward.lift(state[t] / scale, state.new_zeros(1))).square().sum()
            for t in range(41)
        ]
    )
    x, v, angle, rate = state.unbind(-1)
    tick = torch.arange(41)
    # A chord of a circle: 2 sin of half the angle.
    chord = 2 * torch.sin((angle - 3 * dt * tick) / 2)
    expected = (x - torch.where(tick == 0, 0.5, 1.0)).square() + 7 * chord.square()
    expected += ((v - 0.25) / 3).square() + 0.01 * (rate / 6).square()
    assert torch.allclose(found, expected, atol=1e-12)
    assert weights.tolist() == [0.01]


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"reference": {"tip": [1.0]}}, "reference.tip: expected one of angle, rate"),
        ({"reference": {"angle": "sine"}}, "reference.angle: expected a function of seconds"),
        ({"reference": {"angle": [math.nan]}}, r"reference.angle=\[nan\]: expected a function"),
        ({"reference": {"angle": []}}, r"reference.angle=\[\]: expected a function"),
        ({"reference": {"angle": lambda: 1.0}}, "reference.angle: expected a function .*TypeError"),
        ({"reference": [1.0]}, "expected {NAME: a function of seconds, or values, ...}"),
        (
            {"reference": {"angle": [1.0]}, "target": {"angle": 0.0}},
            "target.angle=0.0: expected none beside its reference",
        ),
        (
            {"reference": {"angle": [1.0]}, "weights": {"torque": 1.0}},
            "weights.torque=1.0: expected one of angle, rate with a reference",
        ),
        ({"trial": 3.0, "time_limit": 4.0}, "trial=3.0, time_limit=4.0: expected one of the two"),
        ({"trial": 3.0}, "time_limit=3.0: expected none with a Sim, whose spec says it"),
        ({"random": -1.0}, "random=-1.0: expected a number > 0, or null"),
        ({"horizon": 2.0}, "horizon=2: expected the length of a trial, 4 s, with policy=timed"),
        (
            {
                "target": {"angle": 0.0},
                "weights": {"torque": 0.0},
                "overrides": ["search.policy=stationary"],
            },
            "policy=stationary: expected a reward in which every action has a weight > 0",
        ),
        ({"horizon": "long"}, "horizon='long': expected a number of seconds"),
    ],
)
def test_bad_arguments_are_refused_in_one_line(arguments: dict[str, Any], words: str) -> None:
    preset = "tracking" if "reference" in arguments else "swingup"
    with pytest.raises(ValueError, match=words) as caught:
        edtorch.learn(PendulumSwingUp(), preset=preset, progress=False, **arguments)
    assert "\n" not in str(caught.value)


@pytest.mark.experiment
@pytest.mark.parametrize("policy", ["timed", "stationary"])
def test_a_simulator_of_ones_own_is_swung_up(policy: str) -> None:
    run = edtorch.learn(
        PendulumSwingUp(),
        preset="swingup",
        target={"angle": 0.0},
        random=2.0,
        overrides=[*SMALL, f"search.policy={policy}"],
        progress=False,
    )
    assert run.episodes[0]["seconds"] == pytest.approx(2)
    assert run.summary["seconds_to_solved"]["max"] <= 10
    assert run.policies[0].remembers is (policy == "timed")


@pytest.mark.experiment
def test_an_environment_follows_a_wave() -> None:
    """A mass that starts anywhere is on the wave after two seconds, and stays there."""

    def wave(seconds: float) -> float:
        return 0.3 * math.sin(math.pi / 2 * seconds)

    run = edtorch.learn(
        Cart,
        preset="tracking",
        names=["place", "speed"],
        rates={"speed": "place"},
        dt=0.1,
        trial=4.0,
        random=1.0,
        reference={"place": wave},
        episodes=2,
        overrides=[*SMALL, "search.abort=null"],
        progress=False,
    )
    env, policy = Cart(), run.policy
    reading, _ = env.reset(seed=2)
    errors = [reading[0]]
    for tick in range(1, 40):
        reading, *_ = env.step(policy.predict(reading).astype(np.float32))
        errors.append(reading[0] - wave(0.1 * tick))
    assert np.abs(errors[20:]).max() < 0.05 < abs(errors[0])
