"""Compiled ticks: the same lives as tick by tick, whatever the company, lanes and threads."""

from __future__ import annotations

import pytest
import torch
from torch.utils import _pytree as pytree

from edtorch.run.training import Training
from tests.native.kinds import LINEAR, farthest, lives, native, training_of

AFFINE = (
    *LINEAR,
    "model=derivative",
    "model.features=affine",
    "policy=affine",
    "fit=normalised",
    "transform=first",
    "step=decaying",
    "+reward.action.action_0=0.3",
    "+reward.target.state_0=0.4",
    "unroll.start=origin",
    "unroll.start_deviation=0.2",
    "schedule.every=3",
)
PLAIN = (*LINEAR, "model=next_state", "fit=adaptive", "transform=mean_only", "step=saturated")
REGULATED = (
    *LINEAR,
    "model=derivative",
    "model.features=affine",
    "policy=affine",
    "fit=least_squares",
    "transform=first",
    "step=full",
    "unroll.direction=regulator",
    "+reward.action.action_0=0.3",
    "+reward.target.state_0=0.4",
    "schedule.first=20",
)
PAPER = ("experiment=bicycle_paper", "exploration.deviation=0.5")
SAFE = ("experiment=bicycle", "command.actions=true", "command.deviations=0.5")
EVERYTHING = (
    "experiment=slalom",
    "fit=absolute_decaying",
    "command=ramp",
    "transform=mean_only",
    "unroll.start=state",
    "unroll.start_deviation=0",
    "step=plain",
    "step.alpha=0.01",
    "domain.spread=0.3",
    "domain.gust=20",
    "domain.change_at=0.9",
    "+domain.change.v=5.0",
    "domain.start_lean=0.1",
    "domain.gate_spacing=2.5",
    "domain.look_ahead=1.0",
    "eval.success_return=-0.5",
)
KINDS = {
    "plain": PLAIN,
    "affine": AFFINE,
    "regulated": REGULATED,
    "paper": PAPER,
    "safe": SAFE,
    "everything": EVERYTHING,
}


@pytest.mark.oracle
@pytest.mark.parametrize(
    ("kind", "seeds", "least"),
    [
        pytest.param("plain", 20, 200, marks=pytest.mark.long),
        pytest.param("affine", 20, 200, marks=pytest.mark.long),
        pytest.param("regulated", 3, 30, marks=pytest.mark.long),
        ("paper", 20, 30),
        pytest.param("safe", 3, 0, marks=pytest.mark.long),
        pytest.param("everything", 3, 3, marks=pytest.mark.long),
    ],
)
def test_compiled_ticks_are_the_same_ticks(kind: str, seeds: int, least: int) -> None:
    how = (*KINDS[kind], f"seeds={seeds}", "train.seconds=1000", "train.successes=null")
    eager, together = training_of(*how), native(training_of(*how))
    for training in (eager, together):
        training.advance(300)
    assert together.clock == 300 and len(together.episodes) >= least
    assert lives(together) == lives(eager)
    worst = farthest(together, eager)
    assert max(worst.values()) < 1e-9, worst
    for found, wanted in zip(together.episodes, eager.episodes, strict=True):
        assert found.success == wanted.success
        assert found.measures == pytest.approx(wanted.measures, rel=1e-9, nan_ok=True)
        if found.row < together.trail.size:
            kept = [t.path(found) for t in (together, eager)]
            assert torch.allclose(*kept, rtol=1e-9, atol=1e-9)


def states(training: Training) -> list[torch.Tensor]:
    return pytree.tree_leaves(training.stage.population)


@pytest.mark.long
@pytest.mark.oracle
def test_digits_do_not_depend_on_company_lanes_or_threads() -> None:
    def grown(*how: str, **options: int) -> Training:
        training = native(training_of(*PLAIN, "train.seconds=1000", *how), **options)
        training.advance(200)
        return training

    wide = grown("seeds=70")
    alone, one_by_one = grown("seed=37", "seeds=1"), grown("seeds=70", lanes=1)
    threaded = grown("seeds=70", threads=2)
    for whole, single, apart, parallel in zip(
        *map(states, (wide, alone, one_by_one, threaded)), strict=True
    ):
        for other in (apart, parallel):
            assert torch.equal(whole.nan_to_num(), other.nan_to_num())
        assert torch.equal(whole[37:38].nan_to_num(), single.nan_to_num())
    assert lives(threaded) == lives(wide) == lives(one_by_one)


@pytest.mark.oracle
def test_learners_stop_with_their_budget_and_pieces_do_not_matter() -> None:
    budget = (*PAPER, "seeds=20", "train.seconds=null", "train.episodes=2")
    eager, whole = training_of(*budget), native(training_of(*budget))
    pieces = native(training_of(*budget))
    eager.advance(1000)
    whole.advance(1000)
    while not pieces.done:
        pieces.advance(7)
    assert lives(whole) == lives(pieces) == lives(eager)
    assert whole.clock == pieces.clock == eager.clock
    for left, right in zip(states(whole), states(pieces), strict=True):
        assert torch.equal(left.nan_to_num(), right.nan_to_num())
