"""The bicycle as a domain: starts, ends, what is seen, what is measured, what is refused."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from torch import Tensor

from sims.base import Outcome, spec_index
from sims.bicycle import HANDLEBAR_FIRST, Bicycle, angle_to_goal, explicit_euler
from sims.bicycle.optimum import shortest_time, steady_handlebar
from sims.bicycle.physics import RANDLOV, step


def state_at(
    x: float, y: float, psi: float = 0.0, *, lean: float = 0.0, theta: float = 0.0
) -> Tensor:
    """A bicycle with its front tyre at (x, y)."""
    back = (x + 1.11 * math.sin(psi), y - 1.11 * math.cos(psi))
    return torch.tensor([theta, 0, lean, 0, 0, psi, x, y, *back], dtype=torch.float64)


def start(psi: float) -> Tensor:
    sim = Bicycle(start_heading_low=psi, start_heading_high=psi)
    return sim.initial(torch.zeros(1, dtype=torch.float64))


def falls(sim: Bicycle, count: int, seed: int = 0) -> Tensor:
    """Seconds to the fall of ``count`` bicycles that nobody rides."""
    generator = torch.Generator().manual_seed(seed)
    state = sim.initial(torch.rand(count, 1, generator=generator, dtype=torch.float64))
    action = torch.zeros(count, 2, dtype=torch.float64)
    seconds = torch.zeros(count, dtype=torch.float64)
    up = torch.ones(count, dtype=torch.bool)
    with torch.inference_mode():
        while bool(up.any()):
            uniforms = torch.rand(count, 1, generator=generator, dtype=torch.float64)
            state = sim.step(state, action, uniforms)
            seconds += up * sim.dt
            up &= sim.outcome(state) != Outcome.FAILED
    return seconds


def test_untouched_it_falls_after_1_69_seconds() -> None:
    # The standard error of the mean is 0.0017 s.
    assert float(falls(Bicycle(), 20_000).mean()) == pytest.approx(1.688, abs=0.01)


def test_explicit_euler_falls_too() -> None:
    mean = float(falls(Bicycle(integrate=explicit_euler), 2000).mean())
    assert 1.4 < mean < 2.0


def test_without_noise_it_stands() -> None:
    sim = Bicycle(noise=0.0)
    state = sim.initial(torch.rand(3, 1, dtype=torch.float64))
    for _ in range(200):
        state = sim.step(state, torch.zeros(3, 2).double(), torch.rand(3, 1, dtype=torch.float64))
    assert torch.equal(state[:, 2], torch.zeros(3).double())


def test_noise_is_added_to_the_displacement() -> None:
    sim, state = Bicycle(noise=0.02), start(0.3)
    action = torch.tensor([1.0, 0.02], dtype=torch.float64)
    for uniform, w in ((0.0, -0.02), (0.5, 0.0), (0.75, 0.01)):
        got = sim.step(state, action, torch.tensor([uniform], dtype=torch.float64))
        wanted = step(state, action, torch.tensor(w, dtype=torch.float64))
        assert torch.allclose(got, wanted, rtol=0, atol=1e-16)


def test_start_headings() -> None:
    uniforms = torch.rand(10_000, 1, generator=torch.Generator().manual_seed(1)).double()
    psi = Bicycle().initial(uniforms)[:, 5]
    assert float(psi.min()) < -3.13 and float(psi.max()) > 3.13
    assert float(psi.mean()) == pytest.approx(0, abs=0.06)
    assert float(psi.std()) == pytest.approx(math.pi / math.sqrt(3), abs=0.04)
    narrow = Bicycle(start_heading_low=0.2, start_heading_high=0.4).initial(uniforms)
    assert 0.2 <= float(narrow[:, 5].min()) and float(narrow[:, 5].max()) <= 0.4
    fixed = start(0.0)
    assert fixed.tolist() == [0, 0, 0, 0, 0, 0, 0, 1.11, 0, 0]


def test_restart_by_mask() -> None:
    sim = Bicycle()
    state = sim.initial(torch.rand(4, 1).double()) + 1.0
    mask = torch.tensor([True, False, True, False])
    uniforms = torch.rand(4, 1).double()
    new = sim.restart(state, mask, uniforms)
    assert torch.equal(new[~mask], state[~mask])
    assert torch.equal(new[mask], sim.initial(uniforms)[mask])


@pytest.mark.parametrize(
    ("psi", "angle"),
    [(0.0, -math.pi / 2), (-math.pi / 2, 0.0), (math.pi / 2, math.pi), (-2.0, 2.0 - math.pi / 2)],
)
def test_angle_to_goal(psi: float, angle: float) -> None:
    # Astern, a rounding error decides between pi and -pi.
    off = float(angle_to_goal(state_at(-1e6, 0.0, psi))) - angle
    assert math.remainder(off, 2 * math.pi) == pytest.approx(0, abs=1e-9)


def test_observation() -> None:
    state = torch.tensor([0.1, 0.2, 0.03, 0.4, 0.5, -math.pi / 2, 1.11, 0, 0, 0]).double()
    seen = Bicycle().observe(state)
    assert seen[:4].tolist() == state[[2, 3, 0, 1]].tolist() and abs(float(seen[4])) < 1e-6
    more = Bicycle(lean_acceleration=True)
    assert more.observe(state).tolist() == [*seen.tolist(), float(state[4])]
    assert [q.name for q in more.spec.state] == [
        "lean", "lean_rate", "handlebar", "handlebar_rate", "angle_to_goal", "lean_acceleration"
    ]  # fmt: skip


def test_spec() -> None:
    spec = Bicycle(state_scale={"lean": 0.15}, action_scale={"displacement": 1}).spec
    assert (spec.name, spec.headline, spec.reset_dim, spec.disturbance_dim) == (
        "bicycle", "angle_to_goal", 1, 1
    )  # fmt: skip
    assert [q.scale for q in spec.state] == [0.15, 0.5, 0.5, 2, math.pi]
    assert [q.scale for q in spec.action] == [2, 1]
    assert [(q.low, q.high) for q in spec.action] == [(-2, 2), (-0.02, 0.02)]
    assert [q.period for q in spec.state] == [0, 0, 0, 0, 2 * math.pi]
    assert spec_index(spec, HANDLEBAR_FIRST) == [2, 3, 0, 1, 4]
    with pytest.raises(ValueError, match=r"'tilt'.*bicycle.*lean"):
        spec_index(spec, ["tilt"])
    assert Bicycle(clip_action=False).spec.clip_action is False


def test_outcomes() -> None:
    sim = Bicycle()
    states = torch.stack(
        [
            state_at(0, 0, lean=math.pi / 15),
            state_at(0, 0, lean=-math.nextafter(math.pi / 15, 1)),
            state_at(990, 0),
            state_at(1000, 10),
            state_at(989.999, 0),
            state_at(1000, 0, lean=0.3),
            state_at(0, 0, lean=math.nan),
            state_at(0, 0, theta=math.inf),
            state_at(1000, 0, theta=math.nan),
        ]
    )
    wanted = ["RUNNING", "FAILED", "SUCCEEDED", "SUCCEEDED", "RUNNING", *["FAILED"] * 4]
    assert [Outcome(value).name for value in sim.outcome(states).tolist()] == wanted
    assert int(Bicycle(goal_radius=2.0).outcome(state_at(997.9, 0))) == Outcome.RUNNING


def test_measures() -> None:
    begin = torch.stack([start(-math.pi / 2)] * 2)
    final = torch.stack([state_at(995, 0), state_at(0, 0, lean=1)])
    seconds = torch.tensor([360.0, 3.6], dtype=torch.float64)
    measures = Bicycle().measures(begin, final, seconds)
    assert float(measures["goal_time_s"][0]) == 360 and math.isnan(measures["goal_time_s"][1])
    assert measures["path_length_m"].tolist() == pytest.approx([1000, 10])
    assert measures["shortest_time_s"].tolist() == pytest.approx([356.0, 356.0], abs=0.01)
    assert measures["goal_rate"].tolist() == [1, 0]
    ratio = measures["goal_time_over_shortest"]
    assert float(ratio[0]) == pytest.approx(360 / 356, rel=1e-4) and math.isnan(ratio[1])


def test_path_length_is_speed_times_time() -> None:
    sim, generator = Bicycle(noise=0.0), torch.Generator().manual_seed(0)
    states = [sim.initial(torch.rand(5, 1, generator=generator).double())]
    for _ in range(100):
        action = torch.rand(5, 2, generator=generator).double() * torch.tensor([2.0, 0.02])
        states.append(sim.step(states[-1], action, torch.full((5, 1), 0.5).double()))
    path = torch.stack(states)[:, :, 6:8].diff(dim=0).norm(dim=-1).sum(0)
    second = torch.ones(5).double()
    measured = sim.measures(states[0], states[-1], second)["path_length_m"]
    assert torch.allclose(path, measured, rtol=1e-12)


def test_shortest_time() -> None:
    assert float(shortest_time(start(-math.pi / 2))) == pytest.approx(356.0, abs=0.001)
    assert float(shortest_time(start(math.pi / 2))) == pytest.approx(360.0, abs=0.3)
    offs = torch.linspace(0, math.pi, 50)
    times = torch.stack([shortest_time(start(-math.pi / 2 + float(off))) for off in offs])
    assert bool((times.diff() >= 0).all()) and float(times[-1]) == float(times.max())
    left = torch.stack([start(-math.pi / 2 + a) for a in (0.5, 1.5)])
    right = torch.stack([start(-math.pi / 2 - a) for a in (0.5, 1.5)])
    assert torch.allclose(shortest_time(left), shortest_time(right), atol=1e-9, rtol=0)
    assert float(shortest_time(state_at(1000, 5))) == 0


def test_shortest_time_is_the_path_measured_by_walking_it() -> None:
    """A front tyre that turns as tightly as it may until it points at the goal, then goes on."""
    theta = float(steady_handlebar())
    curvature = math.sin(theta) / float(RANDLOV.l)
    for psi in (-0.5, 0.8, 1.5):
        x, y = start(psi)[6:8].tolist()
        ds, length, heading = 1e-3, 0.0, psi - theta  # turning right, handlebar already turned
        while math.hypot(1000 - x, -y) > 10:
            bearing = math.atan2(-(1000 - x), -y)
            if abs(math.remainder(bearing - heading, 2 * math.pi)) < 2 * ds * curvature:
                length += math.hypot(1000 - x, -y) - 10
                break
            heading -= ds * curvature
            x, y, length = x - ds * math.sin(heading), y + ds * math.cos(heading), length + ds
        assert float(shortest_time(start(psi))) == pytest.approx(length / (10 / 3.6), abs=0.01)


def test_steady_turn_is_steady() -> None:
    theta = steady_handlebar()
    state = state_at(0, 0, lean=math.pi / 15, theta=float(theta))
    new = step(state, torch.tensor([0.0, 0.02]).double(), torch.tensor(0.0).double())
    assert abs(float(new[4])) < 1e-7


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"dt": 0.0}, "dt=0.0: expected a finite number above 0"),
        ({"time_limit": -1.0}, "time_limit=-1.0: expected"),
        ({"time_limit": 0.001}, "dt=0.01 s: expected at most time_limit"),
        ({"goal_radius": 0.0}, "goal_radius=0.0: expected"),
        ({"goal_radius": math.inf}, "goal_radius=inf: expected"),
        ({"noise": -0.02}, "noise=-0.02: expected"),
        ({"noise": math.nan}, "noise=nan: expected"),
        ({"start_heading_low": -4.0}, "start_heading_low=-4.0: expected within"),
        (
            {"start_heading_low": 1.0, "start_heading_high": 0.0},
            "low=1.0: expected at most",
        ),
        ({"state_scale": {"lean": 0.0}}, "state_scale.lean=0.0: expected"),
        ({"state_scale": {"tilt": 1.0}}, "state_scale='tilt': expected names of lean"),
        ({"action_scale": {"lean": 1.0}}, "action_scale='lean': expected names of handlebar_t"),
    ],
)
def test_refuses_the_impossible(arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as refusal:
        Bicycle(**arguments)
    assert message in str(refusal.value)
