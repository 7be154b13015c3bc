"""Cardea: physics against PyBullet's own matrices, balance, endings, goals, baselines."""

from __future__ import annotations

import itertools
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

pytest.importorskip("pybullet", reason="the extra [cardea] is not installed: no PyBullet")


from sims.base import Actuated, Invertible, Jointed, Outcome, Pictured
from sims.cardea import LIMITS, STOPS, Cardea, Trouble, slant, wrist
from sims.cardea.arm import HIGH, LOW, level_angles
from sims.cardea.baselines import YARDSTICKS
from sims.cardea.env import CardeaEnv
from sims.cardea.physics import MAY_TOUCH, URDF, Robot
from sims.conformance import check

CALM = torch.full((5,), 0.5).double()
"""Uniform numbers of a step without noise."""

NEUTRAL = (0.3, 0.5, -0.8, 0.3, 0.0)


def random_state(generator: np.random.Generator) -> list[float]:
    rates = generator.normal(size=7) * [2, 2, 2, 3, 3, 0.3, 0.3]
    return [*generator.uniform(LOW, HIGH).tolist(), 0.05, 0.2, *rates.tolist()]


def uniforms(*shape: int, seed: int = 0) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return torch.rand(*shape, generator=generator, dtype=torch.float64)


# The physics.


def test_accelerations_are_those_of_the_equations_of_motion() -> None:
    """M ddq + h = f, with PyBullet's own M and h, which its steps do not use."""
    dt, generator = 1e-5, np.random.default_rng(1)
    robot = Robot(dt)
    for _ in range(10):
        state = random_state(generator)
        torques = (generator.uniform(-1, 1, 5) * LIMITS).tolist()
        robot.put(state)
        robot.advance(torques, 1)
        acceleration = (np.array(robot.read()) - state)[7:] / dt
        wheel = robot.wheel_torque(state[6], state[5], state[13], state[12])
        forces = np.array([*torques, -wheel, wheel / 0.24]) - robot.bias(state)
        expected = np.linalg.solve(robot.mass_matrix(state), forces)
        np.testing.assert_allclose(acceleration, expected, rtol=0, atol=1e-8)
        given_back = robot.inverse_dynamics(state, acceleration[:5])
        np.testing.assert_allclose(given_back, torques, rtol=0, atol=1e-8)
    robot.close()


def test_energy_drift_is_of_first_order(tmp_path: Path) -> None:
    """Without damping, balance and torques, what is lost is the integrator's: half the step, half
    the loss."""
    text = URDF.read_text(encoding="utf-8")
    free = tmp_path / "free.urdf"
    free.write_text(re.sub('damping="[^"]*"', 'damping="0"', text), encoding="utf-8")
    state = [0.3, 0.2, -0.8, 0.5, 0.3, 0.02, 0.0, 1.0, -1.0, 2.0, 1.0, 1.0, 0.1, 0.1]
    drifts = []
    for dt in (0.004, 0.002, 0.001):
        robot = Robot(dt, urdf=free, balance=False)
        before = robot.energy(state)
        robot.put(state)
        robot.advance([0.0] * 5, round(0.3 / dt))
        drifts.append(abs(robot.energy(robot.read()) - before))
        robot.close()
    assert drifts[0] < 0.15  # J, of some 10 J in motion
    for coarse, fine in itertools.pairwise(drifts):
        assert fine == pytest.approx(coarse / 2, rel=0.05)


@pytest.mark.oracle
@pytest.mark.parametrize("mode", ["held", "moving", "passive"])
def test_balances_for_a_minute(mode: str) -> None:
    """The Segway's controller keeps the robot up whatever the arm does; 60 s."""
    robot = Robot()
    state, most = [*NEUTRAL, *[0.0] * 9], 0.0
    limits = np.array(LIMITS)
    for k in range(3000):
        torques = np.zeros(5)
        if mode != "passive":
            swing = 0.4 * np.sin(0.02 * k * np.array([1, 1.3, 1.7, 2, 1])) * (mode == "moving")
            error = np.array(NEUTRAL) + swing - state[:5]
            wanted = 100 * error - 20 * np.array(state[7:12])
            torques = np.clip(robot.inverse_dynamics(state, wanted), -limits, limits)
        state = robot.step(state, torques.tolist(), 5)[:14]
        most = max(most, abs(state[5]))
    # A passive arm starts by falling from its pose.
    assert most < (0.06 if mode == "passive" else 0.04)
    assert abs(state[6]) < 0.4
    robot.close()


