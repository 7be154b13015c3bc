"""Trials of a population: whole ones, cut ones, and ones that are given up."""

from __future__ import annotations

import math
from collections.abc import Sequence

import pytest
import torch
from torch import Tensor

from edtorch.run.scaled_sim import World
from edtorch.run.trial import Trial, look_at_starts, run_trials
from edtorch.search.exploring import Perturbed, RandomActions
from edtorch.types import Parameters
from sims.base import Outcome
from sims.sensing import Sensed
from sims.tasks.cart_pole_swing_up import CartPoleSwingUp

ACTIONS = RandomActions(torch.zeros(1).double(), torch.ones(1).double())


def _world() -> World:
    return World(Sensed(CartPoleSwingUp(), {"position": 0.01, "rate": 0.01}))


def _same(a: Trial | None, b: Trial | None) -> bool:
    assert a is not None and b is not None
    tensors = ((a.readings, b.readings), (a.actions, b.actions), (a.valid, b.valid))
    return all(torch.equal(x, y) for x, y in tensors) and a.episode.seconds == b.episode.seconds


def test_a_seed_alone_has_the_digits_that_it_has_in_a_population() -> None:
    together = run_trials(ACTIONS, _world(), [3, 4, 5], 2, 40)
    (alone,) = run_trials(ACTIONS, _world(), [4], 2, 40)
    assert _same(together[1], alone)
    assert not _same(together[0], together[1])


def test_trials_have_numbers_of_their_own() -> None:
    first, second = (run_trials(ACTIONS, _world(), [0], number, 40)[0] for number in (0, 1))
    assert not _same(first, second)


def test_a_trial_may_have_several_runs() -> None:
    """Of each seed side by side, the first of which is the trial of one run."""
    runs = run_trials(ACTIONS, _world(), [3, 4], 2, 40, runs=3)
    alone = run_trials(ACTIONS, _world(), [4], 2, 40)[0]
    assert len(runs) == 6 and _same(runs[3], alone)
    assert not any(_same(runs[3], other) for other in runs[4:])


def test_noise_is_added_to_a_policy() -> None:
    class Still:
        def initial(self, seeds: Sequence[int]) -> Parameters:
            return parameters

        def action(self, parameters: Parameters, state: Tensor) -> Tensor:
            return parameters["push"]

    parameters = {"push": torch.tensor([[0.2], [-0.3]]).double()}
    source = Perturbed(Still(), parameters, torch.tensor([0.1]).double())
    for trial, push in zip(run_trials(source, _world(), [0, 1], 0, 40), (0.2, -0.3), strict=True):
        assert trial is not None
        assert float(trial.actions.mean()) == pytest.approx(push, abs=0.06)
        assert float(trial.actions.std()) == pytest.approx(0.1, rel=0.3)
    quiet = run_trials(
        Perturbed(Still(), parameters, torch.zeros(1).double()), _world(), [0, 1], 0, 5
    )
    assert quiet[1] is not None and torch.equal(
        quiet[1].actions, parameters["push"][1].expand(5, 1)
    )


def test_readings_follow_from_the_actions() -> None:
    """Without errors of readings, each is the simulator's step from the one before."""
    world = World(CartPoleSwingUp())
    (trial,) = run_trials(ACTIONS, world, [0], 0, 40)
    assert trial is not None and trial.whole
    assert trial.episode.outcome is not Outcome.RUNNING
    assert trial.actions.abs().max() <= 1
    scale = torch.tensor([q.scale for q in world.spec.state]).double()
    rest = torch.zeros(40, 3).double()
    before = torch.cat([trial.readings[:-1] * scale, rest], dim=-1)
    after = world.sim.step(before, 10 * trial.actions, torch.zeros(40, 0))
    seen = world.sim.observe(after) / scale
    assert torch.allclose(seen, trial.readings[1:], atol=1e-9)


def test_a_trial_may_be_shorter_than_an_episode() -> None:
    (trial,) = run_trials(ACTIONS, _world(), [0], 0, 15)
    (whole,) = run_trials(ACTIONS, _world(), [0], 0, 40)
    assert trial is not None and whole is not None
    assert trial.whole and trial.episode.seconds == pytest.approx(1.5)
    assert trial.episode.success is False
    assert torch.equal(trial.readings, whole.readings[:16])


def test_a_trial_is_given_up_where_it_is_told_to() -> None:
    def left(tick: int, readings: Tensor) -> Tensor:
        return torch.tensor([tick == 7, tick == 3, False])

    trials = run_trials(ACTIONS, _world(), [0, 1, 2], 1, 40, left)
    lengths = [trial.episode.seconds for trial in trials if trial is not None]
    assert lengths == pytest.approx([0.7, 0.3, 4.0])
    assert [trial.whole for trial in trials if trial is not None] == [False, False, True]
    whole = run_trials(ACTIONS, _world(), [0], 1, 40)[0]
    assert trials[0] is not None and whole is not None
    assert torch.equal(trials[0].readings, whole.readings[:8])


def test_random_actions_are_uniform() -> None:
    normal = torch.randn(20_000, 1, generator=torch.Generator().manual_seed(0)).double()
    source = RandomActions(torch.tensor([2.0]).double(), torch.tensor([3.0]).double())
    found = source.act({}, normal, normal).flatten().sort().values
    expected = torch.linspace(-1, 5, len(found)).double()
    # The distance of Kolmogorov and Smirnov, far beyond its 99.9 % quantile.
    assert (found - expected).abs().max() / 6 < 2.2 / math.sqrt(len(found))


def test_starts_are_looked_at_as_the_task_draws_them() -> None:
    found = look_at_starts(_world(), 0, 400)
    away = torch.remainder(found[:, 2], 2 * math.pi) - math.pi
    assert abs(float(away.mean())) < 0.03
    assert float(away.std()) == pytest.approx(0.1, rel=0.15)
