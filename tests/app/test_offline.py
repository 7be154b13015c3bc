"""Recording transitions, and learning from them, by the command: what is left, what is refused."""

from __future__ import annotations

import csv
import dataclasses
import json
import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import Any, cast

import numpy as np
import pytest
import torch
from safetensors.torch import load_file
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from edtorch.app.compose import compose
from edtorch.app.job import Job
from edtorch.app.offline import RecordedLearners
from edtorch.app.rundir import TRANSITIONS
from edtorch.app.work import planned
from edtorch.run.log import Entry
from edtorch.run.scaled_sim import World
from edtorch.run.transitions_file import save_transitions
from edtorch.value.linear.lqr import finite_horizon_lqr
from sims.bicycle import Bicycle
from tests.recorded import lived
from tests.systems import bicycle_learner

Command = Callable[..., Any]

RECORD = (
    "experiment=bicycle_random_falls",
    "seeds=2",
    "seed=1000",
    "train.seconds=15",
    "log.tensorboard=false",
    "log.figures=false",
)
LEARN = (
    "experiment=bicycle_offline",
    "seeds=2",
    "seed=1000",
    "domain.time_limit=4",
    "eval.episodes=3",
    "log.tensorboard=false",
)
FILES = {
    "checkpoints",
    "config.yaml",
    "episodes.csv",
    "metrics.csv",
    "policy.safetensors",
    "run.json",
    "run.log",
    "status.json",
    "summary.json",
}


def _json(path: Path) -> Any:
    return json.loads(path.read_text())


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def recorded(tmp_path_factory: pytest.TempPathFactory, quick_command: Command) -> Path:
    """Fifteen seconds of two random controllers."""
    folder = tmp_path_factory.mktemp("runs") / "falls"
    result = quick_command("edtorch-train", *RECORD, f"hydra.run.dir={folder}")
    assert result.status == 0, result.err
    assert "there is no kernel for keeping every transition" in result.err
    return folder


@pytest.fixture(scope="module")
def learned(recorded: Path, quick_command: Command) -> Path:
    """What two learners made of them."""
    folder = recorded.parent / "learned"
    result = quick_command(
        "edtorch-train", *LEARN, f"offline.data={recorded}", f"hydra.run.dir={folder}"
    )
    assert result.status == 0, result.err
    return folder


@pytest.mark.experiment
def test_tensorboard_has_the_settings(recorded: Path, quick_command: Command) -> None:
    folder = recorded.parent / "watched"
    given = (f"offline.data={recorded}", f"hydra.run.dir={folder}", "offline.steps=1")
    given += ("compute.native=off", "eval.episodes=1", "log.figures=false")
    result = quick_command("edtorch-train", *LEARN, "log.tensorboard=true", *given)
    assert result.status == 0, result.err
    accumulator = EventAccumulator(str(folder))
    accumulator.Reload()
    assert "config/text_summary" in accumulator.Tags()["tensors"]


@pytest.mark.experiment
def test_the_recording_is_of_the_run(recorded: Path) -> None:
    assert {p.name for p in recorded.iterdir()} == FILES | {"transitions.npz", "transitions.part"}
    summary = _json(recorded / "summary.json")
    falls = summary["falls_before_first_ride"]["per_seed"]
    with np.load(recorded / "transitions.npz") as file:
        assert file["state"].shape == file["next_state"].shape == (3000, 5)
        assert file["action"].shape == (3000, 2)
        assert int(file["terminated"].sum()) == sum(falls) > 20
        assert len(np.unique(file["episode"])) == sum(falls) + int(file["truncated"].sum())
        meta = json.loads(str(file["meta"]))
        # At random, and never better: as often left as right.
        assert abs(float(file["action"][:, 0].mean())) < 0.15
    assert [each["seed"] for each in meta["seeds"]] == [1000, 1001]
    assert meta["command"] == summary["command"] and meta["versions"] == summary["versions"]
    assert not load_file(recorded / "policy.safetensors")["weight"].any()


@pytest.mark.experiment
def test_fifteen_seconds_of_falls_teach_to_ride(recorded: Path, learned: Path) -> None:
    """The experiment's files and figures; no learner falls within four seconds, where a bicycle
    without control falls after two."""
    assert {p.name for p in learned.iterdir()} == FILES
    assert _json(learned / "status.json")["status"] == "done"
    summary, before = (_json(path / "summary.json") for path in (learned, recorded))
    for name in ("falls_before_first_ride", "seconds_before_first_ride"):
        assert summary[name]["per_seed"] == pytest.approx(before[name]["per_seed"])
    assert summary["falls_after_first_ride"]["per_seed"] == [0, 0]
    assert summary["simulated_seconds"] == pytest.approx([15, 15])
    assert summary["fall_rate"]["per_seed"] == [0, 0] and summary["never_rode"] == []
    used, left = (summary["offline"][f"transitions_{k}"]["per_seed"] for k in ("used", "left_out"))
    assert [a + b for a, b in zip(used, left, strict=True)] == [1500, 1500]
    assert min(left) > 100
    episodes = _rows(learned / "episodes.csv")
    assert [row["outcome"] for row in episodes] == ["failed"] * sum(
        summary["falls_before_first_ride"]["per_seed"]
    )
    assert all(math.isfinite(float(row["error"])) for row in _rows(learned / "metrics.csv")[:2])
    weight = load_file(learned / "policy.safetensors")["weight"]
    assert weight.shape == (2, 2, 5) and bool(weight.isfinite().all())


