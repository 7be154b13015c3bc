"""A run that was broken off goes on as if it had not been: ``edtorch-train resume=RUN``."""

from __future__ import annotations

import itertools
import json
import os
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest

import edtorch
from edtorch.app import job, learners, rundir
from edtorch.app.job import Job
from studies.same_runs import differences

Command = Callable[..., Any]
QUIET = ("log.figures=false", "log.checkpoint_wall=0", "log.every=1", "log.checkpoints=3")
LINEAR = (
    *("domain=linear", "reward=quadratic", "+reward.state.state_0=1", "domain.dt=0.1"),
    *("seeds=2", "train.seconds=30", "train.successes=null", "eval.episodes=2"),
    *("compute.native=off", *QUIET),
)
BICYCLE = ("seeds=3", "train.seconds=9", "train.successes=null", "eval.episodes=1", *QUIET)
PENDULUM = (
    *("experiment=regulation", "domain=gymnasium", "domain.env_id=Pendulum-v1", "domain.dt=0.05"),
    *("train.seconds=25", "seeds=2", "eval.episodes=1", "compute.native=off", *QUIET),
)
PLANNED = (
    *("experiment=pendulum_swingup", "seeds=2", "train.episodes=4", "eval.episodes=5"),
    *("+eval.solved.mean_return=1000", "search.starts=2", "search.draws=10", *QUIET),
    *("domain.sim.time_limit=1", "domain.sim.hold_from=0.8"),
)
KINDS = {
    "linear": (*LINEAR, "eval.minutes=[0.25]", "eval.keep=1"),
    "uncompiled": (*BICYCLE, "compute.native=off", "eval.minutes=[0.1]"),
    "compiled": (*BICYCLE, "eval.minutes=[0.1]"),
    "recorded": (*BICYCLE, "log.transitions=true"),
    "Gymnasium": PENDULUM,
    "planned": PLANNED,
    "stationary": (*PLANNED, "search.policy=stationary", "search.horizon=0.8"),
    "gradient": (
        *("experiment=pendulum_swingup", "seeds=2", "train.episodes=4", "eval.episodes=5"),
        *("search=gradient", "search/policy=rbf", "search/improver=adam", "search.draws=5"),
        *("search.policy.centres=4", "search.improver.steps=2", "search.restarts=2"),
        *("search.improver.belief=cubature", "search.horizon=1", "fit.passes=1"),
        *("+eval.solved.mean_return=1000", *QUIET),
    ),
    "rival": (
        *("experiment=bicycle_adaptive_lqr", "seeds=1", "train.seconds=12", "rival.piece=2"),
        *("train.until=null", "eval.episodes=1", "domain.time_limit=10", *QUIET),
    ),
    "offline": (
        *("experiment=bicycle_offline", "seeds=2", "offline.share=all", "offline.steps=200"),
        *("offline.improve=true", "eval.episodes=1", "eval.minutes=[]", *QUIET),
    ),
}

OFTEN = ("linear", "compiled", "planned", "rival")
"""The kinds that every commit is checked with."""


def _interrupted(
    command: Command, monkeypatch: pytest.MonkeyPatch, times: int, *arguments: str
) -> Any:
    """A run that is asked to stop when its state is whole for the so-manieth time."""
    whole, calls = Job.whole, itertools.count(1)

    def one(self: Job) -> None:
        if next(calls) == times:
            os.kill(os.getpid(), signal.SIGTERM)
        whole(self)

    with monkeypatch.context() as patch:
        patch.setattr(Job, "whole", one)
        return command("edtorch-train", *arguments)


def _checkpoints(folder: Path) -> list[Path]:
    return sorted((folder / "checkpoints").iterdir())


@pytest.fixture(autouse=True)
def often(monkeypatch: pytest.MonkeyPatch) -> None:
    """States are saved wherever they can be, whatever that costs."""
    monkeypatch.setattr(job, "CHECKPOINT_SHARE", 1e9)


def _arguments(kind: str, command: Command, workplace: Path) -> tuple[str, ...]:
    if kind != "offline":
        return KINDS[kind]
    falls = ("experiment=bicycle_random_falls", "seeds=2", "train.seconds=15")
    command("edtorch-train", *falls, "log.figures=false", "hydra.run.dir=falls")
    return (*KINDS[kind], f"offline.data={workplace / 'falls'}")


