"""Compiled evaluation: the same episodes as tick by tick, whatever the company and threads."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence

import numpy as np
import pytest
import torch

from edtorch.model.features import Affine, Identity
from edtorch.model.told import Told
from edtorch.native import evaluation
from edtorch.native.evaluation import Mode, Rides, evaluate_policies
from edtorch.native.plan import NoKernel
from edtorch.policy.linear_gait import LinearGait
from edtorch.policy.phase import PhaseGait
from edtorch.policy.policies import LinearPolicy, SquashedPolicy
from edtorch.policy.squash import Squash
from edtorch.policy.vector import Gait
from edtorch.rewards import QuadraticReward
from edtorch.run.episodes import Episode
from edtorch.run.random import Purpose
from edtorch.run.scaled_sim import World
from edtorch.types import Parameters
from sims.base import Outcome
from sims.bicycle import Bicycle
from sims.linear import LinearSystem
from sims.sensing import Sensed
from sims.tasks.pendulum_swing_up import PendulumSwingUp
from tests.systems import f64

SEEDS = [3, 4, 8]
MODES: tuple[Mode, Mode] = ("on", "off")


def linear() -> tuple[LinearPolicy, Parameters, World]:
    """Policies that keep still, let go, and blow up; the return decides about some episodes."""
    sim = LinearSystem([[1.0, 0.1], [0.0, 1.0]], [[0.0], [0.5]], noise=0.05, time_limit=60.0)
    reward = QuadraticReward(torch.eye(2).double(), 0.1 * torch.eye(1).double())
    world = World(sim, reward=reward, success_return=-70.0)
    weight = f64([[[0.05, -0.4, -0.9]], [[0.0, 0.0, 0.0]], [[0.1, 0.5, 0.8]]])
    return LinearPolicy(2, 1, Affine(2)), {"weight": weight}, world


def bicycle() -> tuple[LinearPolicy, Parameters, World]:
    """Falls, goals and time limits, in the world of each seed, with angles counted on."""
    sim = Bicycle(time_limit=0.7, goal_radius=998.2, spread=0.2, gust=5.0, start_lean=0.1)
    weight = torch.zeros(3, 2, 5, dtype=torch.float64)
    weight[1, :, :2] = 0.5
    weight[2, 0, 2:4] = f64([-1.0, -0.5])
    limit = torch.full((3, 5), math.inf, dtype=torch.float64)
    limit[:, 4] = f64([0.3, 0.1, 1.0])
    weight[:, 0, 4] = 0.4
    return (
        LinearPolicy(5, 2, Identity(5)),
        {"weight": weight, "limit": limit},
        World(sim, unwrap=0.5),
    )


def told(episodes: Sequence[Sequence[Episode]]) -> list[tuple[object, ...]]:
    return [(e.row, e.number, e.seconds, e.outcome, e.success) for own in episodes for e in own]


def figures(episodes: Sequence[Sequence[Episode]]) -> torch.Tensor:
    return f64([[e.total_reward, *e.measures.values()] for own in episodes for e in own])


@pytest.mark.oracle
@pytest.mark.parametrize("kind", [linear, bicycle])
def test_compiled_episodes_are_the_same_episodes(
    kind: Callable[[], tuple[LinearPolicy, Parameters, World]], monkeypatch: pytest.MonkeyPatch
) -> None:
    policy, parameters, world = kind()

    def ridden(native: Mode, rows: Sequence[int] = (0, 1, 2), count: int = 12) -> list:
        own = {name: p[list(rows)] for name, p in parameters.items()}
        seeds = [SEEDS[row] for row in rows]
        return evaluate_policies(policy, own, world, seeds, count, native=native)

    found, wanted = ridden("on"), ridden("off")
    outcomes = {e.outcome for own in wanted for e in own}
    assert outcomes == {Outcome.FAILED, Outcome.SUCCEEDED, Outcome.TIMED_OUT}
    assert told(found) == told(wanted)
    assert torch.allclose(figures(found), figures(wanted), rtol=1e-9, atol=1e-9, equal_nan=True)

    # To the last digit the same alone, in other tiles, and in threads.
    alone = figures(ridden("on", [1], 2))
    assert torch.equal(alone.nan_to_num(), figures([found[1][:2]]).nan_to_num())
    monkeypatch.setattr(evaluation, "TILE", 5)
    torch.set_num_threads(2)
    try:
        apart = ridden("on")
    finally:
        torch.set_num_threads(1)
    assert told(apart) == told(found)
    assert torch.equal(figures(apart).nan_to_num(), figures(found).nan_to_num())

    # Those who watch see the same, and what has not ended by then is left out.
    seen: dict[str, list[torch.Tensor]] = {}
    for native in MODES:
        shown = seen[native] = []
        own = evaluate_policies(
            *(policy, parameters, world, SEEDS, 2), native=native, watch=shown.append, ticks=30
        )
        early = [[e for e in each[:2] if e.seconds <= 30.5 * world.dt] for each in wanted]
        assert told(own) == told(early)
    compiled, uncompiled = (torch.stack(seen[native]) for native in MODES)
    torch.testing.assert_close(compiled, uncompiled, rtol=1e-9, atol=1e-9, equal_nan=True)

    # What is no number acts as it does elsewhere, and on nobody else.
    parameters["weight"][2] = math.nan
    broken = ridden("on")
    assert told(broken) == told(ridden("off"))
    assert told(broken[:2]) == told(found[:2])
    assert ridden("on", count=0) == [[], [], []]


@pytest.mark.long
@pytest.mark.oracle
@pytest.mark.parametrize("kind", ["phase", "linear"])
def test_compiled_episodes_of_policies_of_one_vector_are_the_same(kind: str) -> None:
    """With errors of the readings, which are compiled, too."""
    sim = Sensed(PendulumSwingUp(), {"angle": 0.01, "rate": 0.02})
    world, known = World(sim), Told.of(sim.spec)
    phase = PhaseGait(
        phase={"angle": 1.0},
        start=-1.0,
        width=3.0,
        spread=0.3,
        joints={
            "arm": {
                **{"of": {"angle": 1.0}, "drives": {"torque": 1.0}, "stiffness": 2.0},
                **{"damping": 0.3, "points": [2.0, -1.0, 3.0], "spread": 0.5},
                **{"feedback": 0.1, "spread_feedback": 0.1},
            }
        },
    )
    gait: Gait = {"phase": phase, "linear": LinearGait(about=phase)}[kind]
    policy = gait.policy(known, Squash(world.action_middle, world.action_half_range))
    parameters = policy.random(3, 1.0, np.random.default_rng(0))
    found = evaluate_policies(policy, parameters, world, SEEDS, 4, native="on")
    slow = evaluate_policies(policy, parameters, world, SEEDS, 4, native="off")
    assert told(found) == told(slow)
    torch.testing.assert_close(figures(found), figures(slow), rtol=1e-9, atol=1e-9, equal_nan=True)


def test_the_part_without_a_kernel_is_named() -> None:
    policy, parameters, world = linear()
    squashed = SquashedPolicy(2, 1, Affine(2))
    sensed = World(Sensed(LinearSystem([[0.5]], [[1.0]]), {"state_0": 0.1}, 1))
    one = LinearPolicy(1, 1, Identity(1))
    for part, arguments in (
        ("policy", (squashed, parameters, world)),
        ("float32", (policy, parameters, World(world.sim, dtype=torch.float32))),
        ("simulator", (one, one.initial([0]), sensed)),
        ("limits", (policy, parameters | {"limits": torch.zeros(3)}, world)),
    ):
        with pytest.raises(NoKernel, match=part):
            Rides(*arguments)
    with pytest.raises(NoKernel, match="policy"):
        evaluate_policies(squashed, parameters, world, SEEDS, 1, native="on")
    eager = evaluate_policies(squashed, parameters, world, SEEDS, 1, purpose=Purpose.JUDGING)
    off = evaluate_policies(
        squashed, parameters, world, SEEDS, 1, purpose=Purpose.JUDGING, native="off"
    )
    assert eager == off
