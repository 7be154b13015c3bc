"""Sweeps: no job stops the others, none hides, and a repeated sweep does what is left to do."""

from __future__ import annotations

import csv
import json
import os
import re
import signal
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from omegaconf import OmegaConf

from edtorch.app.launchers import share_cores
from edtorch.app.lock import LOCK
from edtorch.app.sweep_names import hash_of, significant
from edtorch.app.sweep_record import Record
from tests.app.doomed import MENDED, THREADS

Command = Callable[..., Any]
Start = Callable[..., "subprocess.Popen[str]"]

ROOT = Path(__file__).parents[2]
TINY = (
    "domain=linear",
    "domain._target_=tests.app.doomed.Doomed",
    "model=next_state",
    "reward=quadratic",
    "+reward.state.state_0=1",
    "seeds=2",
    "train.seconds=200",
    "train.successes=null",
    "eval.episodes=1",
    "log.tensorboard=false",
    "log.figures=false",
    "log.progress=false",
    "log.checkpoint_wall=0",
    "compute.native=off",
)
"""A job of a tenth of a second, in a world that may not last."""
TIMES = ("wall_s", "cpu_s", "startup_s", "eval_s", "figures_s", "ticks_per_cpu_s", "command")


def _json(path: Path) -> Any:
    return json.loads(path.read_text())


def _results(folder: Path) -> dict[str, Any]:
    """What a job found, without how long that took."""
    return {key: value for key, value in _json(folder / "summary.json").items() if key not in TIMES}


def _jobs(sweep: Path, key: str = "domain.how") -> dict[str, dict[str, str]]:
    """The rows of ``sweep.csv`` by the value of a setting."""
    with (sweep / "sweep.csv").open(newline="") as file:
        return {row[key]: row for row in csv.DictReader(file)}


def _stamps(folder: Path) -> dict[str, tuple[int, bytes]]:
    return {
        path.name: (path.stat().st_mtime_ns, path.read_bytes())
        for path in folder.rglob("*")
        if path.is_file()
    }


class TestNames:
    def test_order_and_signs_do_not_matter(self) -> None:
        assert hash_of(["a.b=1", "+c=2"]) == hash_of(["c=2", "++a.b=1"])
        assert hash_of(["a.b=1"]) != hash_of(["a.b=2"])

    def test_what_changes_no_result_does_not_matter(self) -> None:
        others = ["sweep.name=x", "++sweep.retry=true", "debug=true", "log.progress=false"]
        others += ["hydra/launcher=joblib", "hydra.launcher.n_jobs=2"]
        assert significant(["seed=1", *others, "~train"]) == ["seed=1", "~train"]

    def test_is_stable(self) -> None:
        """Sweeps of yesterday are found again."""
        assert hash_of(["step.alpha=0.1", "seed=1"]) == "b5d76b8c65"


class TestAsTyped:
    """A job in another process speaks of its settings as the user did."""

    def test_former_names_and_values_of_its_own(self) -> None:
        sweep = Record(("noise.exploration=0.1,0.2", "+reward.state.lean=1", "step=fast,plain"))
        job = ["++exploration.deviation=0.2", "++reward.state.lean=1", "step=fast", "~train"]
        wanted = ["noise.exploration=0.2", "+reward.state.lean=1", "step=fast", "~train"]
        assert sweep.as_typed(job) == wanted

    def test_options_that_were_written_out(self) -> None:
        written = "policy={_target_: my.MLP, hidden: 32}"
        sweep = Record((written, "seed=1,2"))
        assert sweep.as_typed(["policy=written_out", "seed=2"]) == [written, "seed=2"]