def test_a_step_is_a_function_of_the_state() -> None:
    """Whatever the world did before, to the last digit."""
    robot, generator = Robot(), np.random.default_rng(0)
    states = [random_state(generator) for _ in range(6)]
    torques = [(generator.uniform(-1, 1, 5) * LIMITS).tolist() for _ in range(6)]
    first = [robot.step(s, u, 5) for s, u in zip(states, torques, strict=True)]
    again = [robot.step(states[k], torques[k], 5) for k in (3, 0, 5, 1, 1, 4, 2)]
    assert again == [first[k] for k in (3, 0, 5, 1, 1, 4, 2)]
    robot.close()


def test_the_file_says_what_the_robot_weighs() -> None:
    text = URDF.read_text(encoding="utf-8")
    masses = [float(mass) for mass in re.findall(r'mass value="([^"]*)"', text)]
    # Without the ground's 1 kg, and 5 kg that stand for the spin of the wheels: 200 lb.
    assert sum(masses) - 1 - 5 == pytest.approx(200 * 0.4536, abs=0.5)
    efforts = re.findall(r'limit lower="([^"]*)" upper="([^"]*)" effort="([^"]*)"', text)[2:]
    assert [float(upper) for _, upper, _ in efforts] == list(STOPS)
    assert [float(lower) for lower, _, _ in efforts] == [-stop for stop in STOPS]
    assert [float(effort) for _, _, effort in efforts] == list(LIMITS)
    assert ("hand", "forearm") not in MAY_TOUCH


# The domain.


def test_conforms() -> None:
    cardea = Cardea()
    check(cardea)
    assert isinstance(cardea, Actuated) and isinstance(cardea, Invertible)
    assert isinstance(cardea, Jointed) and isinstance(cardea, Pictured)
    assert len(cardea.spec.state) == 19 and len(cardea.spec.goal) == 5
    assert cardea.spec.goal[2] == "goal_elbow" and cardea.spec.tracked[2] == "elbow"


def test_starts_and_goals_are_clear_and_reachable() -> None:
    cardea = Cardea()
    draws = uniforms(40, 2)
    state = cardea.initial(draws)
    robot = Robot()
    for row in state:
        start, goal = row[:5], row[14:19]
        for angles in (start, goal):
            assert (angles >= torch.tensor(LOW)).all() and (angles <= torch.tensor(HIGH)).all()
            assert robot.clear(angles.tolist(), 0.03)
        position = wrist(goal)
        assert position[0] >= 0.12 and position[2].abs() <= 0.45 and position.norm() <= 0.55
        assert slant(goal) < 1e-12
    # Start and goal have a seed each.
    same_goal = cardea.initial(torch.stack((draws[1:, 0], draws[:-1, 1]), -1))
    assert torch.equal(same_goal[:, :5], state[1:, :5])
    assert torch.equal(same_goal[:, 14:19], state[:-1, 14:19])
    robot.close()


def test_torques_are_noisy_and_clipped() -> None:
    cardea, limits = Cardea(), torch.tensor(LIMITS).double()
    state = cardea.initial(uniforms(300, 2, seed=1))
    zero = torch.zeros(300, 5).double()
    noise = cardea.applied(cardea.step(state, zero, uniforms(300, 5, seed=2))) / limits
    assert noise.std(0).tolist() == pytest.approx([0.02] * 5, rel=0.15)
    assert noise.mean(0).abs().max() < 0.005
    most = cardea.applied(cardea.step(state, zero + 1e6, uniforms(300, 5)))
    assert torch.equal(most, limits.expand(300, 5))
    # The least uniform number there is gives a number.
    assert cardea.step(state, zero, torch.zeros(300, 5).double()).isfinite().all()
    exact = Cardea(torque_noise=0.0)
    given = 0.1 * limits.expand(300, 5)
    assert torch.equal(exact.applied(exact.step(state, given, uniforms(300, 5))), given)


@pytest.mark.parametrize(
    ("component", "value"), [(1, 2.41), (2, -2.71), (5, 0.51), (25, 1.0), (3, math.nan)]
)
def test_failures(component: int, value: float) -> None:
    cardea = Cardea()
    state = cardea.at_rest(torch.tensor(NEUTRAL), torch.tensor(NEUTRAL))
    assert int(cardea.outcome(state)) == Outcome.RUNNING
    state[component] = value
    assert int(cardea.outcome(state)) == Outcome.FAILED
    after = cardea.step(state, torch.zeros(5).double(), CALM)
    assert torch.allclose(after, state, 0.0, 0.0, equal_nan=True)


def test_the_arm_against_the_column_is_a_contact() -> None:
    """Folded back, from clear of it: the hand reaches the column."""
    cardea = Cardea(torque_noise=0.0)
    pose = torch.tensor([0.0, 0.0, -2.2, -0.9, 0.0]).double()
    state = cardea.at_rest(pose, pose)
    push = torch.tensor([0.0, -10.0, -20.0, -2.0, 0.0]).double()
    for _ in range(50):
        state = cardea.step(state, push, CALM)
    assert int(state[25]) == Trouble.CONTACT and int(cardea.outcome(state)) == Outcome.FAILED
    assert state[24] < 1.0 and state.isfinite().all()