class Reports:
    """What a job is told, and the states in which it was asked whether to stop."""

    def __init__(self, work: RecordedLearners) -> None:
        self.work = work
        self.entries: list[Entry] = []
        self.states: list[tuple[int, dict[str, Any]]] = []

    def take(self, entry: Entry) -> None:
        self.entries.append(dataclasses.replace(entry, line=""))  # which tells the wall time

    def whole(self) -> None:
        self.states.append((len(self.entries), self.work.state()))

    def keep(self) -> None:
        """The test takes the states itself."""


@pytest.mark.experiment
def test_it_goes_on_from_a_state_with_the_same_reports(tmp_path: Path) -> None:
    """None is missing and none comes twice."""
    world = World(Bicycle())
    learner = dataclasses.replace(bicycle_learner(world), exploration=1.0)
    save_transitions(tmp_path / TRANSITIONS, lived(world, learner, [1, 2], 5.0)[1], world.spec)
    settings = (f"offline.data={tmp_path}", "offline.steps=150", "log.every=1")
    config = compose([*LEARN, "seed=1", *settings, "train.seconds=null"])

    def run(state: dict[str, Any] | None) -> Reports:
        work = planned(config)[1](None)
        assert isinstance(work, RecordedLearners)
        if state is not None:
            work.restore(state, tmp_path)
        reports = Reports(work)
        work.run(cast(Job, reports))
        return reports

    whole = run(None)
    assert len(whole.entries) == 4 and len(whole.states) > 6
    reported = next(k for k, (told, _) in enumerate(whole.states) if told)
    for k in (reported - 1, reported, -2, -1):
        told, state = whole.states[k]
        again = run(state)
        assert repr(again.entries) == repr(whole.entries[told:])
        for name, weight in whole.work.parameters.items():
            assert torch.equal(again.work.parameters[name], weight)


@pytest.mark.experiment
def test_its_policies_are_evaluated_and_reported_as_ever(
    learned: Path, command: Command, workplace: Path
) -> None:
    result = command("edtorch-eval", f"run={learned}", "episodes=1")
    assert result.status == 0, result.err
    result = command("edtorch-report", str(learned))
    assert result.status == 0, result.err
    assert (workplace / "report" / "report.html").is_file()


LINEAR = (
    "domain=linear",
    "domain.state_matrix=[[1.1,0.2],[-0.1,0.9]]",
    "domain.action_matrix=[[0.0],[0.5]]",
    "domain.noise=0",
    "domain.time_limit=8",
    "model=next_state",
    "fit=least_squares",
    "fit.prior=1e10",
    "reward=quadratic",
    "+reward.state.state_0=1",
    "+reward.action.action_0=0.2",
    "unroll.direction=regulator",
    "step=full",
    "train.successes=null",
    "seeds=2",
    "log.tensorboard=false",
    "log.figures=false",
)


@pytest.mark.long
def test_the_regulator_of_a_linear_system_from_a_file(command: Command, workplace: Path) -> None:
    record = ("noise.exploration=1", "schedule.first=1000000", "train.seconds=40")
    result = command(
        "edtorch-train", *LINEAR, *record, "log.transitions=true", "hydra.run.dir=data"
    )
    assert result.status == 0, result.err
    for name, more in (
        ("own", ["seeds=1", "seed=1"]),
        ("all", ["offline.share=all", "offline.data=[data,data/transitions.npz]", "seed=7"]),
        ("bootstrap", ["offline.share=bootstrap", "offline.order=shuffled", "offline.passes=2"]),
    ):
        result = command(
            "edtorch-train",
            *LINEAR,
            "offline=recorded",
            "offline.data=data",
            "eval.episodes=0",
            *more,
            f"hydra.run.dir={name}",
        )
        assert result.status == 0, result.err
    F = torch.tensor([[1.1, 0.2], [-0.1, 0.9]], dtype=torch.float64)
    G = torch.tensor([[0.0], [0.5]], dtype=torch.float64)
    Q = torch.diag(torch.tensor([1.0, 0.0], dtype=torch.float64))
    R = torch.tensor([[0.2]], dtype=torch.float64)
    wanted = finite_horizon_lqr(F, G, Q, R, steps=30).gains[0]
    for name in ("own", "all", "bootstrap"):
        for found in load_file(workplace / name / "policy.safetensors")["weight"]:
            torch.testing.assert_close(found, wanted, rtol=0, atol=1e-7)