@pytest.mark.experiment
def test_a_job_neither_stops_the_others_nor_hides(command: Command, workplace: Path) -> None:
    result = command(
        "edtorch-train", "-m", *TINY, "sweep.name=a", "+domain.how=refuse,fine,defect,well"
    )
    sweep = workplace / "runs/sweeps/a"
    jobs = _jobs(sweep)
    assert result.status == 1
    assert {how: job["status"] for how, job in jobs.items()} == {
        "refuse": "failed",
        "fine": "done",
        "defect": "failed",
        "well": "done",
    }
    header, refused, defect, line = result.err.splitlines()[-4:]
    assert header.split() == ["job", "settings", "status"]
    why = "failed: domain.how=refuse: expected another fate"
    assert refused == f"{jobs['refuse']['folder']}  domain.how=refuse  {why}"
    assert defect.startswith(f"{jobs['defect']['folder']}  domain.how=defect  failed: RuntimeError")
    assert line == f"edtorch-train: of 4 jobs 2 failed, 2 done: {sweep / 'sweep.csv'}"
    assert f"edtorch-train: {sweep / jobs['refuse']['folder']}: domain.how=refuse" in result.err
    assert "Traceback" in result.err  # of the defect

    refused_folder = sweep / jobs["refuse"]["folder"]
    assert {path.name for path in refused_folder.iterdir()} == {"job.json", "status.json"}
    assert (
        _json(refused_folder / "status.json")["why"] == "domain.how=refuse: expected another fate"
    )
    done = sweep / jobs["fine"]["folder"]
    assert "domain.how=fine" in _json(done / "job.json")["overrides"]
    assert done.name == hash_of(_json(done / "job.json")["overrides"])
    median = _json(done / "summary.json")["return"]["median"]
    assert float(jobs["fine"]["summary/return"]) == median


@pytest.mark.experiment
def test_a_repeated_sweep_does_what_is_left(command: Command, workplace: Path) -> None:
    sweep, how = workplace / "runs/sweeps/a", "+domain.how=refuse,fine,defect"
    command("edtorch-train", "-m", *TINY, "sweep.name=a", how)
    folders = {how: sweep / job["folder"] for how, job in _jobs(sweep).items()}
    before = {how: _stamps(folder) for how, folder in folders.items()}

    # In another order, and with settings that change no result.
    again = command("edtorch-train", "-m", how, "debug=true", "sweep.name=a", *reversed(TINY))
    assert again.status == 1
    assert {how: _stamps(folder) for how, folder in folders.items()} == before
    assert "of 3 jobs 2 failed, 1 done" in again.err.splitlines()[-1]
    assert "failed: domain.how=refuse: expected another fate" in again.err

    (workplace / MENDED).touch()
    retried = command("edtorch-train", "-m", *TINY, how, "sweep.name=a", "sweep.retry=true")
    assert retried.status == 0, retried.err
    assert _stamps(folders["fine"]) == before["fine"]
    assert f"3 jobs done: {sweep / 'sweep.csv'}" in retried.out.splitlines()

    undisturbed = command("edtorch-train", "-m", *TINY, how, "sweep.name=b")
    assert undisturbed.status == 0, undisturbed.err
    for folder in folders.values():
        assert _results(folder) == _results(workplace / "runs/sweeps/b" / folder.name)


@pytest.mark.experiment
def test_a_job_that_another_process_is_at(command: Command, workplace: Path) -> None:
    """It is left to that, and told."""
    arguments = ("edtorch-train", "-m", *TINY, "sweep.name=a", "+domain.how=defect,fine")
    command(*arguments)
    sweep = workplace / "runs/sweeps/a"
    folder = sweep / _jobs(sweep)["defect"]["folder"]
    (folder / "status.json").write_text('{"status": "running", "why": null}')
    (folder / LOCK).write_text('{"host": "elsewhere", "pid": 1}')
    before = _stamps(folder)
    result = command(*arguments)
    assert result.status == 1
    assert "of 2 jobs 1 running, 1 done" in result.err.splitlines()[-1]
    assert "running: in use by process 1 on elsewhere" in result.err
    assert _stamps(folder) == before


@pytest.mark.experiment
def test_without_a_name(command: Command, workplace: Path) -> None:
    """Folders by number, in a new folder; they have a table as well."""
    arguments = ("edtorch-train", "-m", *TINY, "step.alpha=0.1,0.2", "hydra.sweep.dir=s")
    assert command(*arguments).status == 0
    jobs = _jobs(workplace / "s", "step.alpha")
    assert {alpha: job["folder"] for alpha, job in jobs.items()} == {"0.1": "0", "0.2": "1"}
    before = _stamps(workplace / "s/0")
    again = command(*arguments)
    assert again.status == 1
    assert again.line.startswith("edtorch-train: hydra.sweep.dir=s: already holds a sweep")
    assert _stamps(workplace / "s/0") == before