@pytest.mark.parametrize("torque", [math.nan, math.inf, -math.inf])
def test_a_torque_that_is_not_finite_ends_the_episode(torque: float) -> None:
    cardea = Cardea()
    state = cardea.initial(uniforms(3, 2))
    action = torch.zeros(3, 5).double()
    action[1, 2] = torque
    with pytest.warns(RuntimeWarning, match="row 1: a torque is not finite"):
        after = cardea.step(state, action, uniforms(3, 5))
    assert cardea.outcome(after).tolist() == [Outcome.RUNNING, Outcome.FAILED, Outcome.RUNNING]
    assert int(after[1, 25]) == Trouble.TORQUE and after.isfinite().all()
    assert torch.equal(after[1, :24], state[1, :24])
    alone = cardea.step(state[::2], action[::2], uniforms(3, 5)[::2])
    assert torch.equal(after[::2], alone)


def test_success_is_decided_at_the_time_limit() -> None:
    """Held at the goal: SUCCEEDED after 2 s and not before; held elsewhere: TIMED_OUT."""
    cardea = Cardea(torque_noise=0.0)
    pose = torch.tensor(NEUTRAL).double()
    state = cardea.at_rest(pose.expand(2, 5), torch.stack((pose, pose + 0.12)))
    for k in range(100):
        assert cardea.outcome(state).tolist() == [Outcome.RUNNING] * 2, k
        acceleration = 50 * (pose - state[:, :5]) - 14 * state[:, 7:12]
        torque = cardea.inverse_dynamics(state, acceleration)
        state = cardea.step(state, torque, CALM.expand(2, 5))
    assert cardea.outcome(state).tolist() == [Outcome.SUCCEEDED, Outcome.TIMED_OUT]
    measures = cardea.measures(state, state, state[:, 24])
    assert measures["joint_error_rad"].tolist() == pytest.approx([0, 0.12], abs=1e-3)
    assert measures["joint_speed_rad_s"].max() < 1e-3
    fast = state.clone()
    fast[0, 7:12] = 0.21
    assert int(cardea.outcome(fast)[0]) == Outcome.TIMED_OUT


def test_measures_by_hand() -> None:
    cardea = Cardea()
    state = cardea.at_rest(
        torch.tensor([0.0, 0.0, 0.0, 0.3, 0.4]), torch.tensor([math.pi / 2, 0, 0, 0, 0])
    )
    state[7:12] = torch.tensor([1.0, -1.0, 0.5, 0.0, 0.0])
    measures = {k: float(v) for k, v in cardea.measures(state, state, state[24]).items()}
    assert measures["joint_error_rad"] == pytest.approx((math.pi / 2 + 0.7) / 5)
    assert measures["joint_speed_rad_s"] == pytest.approx(0.5)
    assert measures["wrist_error_cm"] == pytest.approx(58 * math.sqrt(2), rel=1e-6)
    level = math.degrees(math.acos(math.cos(0.3) * math.cos(0.4)))
    assert measures["level_error_deg"] == pytest.approx(level, rel=1e-6)


