"""Imagined runs of a gait: tick by tick as the model's own ticks, and each end by its own cause."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hydra.utils import instantiate
from omegaconf import OmegaConf

from edtorch.app.compose import CONF
from edtorch.policy.linear_gait import LinearGait
from edtorch.policy.phase import PhaseGait
from edtorch.policy.squash import Squash
from edtorch.policy.vector import VectorPolicy
from edtorch.rewards.lifted import lifted_row
from edtorch.search.ground import GroundForce
from edtorch.search.imagination import Futures
from edtorch.search.phase_runs import PhaseRuns, RunEnds, phase_runs
from edtorch.search.striking import struck_states
from sims.tasks.walker import START
from tests.search.test_striking import true_model
from tests.walkers import TOLD

pytestmark = pytest.mark.oracle

TICKS = 60
MODEL = true_model(1)
LIFT = MODEL.free.structure.lift


GAIT: PhaseGait = instantiate(OmegaConf.load(CONF / "search/gait/rabbit.yaml"), _convert_="all")
SQUASH = Squash(torch.zeros(4).double(), torch.ones(4).double())
POLICY, LINEAR = GAIT.policy(TOLD, SQUASH), LinearGait(GAIT).policy(TOLD, SQUASH)
VECTORS = POLICY.vector(POLICY.random(2, 1.0, np.random.default_rng(1)))


def ends(*always: dict[str, float], **more: object) -> RunEnds:
    rows = [lifted_row(LIFT, row, "always").numpy() for row in always]
    none = np.zeros((0, LIFT.size))
    return RunEnds(np.array(rows).reshape(len(rows), LIFT.size), none, **more)  # pyright: ignore


def begun(count: int = 1) -> Futures:
    start = np.zeros((count, 13))
    start[:, 0:10:2] = START
    weight = np.repeat(MODEL.free.weight[None], count, axis=0)
    return Futures(weight, start, np.zeros((count, TICKS, 13)))


@pytest.mark.parametrize(
    "policy", [POLICY, pytest.param(LINEAR, marks=pytest.mark.long)], ids=["phase", "linear"]
)
def test_runs_are_ticks_of_the_model_under_the_policy(policy: VectorPolicy) -> None:
    vectors = policy.vector(policy.random(2, 1.0, np.random.default_rng(5)))
    push = np.zeros((1, TICKS, 4))
    push[:, :, 0] = 0.02
    futures = begun()
    futures.noise[:] = 1e-3 * np.random.default_rng(2).standard_normal(futures.noise.shape)
    runs = phase_runs(MODEL, policy, vectors.numpy(), futures, push, ends())
    for c in range(2):
        state, parameters = futures.start, policy.of_vector(vectors[c : c + 1])
        for t in range(runs.ticks[c, 0]):
            seen = torch.from_numpy(state + futures.noise[:, t])
            action = policy.action(parameters, seen).numpy() + push[:, t]
            state = struck_states(MODEL, state, action.clip(-1, 1)[:, None])[:, 1]
        assert np.isfinite(state).all()
        assert runs.strikes[c, 0] == round(float(state[0, 10] * TOLD.unit[10]))
    assert runs.ticks.max() == TICKS and runs.strikes.min() > 0


def test_a_run_ends_where_a_row_falls_below_zero_or_its_noise_ends() -> None:
    push = np.zeros((2, TICKS, 4))
    push[1, 7:] = np.nan
    # The virtual leg leans forward all the time.
    row = {"sin stance_shank": -1.0, "sin stance_thigh": -1.0, "constant": 0.3}
    runs = phase_runs(MODEL, POLICY, VECTORS[:1].numpy(), begun(2), push, ends(row))
    assert 7 < runs.ticks[0, 0] < TICKS and runs.ticks[0, 1] == 7


def test_a_run_ends_where_the_ground_does_not_hold() -> None:
    weight = np.zeros((2, 21))
    weight[:, 20] = 5.0, 10.0
    push, hinge = np.zeros((1, TICKS, 4)), np.arange(0, 10, 2)
    for friction, ticks in ((0.51, TICKS), (0.49, 0)):
        ground = GroundForce(weight, hinge, np.zeros(2))
        about = ends(ground=ground, friction=friction)
        runs = phase_runs(MODEL, POLICY, VECTORS[:1].numpy(), begun(), push, about)
        assert int(runs.ticks[0, 0]) == ticks


def test_quick_steps_before_a_fall_are_no_better_than_slow_ones_that_last() -> None:
    # Ten strikes and a fall after half of the time, five and none; one that stands.
    runs = PhaseRuns(np.array([[100], [200], [200]]), np.array([[10], [5], [0]]))
    assert runs.shares(np.array([200]), 0.02)[:, 0].tolist() == [0.5, 1.0, 0.25]