@pytest.mark.experiment
def test_a_run_that_is_there_is_left_alone(command: Command, workplace: Path) -> None:
    assert command("edtorch-train", *TINY, "hydra.run.dir=s/0").status == 0
    before = _stamps(workplace / "s/0")
    result = command("edtorch-train", "-m", *TINY, "step.alpha=0.1,0.2", "hydra.sweep.dir=s")
    assert result.status == 1
    assert "0 already holds a run" in result.err
    assert _stamps(workplace / "s/0") == before
    assert _jobs(workplace / "s", "step.alpha")["0.2"]["status"] == "done"


def test_the_name_of_another_sweep(command: Command, workplace: Path) -> None:
    assert command("edtorch-train", "-m", *TINY, "sweep.name=a", "seed=1").status == 0
    result = command("edtorch-train", "-m", *TINY, "sweep.name=a", "seed=1,2")
    assert result.status == 1
    assert result.line == (
        f"edtorch-train: sweep.name=a: {workplace / 'runs/sweeps/a'} holds a sweep with other"
        " settings (seed=1,2 here, seed=1 there); expected the same, or another name"
    )


def test_a_sweep_that_was_refused_can_be_put_right(command: Command, workplace: Path) -> None:
    """Its name is not taken by jobs that have not come to a run."""
    refused = command("edtorch-train", "-m", *TINY, "sweep.name=a", "step.alpa=1,2")
    assert refused.status == 1
    assert "step.alpa=1: unknown key; did you mean step.alpha?" in refused.err
    assert "of 2 jobs 2 failed" in refused.err.splitlines()[-1]
    right = command("edtorch-train", "-m", *TINY, "sweep.name=a", "step.alpha=0.1,0.2")
    assert right.status == 0, right.err
    assert _jobs(workplace / "runs/sweeps/a", "step.alpha").keys() == {"0.1", "0.2"}


@pytest.mark.parametrize(
    ("name", "content", "wanted"),
    [
        ("notes.txt", "", "expected a new folder or one of a sweep, but .* holds notes.txt and no"),
        ("sweep.json", "{", "sweep.json: expected the record of a sweep"),
        ("sweep.json", '{"format": 2, "overrides": []}', "in format 1, not 2"),
    ],
)
def test_a_folder_that_is_not_of_a_sweep(
    command: Command, workplace: Path, name: str, content: str, wanted: str
) -> None:
    folder = workplace / "runs/sweeps/a"
    folder.mkdir(parents=True)
    (folder / name).write_text(content)
    result = command("edtorch-train", "-m", *TINY, "sweep.name=a")
    assert result.status == 1
    assert re.search(wanted, result.line), result.line
    assert [path.name for path in folder.iterdir()] == [name]