def test_start_and_goal_by_hand() -> None:
    cardea = Cardea(start=NEUTRAL, goal=(0.4, 0.1, 0.0))
    state = cardea.initial(uniforms(2, 2))
    assert torch.equal(state[:, :5], torch.tensor([NEUTRAL] * 2, dtype=torch.float64))
    assert wrist(state[0, 14:19]).tolist() == pytest.approx([0.4, 0.1, 0.0])
    expected = level_angles(np.array([0.4, 0.1, 0.0]))
    assert expected is not None and state[0, 14:19].tolist() == expected.tolist()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"goal": (0.9, 0.0, 0.0)}, r"goal=\(0.9, 0, 0\) m: expected .* nearest is \(0.5[78]"),
        ({"goal": (0.05, 0.0, 0.0)}, r"goal=\(0.05, 0, 0\) m: expected .* nearest is \(0"),
        ({"goal": (0.4, 0.0)}, r"goal=\(0.4, 0.0\): expected 3 finite numbers"),
        ({"goal": (0.4, 0.0, math.nan)}, "goal=.* expected 3 finite numbers"),
        ({"start": (2.3, 0.0, 0.0, 0.0, 0.0)}, "start=.* the arm touches nothing"),
        ({"start": (0.0, 3.0, 0.0, 0.0, 0.0)}, "start=.* within the stops"),
        ({"start": ("a", 0.0, 0.0, 0.0, 0.0)}, "start=.* expected 5 finite numbers"),
        ({"goal": (0.4, 0.0, 0.0), "clearance": 5.0}, "clearance=5.0 m: expected"),
        ({"workers": -1}, "workers=-1: expected"),
        ({"dt": 0.0}, "dt=0.0: expected"),
        ({"physics_dt": 0.003}, "physics_dt=0.003: expected a whole fraction of dt, 0.02 s"),
        ({"time_limit": 0.001}, "dt=0.02 s: expected at most time_limit"),
        ({"torque_noise": -0.1}, "torque_noise=-0.1: expected"),
        ({"state_scale": {"knee": 1.0}}, "state_scale='knee': expected names of shoulder_yaw"),
        ({"action_scale": {"elbow_torque": 0.0}}, "action_scale.elbow_torque=0.0: expected"),
    ],
)
def test_refuses_the_impossible(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        Cardea(**arguments)


# Yardsticks.


def run(
    cardea: Cardea, policy: Callable[[Cardea, Tensor], Tensor], episodes: int
) -> dict[str, float]:
    state = cardea.initial(uniforms(episodes, 2, seed=3))
    generator = torch.Generator().manual_seed(4)
    for _ in range(100):
        noise = torch.rand(episodes, 5, generator=generator, dtype=torch.float64)
        state = cardea.step(state, policy(cardea, state), noise)
    outcome = cardea.outcome(state)
    means = {k: float(v.mean()) for k, v in cardea.measures(state, state, state[:, 24]).items()}
    crashes = float((outcome == int(Outcome.FAILED)).double().mean())
    successes = float((outcome == int(Outcome.SUCCEEDED)).double().mean())
    return means | {"crashes": crashes, "successes": successes, "s": float(state[:, 24].mean())}


@pytest.mark.oracle
def test_baselines() -> None:
    """What is possible: everything, with the true dynamics; little, without gravity's."""
    calm = Cardea(torque_noise=0.0)
    exact = run(calm, YARDSTICKS["computed_torque"], 40)
    assert exact["joint_error_rad"] < 1e-3 and exact["joint_speed_rad_s"] < 1e-3
    assert exact["successes"] == 1 and exact["wrist_error_cm"] < 0.05
    noisy = run(Cardea(), YARDSTICKS["computed_torque"], 40)
    assert 0.015 < noisy["joint_error_rad"] < 0.03 and 0.12 < noisy["joint_speed_rad_s"] < 0.22
    held = run(calm, YARDSTICKS["pd_gravity"], 40)
    assert held["joint_error_rad"] < 0.01 and held["crashes"] == 0
    assert run(calm, YARDSTICKS["pd"], 40)["joint_error_rad"] > 0.1
    limp = run(calm, YARDSTICKS["nothing"], 40)
    assert limp["crashes"] == 1 and 0.4 < limp["s"] < 0.52


# Gymnasium.


def test_an_episode_in_gymnasium() -> None:
    env = CardeaEnv(torque_noise=0.0, crash_penalty=3.0)
    cardea = env.sim
    assert isinstance(cardea, Cardea)
    observation, info = env.reset(seed=2)
    for k in range(100):
        state = torch.zeros(26).double()
        state[:19] = torch.from_numpy(observation)
        torque = YARDSTICKS["computed_torque"](cardea, state).numpy()
        observation, reward, terminated, truncated, info = env.step(torque)
        cost = 0.02 * np.square(observation[:5] - observation[14:]).sum()
        assert reward == pytest.approx(-cost) and not terminated and truncated == (k == 99)
    assert info["outcome"] == "SUCCEEDED" and info["measures"]["joint_error_rad"] < 1e-3
    env.reset(seed=3)
    terminated, reward = False, 0.0
    while not terminated:
        _, reward, terminated, truncated, info = env.step(np.zeros(5))
        assert not truncated
    assert reward < -3 and info["outcome"] == "FAILED"
    env.reset(seed=2)
    with pytest.raises(ValueError, match="action="):
        env.step(np.array([0, 0, math.nan, 0, 0]))
    with pytest.raises(ValueError, match="crash_penalty=-1"):
        CardeaEnv(crash_penalty=-1)


def test_render() -> None:
    """The arm and the ball that marks the goal are in the picture, and move."""
    env = CardeaEnv(render_mode="rgb_array", start=NEUTRAL, goal=(0.4, -0.1, 0.1))
    env.reset(seed=0)
    first = env.render()
    for _ in range(10):
        env.step(np.zeros(5))
    picture = env.render()
    assert picture.shape == (240, 320, 3) and picture.dtype == np.uint8
    assert not np.array_equal(first, picture)
    red, green, blue = first.astype(int).transpose(2, 0, 1)
    assert ((red > 100) & (green < 60) & (blue < 60)).sum() > 20