def test_wrong_rows_are_named_or_masked(recorded: Path, command: Command, workplace: Path) -> None:
    with np.load(recorded / "transitions.npz") as file:
        arrays = {name: file[name].copy() for name in file.files}
    arrays["state"][17, 0] = np.nan
    np.savez(workplace / "bad.npz", **arrays)
    arguments = (*LEARN, "offline.data=bad.npz", "eval.episodes=0")
    refused = command("edtorch-train", *arguments)
    assert refused.status == 1
    assert refused.line == (
        "edtorch-train: bad.npz: row 17: state lean is nan, expected a finite number"
    )
    assert [p.name for p in workplace.iterdir()] == ["bad.npz"]
    masked = command("edtorch-train", *arguments, "offline.invalid=mask", "hydra.run.dir=x")
    assert masked.status == 0, masked.err
    assert "masked: bad.npz: row 17: state lean is nan" in masked.err
    summary = _json(workplace / "x" / "summary.json")
    assert len(summary["offline"]["masked"]) == 1
    assert summary["simulated_seconds"] == pytest.approx([15, 15])


# Beside a good offline.data.
REFUSED = [
    (["offline.data=nowhere.npz"], r"nowhere\.npz: no such file"),
    (["offline.data=[]"], r"offline\.data=\[\]: expected a file transitions\.npz"),
    (["offline.data=3"], r"offline\.data=3: expected a file"),
    (["seed=5"], r"offline\.share=own: nothing is recorded of seed 5; .* seeds 1000, 1001"),
    (["offline.share=some"], r"offline\.share=some: expected one of own, all, bootstrap"),
    (["offline.order=up"], r"offline\.order=up: expected one of recorded, shuffled"),
    (["offline.passes=0"], r"offline\.passes=0: expected at least one"),
    (["offline.invalid=keep"], r"offline\.invalid=keep: expected one of refuse, mask"),
    (["+offline.within.x=1"], r"offline\.within\.x=1\.0: expected one of lean, "),
    (["offline.within.handlebar=0"], r"offline\.within\.handlebar=0\.0: expected a number > 0"),
    (
        ["+offline.within.angle_to_goal=1e-9"],
        r"offline: data: seed 1000 has 1500 transitions and none",
    ),
    (["offline.steps=-1"], r"offline\.steps=-1: expected an integer >= 0"),
    (["offline.tolerance=-1"], r"offline\.tolerance=-1\.0: expected a finite number >= 0"),
    (["offline.pases=2"], r"offline\.pases=2: unknown key; did you mean offline\.passes\?"),
    (["offline.variant=tape"], r"offline\.variant=tape: expected one of none, recorded"),
    (["log.transitions=true"], r"log\.transitions=true: expected false with offline=recorded"),
    (["compute.native=on"], r"compute\.native=on: expected auto or off with offline"),
    (["eval.minutes=[1]"], r"offline=recorded: expected eval\.minutes=\[\]"),
    (["rival=random_search"], r"offline=recorded: expected rival=none"),
    (["domain=slalom"], r"meta\.domain=bicycle: expected slalom"),
    (
        ["model=next_state", "domain.dt=0.02", "command=free"],
        r"offline\.data: has transitions of 0\.01 s, expected the domain's 0\.02 s",
    ),
]


@pytest.mark.experiment
@pytest.mark.parametrize(("arguments", "wanted"), REFUSED, ids=lambda v: str(v)[:40])
def test_refuses_with_one_line(
    recorded: Path, command: Command, workplace: Path, arguments: list[str], wanted: str
) -> None:
    result = command("edtorch-train", *LEARN, f"offline.data={recorded}", *arguments)
    assert result.status == 1
    assert re.search(wanted, result.line), result.line
    assert list(workplace.iterdir()) == []


RECORDING_REFUSED = [
    (["seeds=10000", "train.seconds=1e6"], r"log\.transitions=true: 10000 learners of up to .*GiB"),
    (["rival=random_search"], r"log\.transitions=true: expected false with a rival"),
    (
        ["offline=recorded", "offline.data=x"],
        r"log\.transitions=true: expected false with offline=recorded",
    ),
    (["offline.data=x.npz"], r"offline\.data=x\.npz: unknown key"),
]


@pytest.mark.parametrize(("arguments", "wanted"), RECORDING_REFUSED, ids=lambda v: str(v)[:40])
def test_a_recording_that_cannot_be_made_is_refused(
    command: Command, workplace: Path, arguments: list[str], wanted: str
) -> None:
    result = command("edtorch-train", *RECORD, *arguments)
    assert result.status == 1
    assert re.search(wanted, result.line), result.line
    assert list(workplace.iterdir()) == []


def test_offline_without_data_is_refused(command: Command, workplace: Path) -> None:
    result = command("edtorch-train", "experiment=bicycle_offline")
    assert result.status == 1
    assert "offline.data: no value given; set it with offline.data=..." in result.line