def test_a_machine_without_slurm(
    command: Command, workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("PATH", str(workplace))
    result = command("edtorch-train", "-m", *TINY, "hydra/launcher=slurm")
    assert result.status == 1
    assert result.line == (
        "edtorch-train: hydra/launcher=slurm: expected a machine with SLURM, but srun is not in the"
        " PATH"
    )
    assert list(workplace.iterdir()) == []


@pytest.mark.long
@pytest.mark.experiment
def test_a_scheduler_that_refuses(
    sweep_of: Callable[..., tuple[int, str]], workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What it says is told; the sweep can be submitted again."""
    for name, lines in (("srun", ""), ("sbatch", "echo sbatch: invalid partition >&2; exit 1")):
        (workplace / name).write_text(f"#!/bin/sh\n{lines}\n")
        (workplace / name).chmod(0o755)
    monkeypatch.setenv("PATH", f"{workplace}{os.pathsep}{os.environ['PATH']}")
    status, err = sweep_of("slurm", "seed=1,2")
    assert status == 1
    assert "sbatch: invalid partition" in err.splitlines()[-1]
    assert "of 2 jobs 2 not begun" in err.splitlines()[-1]
    assert sweep_of("local", "seed=1,2")[0] == 0


@pytest.mark.experiment
def test_a_report_of_a_sweep(command: Command, workplace: Path) -> None:
    """Its best setting is the one whose summary says so; what is not done is said."""
    command("edtorch-train", "-m", *TINY, "sweep.name=a", "step.alpha=0.01,0.1,-1")
    result = command("edtorch-report", "runs/sweeps/a")
    assert result.status == 0, result.err
    told = _json(workplace / "report/report.json")
    (sweep,) = told["sweeps"]
    assert [job["status"] for job in sweep["jobs"]] == ["done", "done", "failed"]
    (section,) = sweep["sections"]
    assert section["axes"] == {"step.alpha": ["-1", "0.01", "0.1"]}
    assert {each["settings"]["step.alpha"] for each in section["ranked"]} == {"0.01", "0.1"}
    page = (workplace / "report/report.html").read_text()
    assert "3 jobs in runs/sweeps/a: 2 done, 1 failed" in page
    assert "step.alpha=-1.0: expected a number &gt;= 0" in page
    assert (workplace / "report/sweep_a_doomed_learners.png").exists()


def test_launchers_are_limited() -> None:
    """Cores are shared out among jobs at a time and their threads."""
    cores = len(os.sched_getaffinity(0))
    for threads, jobs in ((1, cores), (cores, 1), (2 * cores, 1)):
        joblib = OmegaConf.create({"_target_": "JoblibLauncher", "n_jobs": -1})
        assert share_cores(joblib, threads)["OMP_NUM_THREADS"] == str(threads)
        assert joblib.n_jobs == jobs
    chosen = OmegaConf.create({"_target_": "JoblibLauncher", "n_jobs": 3})
    share_cores(chosen, 1)
    assert chosen.n_jobs == 3


@pytest.fixture
def sweep_of(start: Start, workplace: Path, patience: float) -> Callable[..., tuple[int, str]]:
    """Runs a sweep as a process of its own: exit status, and stderr."""

    def swept(launcher: str, *arguments: str, name: str = "a") -> tuple[int, str]:
        process = start(
            *("edtorch-train", "-m", *TINY, f"sweep.name={name}", f"hydra/launcher={launcher}"),
            *arguments,
            PYTHONPATH=str(ROOT),
            PYTHONWARNINGS="ignore",
        )
        _, err = process.communicate(timeout=patience)
        return process.returncode, err

    return swept


@pytest.mark.experiment
@pytest.mark.parametrize(
    "launcher", ["joblib", pytest.param("submitit_local", marks=pytest.mark.long)]
)
def test_in_processes_of_their_own(
    sweep_of: Callable[..., tuple[int, str]], command: Command, workplace: Path, launcher: str
) -> None:
    """Jobs come to what they come to in one process, and end in the same lines."""
    how = "+domain.how=refuse,fine,defect,well"
    status, err = sweep_of(launcher, how, "compute.threads=2")
    assert status == 1
    assert (workplace / THREADS).read_text() == "2"
    alone = command("edtorch-train", "-m", *TINY, how, "compute.threads=2", "sweep.name=b")
    here, there = (workplace / "runs/sweeps" / name for name in "ab")
    assert err.splitlines()[-4:-1] == alone.err.splitlines()[-4:-1]
    for job in _jobs(here).values():
        if job["status"] == "done":
            assert _results(here / job["folder"]) == _results(there / job["folder"])


@pytest.mark.experiment
@pytest.mark.long
@pytest.mark.parametrize("launcher", ["joblib", "submitit_local"])
def test_a_job_that_is_killed(
    sweep_of: Callable[..., tuple[int, str]], workplace: Path, launcher: str
) -> None:
    """The launcher gives up; what its jobs came to is told all the same."""
    how = "+domain.how=fine,kill"
    status, err = sweep_of(launcher, how)
    assert status == 1
    sweep = workplace / "runs/sweeps/a"
    jobs = _jobs(sweep)
    assert jobs["kill"]["status"] == "unfinished"
    assert "edtorch-train: the launcher has stopped (" in err.splitlines()[-1]
    assert f"{jobs['kill']['folder']}  domain.how=kill  unfinished: ended without" in err
    if launcher == "submitit_local":
        assert jobs["fine"]["status"] == "done"
    (workplace / MENDED).touch()
    assert sweep_of(launcher, how)[0] == 0
    assert "resumed" in _json(sweep / jobs["kill"]["folder"] / "run.json")
    assert sweep_of("basic", how, name="b")[0] == 0
    for path in sweep.glob("*/summary.json"):
        other = sweep.parent / "b" / path.parent.name
        assert _results(path.parent) == _results(other)
        for name in ("metrics.csv", "episodes.csv", "policy.safetensors"):
            assert path.with_name(name).read_bytes() == (other / name).read_bytes()


@pytest.mark.long
def test_six_of_twenty_four_are_killed(
    sweep_of: Callable[..., tuple[int, str]], workplace: Path
) -> None:
    """Repeated once, the sweep has done all but two that fail whenever they are tried."""
    hows = [*(f"kill{k}" for k in range(6)), "defect0", "refuse0"]
    hows += [f"fine{k}" for k in range(16)]
    how = f"+domain.how={','.join(hows)}"
    assert sweep_of("submitit_local", how)[0] == 1
    sweep, other = (workplace / "runs/sweeps" / name for name in "ab")
    assert Counter(job["status"] for job in _jobs(sweep).values()) == {
        "done": 16,
        "failed": 2,
        "unfinished": 6,
    }
    (workplace / MENDED).write_text("kill")
    status, err = sweep_of("submitit_local", how)
    assert status == 1
    assert "of 24 jobs 22 done, 2 failed" in err.splitlines()[-1]
    assert sweep_of("basic", how, name="b")[0] == 1
    for name, job in _jobs(other).items():
        assert (job["status"] == "failed") == (name in ("defect0", "refuse0"))
        if job["status"] == "done":
            assert _results(sweep / job["folder"]) == _results(other / job["folder"])


@pytest.mark.long
@pytest.mark.experiment
@pytest.mark.parametrize(
    ("launcher", "one_at_a_time"),
    [("basic", ()), ("joblib", ("hydra.launcher.n_jobs=1", "hydra.launcher.pre_dispatch=1"))],
    ids=["basic", "joblib"],
)
def test_ctrl_c_stops_the_sweep(
    start: Start, workplace: Path, patience: float, launcher: str, one_at_a_time: tuple[str, ...]
) -> None:
    process = start(
        *("edtorch-train", "-m", *TINY, "sweep.name=a", f"hydra/launcher={launcher}"),
        *("+domain.how=fine,wait,well", *one_at_a_time),
        PYTHONPATH=str(ROOT),
        PYTHONWARNINGS="ignore",
    )
    deadline = time.monotonic() + patience
    while not (workplace / "waiting").exists():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    _, err = process.communicate(timeout=patience)
    assert process.returncode == 130
    assert "Traceback" not in err
    jobs = _jobs(workplace / "runs/sweeps/a")
    assert jobs["fine"]["status"] == "done"
    assert jobs["wait"]["status"] in ("interrupted", "unfinished")
    assert jobs["well"]["status"] == "not begun"


@pytest.fixture
def bare(tmp_path: Path) -> Path:
    """All packages that are installed, but for those of the extra ``sweep``."""
    site = tmp_path / "bare"
    site.mkdir()
    import torch

    for path in Path(torch.__file__).parents[1].iterdir():
        if not path.name.startswith(("hydra_plugins", "joblib", "submitit")):
            (site / path.name).symlink_to(path)
    return site


LAUNCHERS = {
    "joblib": "hydra-joblib-launcher",
    "submitit_local": "hydra-submitit-launcher",
    "slurm": "hydra-submitit-launcher",
}
WITH_EACH = f"""
import sys
from edtorch.app.train import main
for launcher in {list(LAUNCHERS)}:
    sys.argv = ["edtorch-train", "-m", f"hydra/launcher={{launcher}}", "seed=1,2"]
    try:
        main()
    except SystemExit as end:
        assert end.code == 1
"""


@pytest.mark.oracle
def test_a_launcher_that_is_not_installed(bare: Path) -> None:
    folder = bare.parent / "work"
    folder.mkdir()
    done = subprocess.run(
        [sys.executable, "-S", "-c", WITH_EACH],
        cwd=folder,
        env=os.environ | {"PYTHONPATH": f"{ROOT}:{bare}"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr.splitlines() == [
        f"edtorch-train: hydra/launcher={launcher.replace('slurm', 'submitit_slurm')}: {package} is"
        ' not installed; pip install "edtorch[sweep]" brings it'
        for launcher, package in LAUNCHERS.items()
    ]
    assert list(folder.iterdir()) == []