@pytest.mark.experiment
@pytest.mark.parametrize(
    "kind", [k if k in OFTEN else pytest.param(k, marks=pytest.mark.long) for k in KINDS]
)
def test_a_run_that_was_broken_off_twice_is_the_same_run(
    kind: str,
    command: Command,
    workplace: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Once where it was asked to stop, once as by SIGKILL, after its last checkpoint."""
    whole, arguments = workplace / "whole", _arguments(kind, command, workplace)
    assert command("edtorch-train", *arguments, "hydra.run.dir=whole").status == 0
    result = _interrupted(command, monkeypatch, 4, *arguments, "hydra.run.dir=cut")
    assert result.status == 130 and "interrupted; saved in" in result.err
    folder = workplace / "cut"
    assert len(_checkpoints(folder)) == 3
    _checkpoints(folder)[-1].unlink()
    assert _interrupted(command, monkeypatch, 3, "resume=cut").status == 130
    assert json.loads((folder / "status.json").read_text())["status"] == "interrupted"
    result = command("edtorch-train", "resume=cut")
    assert result.status == 0, result.err
    assert "going on from" in result.out
    assert differences(whole, folder) == []
    about = json.loads((folder / "run.json").read_text())
    assert len(about["resumed"]) == 2 and about["resumed"][-1]["command"].endswith("resume=cut")
    assert not (folder / "run.lock").exists()


@pytest.fixture
def cut(command: Command, workplace: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A run of the linear system that was interrupted."""
    _interrupted(command, monkeypatch, 15, *LINEAR, "hydra.run.dir=cut")
    return workplace / "cut"


def _files(folder: Path) -> dict[Path, bytes]:
    return {path: path.read_bytes() for path in folder.rglob("*") if path.is_file()}


def _refused(command: Command, folder: Path, *arguments: str) -> str:
    """The line by which going on is refused; the folder must stay as it is."""
    before = _files(folder)
    result = command("edtorch-train", f"resume={folder}", *arguments)
    assert result.status == 1, result.out
    assert _files(folder) == before
    return result.err.splitlines()[-1]


def test_a_complete_run_stays_as_it_is(command: Command, workplace: Path) -> None:
    command("edtorch-train", *LINEAR, "hydra.run.dir=x")
    before = _files(workplace / "x")
    result = command("edtorch-train", "resume=x", "log.progress=false")
    assert result.status == 0 and "is complete: nothing is left to do" in result.out
    assert _files(workplace / "x") == before


def test_a_larger_budget_gives_the_run_that_had_it_from_the_beginning(
    command: Command, workplace: Path, cut: Path
) -> None:
    """Of complete runs as of others, and though the reports of an end are not those of a way."""
    command("edtorch-train", *LINEAR, "train.seconds=45", "hydra.run.dir=long")
    command("edtorch-train", *LINEAR, "train.seconds=17.3", "hydra.run.dir=short")
    for folder in ("short", "cut"):
        assert command("edtorch-train", f"resume={folder}", "train.seconds=45").status == 0
        assert differences(workplace / "long", workplace / folder) == []
    assert "train.seconds=5: expected at least the 45 s" in _refused(
        command, workplace / "long", "train.seconds=5"
    )


def test_what_cannot_change_is_named_with_what_can(command: Command, cut: Path) -> None:
    line = _refused(command, cut, "unroll.horizon=7")
    assert "unroll.horizon=7: cannot be another in a run that goes on" in line
    assert "train.seconds" in line and "log.checkpoint_wall" in line
    assert "log.checkpoint=3: was removed" in _refused(command, cut, "log.checkpoint=3")
    assert ": train.seconds=1,2: expected KEY=VALUE" in _refused(command, cut, "train.seconds=1,2")
    line = _refused(command, cut, "train.seconds=soon")
    assert "train.seconds=soon" in line and "config.yaml" not in line
    assert "resume: expected it once" in _refused(command, cut, "resume=another")
    assert "-m: expected none with resume=RUN" in _refused(command, cut, "-m")
    assert "nonsense=1: cannot be another" in _refused(command, cut, "nonsense=1")


def test_before_the_first_checkpoint_a_run_begins_at_tick_0(
    command: Command, workplace: Path, cut: Path
) -> None:
    shutil.rmtree(cut / "checkpoints")
    assert "has no checkpoint in" in _refused(command, cut)  # there was one: rows came after it
    metrics = cut / "metrics.csv"
    metrics.write_bytes(metrics.read_bytes().splitlines(keepends=True)[0])
    result = command("edtorch-train", "resume=cut")
    assert result.status == 0 and "has no checkpoint: it begins at tick 0" in result.out
    command("edtorch-train", *LINEAR, "hydra.run.dir=whole")
    assert differences(workplace / "whole", cut) == []


def test_a_damaged_checkpoint_is_said_and_the_one_before_taken(
    command: Command, workplace: Path, cut: Path
) -> None:
    *_, last = _checkpoints(cut)
    last.write_bytes(last.read_bytes()[:-100])
    result = command("edtorch-train", "resume=cut")
    assert result.status == 0, result.err
    assert f"{last.name}: damaged" in result.err and "the one before" in result.err
    command("edtorch-train", *LINEAR, "hydra.run.dir=whole")
    assert differences(workplace / "whole", cut) == []


def test_a_run_without_a_whole_checkpoint_is_refused(command: Command, cut: Path) -> None:
    for path in _checkpoints(cut):
        path.write_bytes(path.read_bytes()[:50])
    assert "damaged" in _refused(command, cut)


def test_half_of_a_run_is_refused(command: Command, cut: Path) -> None:
    metrics = cut / "metrics.csv"
    metrics.write_bytes(metrics.read_bytes()[:60])
    line = _refused(command, cut)
    assert "metrics.csv: has 60 bytes, expected at least" in line and "half of the run" in line


def test_a_checkpoint_of_another_run_is_refused(
    command: Command, workplace: Path, cut: Path
) -> None:
    command("edtorch-train", *LINEAR, "unroll.horizon=7", "hydra.run.dir=other")
    shutil.rmtree(cut / "checkpoints")
    shutil.copytree(workplace / "other" / "checkpoints", cut / "checkpoints")
    for name in ("metrics.csv", "episodes.csv"):
        shutil.copy(workplace / "other" / name, cut / name)
    for path in (workplace / "other").glob("events*"):
        shutil.copy(path, cut)
    assert "made with unroll.horizon=7, but the run has unroll.horizon=30" in _refused(command, cut)


def test_what_is_no_run_is_refused(command: Command, workplace: Path) -> None:
    (workplace / "empty").mkdir()
    assert (
        "run=empty: expected the folder of a run" in command("edtorch-train", "resume=empty").line
    )
    assert "does not exist" in command("edtorch-train", "resume=missing").line
    assert "resume=: expected the folder of a run" in command("edtorch-train", "resume=").line
    assert sorted(path.name for path in workplace.iterdir()) == ["empty"]


@pytest.mark.parametrize(("written", "again"), [(1, "hydra.run.dir=x"), (2, "resume=x")])
def test_a_run_that_was_broken_off_as_it_began(
    command: Command, monkeypatch: pytest.MonkeyPatch, written: int, again: str
) -> None:
    """With its configuration it is a run, which has all that going on needs."""
    write, left = rundir.write_text, [None] * written

    def until_the_end(path: Path, text: str) -> None:
        if not left:
            raise KeyboardInterrupt
        left.pop()
        write(path, text)

    arguments = [*LINEAR, "train.seconds=5"]
    with monkeypatch.context() as patch:
        patch.setattr(rundir, "write_text", until_the_end)
        assert command("edtorch-train", *arguments, "hydra.run.dir=x").status == 130
    result = command("edtorch-train", *(arguments if written == 1 else ()), again)
    assert result.status == 0, result.err


def test_a_run_of_an_earlier_version_is_refused(command: Command, cut: Path) -> None:
    shutil.rmtree(cut / "checkpoints")
    (cut / "checkpoint.pt").write_bytes(b"state of some kind")
    assert "was made by an earlier version" in _refused(command, cut)


def test_kernels_that_are_not_there_any_more_are_not_replaced_in_silence(
    command: Command, workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    arguments = [each for each in LINEAR if each != "compute.native=off"]
    _interrupted(command, monkeypatch, 9, *arguments, "hydra.run.dir=cut")

    monkeypatch.setattr(learners, "into_kernels", lambda *parts: "uncompiled")
    line = _refused(command, workplace / "cut")
    assert "was compiled, but here the run would be uncompiled" in line


def _hold(folder: Path, **holder: object) -> None:
    content = {"host": socket.gethostname(), "pid": 1, "started": None, "slurm_job": None} | holder
    (folder / "run.lock").write_text(json.dumps(content))


def test_two_processes_do_not_write_to_one_folder(command: Command, cut: Path) -> None:
    with subprocess.Popen([sys.executable, "-c", "import time; time.sleep(60)"]) as other:
        fields = Path(f"/proc/{other.pid}/stat").read_text().rpartition(")")[2].split()
        _hold(cut, pid=other.pid, started=fields[19])
        line = _refused(command, cut)
        assert f"in use by process {other.pid} on {socket.gethostname()}" in line
        _hold(cut, pid=other.pid, started="another process of this number")
        assert command("edtorch-train", "resume=cut").status == 0
        other.kill()


def test_the_lock_of_another_machine_holds_as_long_as_that_gives_signs_of_life(
    command: Command, cut: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    _hold(cut, host="elsewhere", slurm_job="17")
    assert "in use by process 1 on elsewhere" in _refused(command, cut)
    monkeypatch.setenv("SLURM_JOB_ID", "18")
    assert "in use by process 1 on elsewhere" in _refused(command, cut)
    with monkeypatch.context() as patch:
        patch.setenv("SLURM_JOB_ID", "17")  # started again on another node
        assert _interrupted(command, patch, 3, "resume=cut").status == 130
    _hold(cut, host="elsewhere")
    long_ago = time.time() - 700
    os.utime(cut / "run.lock", (long_ago, long_ago))
    assert command("edtorch-train", "resume=cut").status == 0


def test_a_disk_that_takes_no_checkpoint_stops_no_learning(
    command: Command, workplace: Path
) -> None:
    """Simulated by a file in the place of the checkpoint folder."""
    (workplace / "x").mkdir()
    (workplace / "x" / "checkpoints").write_text("no folder")
    result = command("edtorch-train", *LINEAR, "hydra.run.dir=x")
    assert result.status == 0
    assert result.err.count("the state could not be saved") == 1
    assert (workplace / "x" / "checkpoints").read_text() == "no folder"
    assert json.loads((workplace / "x" / "status.json").read_text())["status"] == "done"


@pytest.mark.parametrize("content", ["[]", "{", None])
def test_a_record_that_is_none_is_refused(command: Command, cut: Path, content: str | None) -> None:
    (cut / "run.json").unlink()
    if content is not None:
        (cut / "run.json").write_text(content)
    assert "run.json: expected the record of a run" in _refused(command, cut)


def test_runs_of_python_go_on_whatever_they_were_given(workplace: Path) -> None:
    """Settings that ``learn`` leaves to their defaults are in no checkpoint."""
    own = ["eval.episodes=1", "log.figures=false"]
    learn = partial(edtorch.learn, "Pendulum-v1", dt=0.05, overrides=own, progress=False)
    learn(seconds=2.0, save=workplace / "short")
    learn(seconds=4.0, save=workplace / "long")
    edtorch.load(workplace / "short").resume(seconds=4.0, progress=False)
    assert differences(workplace / "long", workplace / "short") == []


def test_code_of_others_is_only_run_when_trusted(
    command: Command, workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (workplace / "mine_of_resume.py").write_text(
        "from sims.linear import LinearSystem\n\n\nclass Mine(LinearSystem):\n    pass\n"
    )
    monkeypatch.syspath_prepend(str(workplace))
    own = (*LINEAR, "domain._target_=mine_of_resume.Mine", "hydra.run.dir=own")
    _interrupted(command, monkeypatch, 9, *own)
    line = _refused(command, workplace / "own")
    assert "domain._target_=mine_of_resume.Mine" in line and "trust=['mine_of_resume']" in line
    result = command("edtorch-train", "resume=own", "trust=[mine_of_resume]")
    assert result.status == 0, result.err
    result = command("edtorch-eval", "run=own", "episodes=1")
    assert result.status == 1 and "trust=['mine_of_resume']" in result.line
    assert command("edtorch-eval", "run=own", "episodes=1", "trust=[mine_of_resume]").status == 0


def test_in_python(command: Command, workplace: Path, cut: Path) -> None:
    command("edtorch-train", *LINEAR, "hydra.run.dir=whole")
    run = edtorch.load(cut).resume(progress=False)
    assert not run.interrupted and differences(workplace / "whole", cut) == []
    own = ["domain=linear", "domain.dt=0.1", "train.successes=null", "eval.episodes=2"]
    own += ["compute.native=off", "log.figures=false"]
    learn = partial(edtorch.learn, overrides=own, progress=False)
    short = learn(seconds=10.0, save=workplace / "short")
    learn(seconds=20.0, save=workplace / "long")
    longer = short.resume(seconds=20.0, progress=False)
    assert longer.folder == workplace / "short"
    assert differences(workplace / "long", workplace / "short") == []
    with pytest.raises(ValueError, match=r"seconds=10: expected at least the 20 s"):
        longer.resume(seconds=10.0, progress=False)
    with pytest.raises(ValueError, match="save it first"):
        learn(seconds=1.0).resume()
