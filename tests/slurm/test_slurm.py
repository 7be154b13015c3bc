"""Runs on a real SLURM: requeued, pre-empted, killed, out of time.  All end with the digits of runs
that nobody has disturbed.

``make test-slurm`` runs these.
"""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from studies.same_runs import differences
from tests.slurm.cluster import Cluster, started, why_not

pytestmark = [
    pytest.mark.slurm,
    pytest.mark.skipif(why_not() is not None, reason=str(why_not())),
]

ROOT = Path(__file__).parents[2]
TRAIN = Path(sys.executable).with_name("edtorch-train")
PATIENCE = 600.0
"""Seconds after which what has not happened will not."""
RIDES = (
    *("experiment=bicycle", "seeds=2", "train.seconds=60000", "train.successes=null"),
    *("eval.episodes=2", "log.every=50", "log.checkpoint_wall=1"),
    *("log.figures=false", "log.progress=false"),
)
"""Half a minute of learning, for a processor that has nothing else to do."""


@pytest.fixture(scope="module")
def slurm(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    """Up for all tests."""
    with started(tmp_path_factory.mktemp("slurm"), cpus=4) as cluster:
        yield cluster


@pytest.fixture
def cluster(slurm: Cluster) -> Iterator[Cluster]:
    """Without jobs of other tests."""
    yield slurm
    slurm.ask("scancel", "--user", "root")


@pytest.fixture(scope="module")
def workplace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A working directory for all tests."""
    return tmp_path_factory.mktemp("work")


def _train(cluster: Cluster, workplace: Path, *arguments: str) -> subprocess.Popen[str]:
    return subprocess.Popen(
        [str(TRAIN), *arguments],
        cwd=workplace,
        env=cluster.environment | {"OMP_NUM_THREADS": "1"},
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def _trained(cluster: Cluster, workplace: Path, *arguments: str) -> tuple[int, str]:
    """Exit status and stderr of a command."""
    process = _train(cluster, workplace, *arguments)
    _, err = process.communicate(timeout=PATIENCE)
    return process.returncode, err


@pytest.fixture(scope="module")
def undisturbed(slurm: Cluster, workplace: Path) -> dict[int, Path]:
    """Runs on this machine, without SLURM, by seed.  They also compile what the others load."""
    seeds = (0, 10, 20, 30)
    swept = f"seed={','.join(map(str, seeds))}"
    status, err = _trained(slurm, workplace, "-m", *RIDES, swept, "hydra.sweep.dir=alone")
    assert status == 0, err
    return {seed: workplace / "alone" / str(row) for row, seed in enumerate(seeds)}


def _until(condition: Callable[[], Any], process: subprocess.Popen[str] | None = None) -> Any:
    """Wait for something true; process: must not end before."""
    deadline = time.monotonic() + PATIENCE
    while not (found := condition()):
        assert process is None or process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.1)
    return found


def _json(path: Path) -> dict[str, Any]:
    try:
        return json.loads(path.read_text())
    except FileNotFoundError:
        return {}


def _status(folder: Path) -> str | None:
    return _json(folder / "status.json").get("status")


def _saved(folder: Path) -> int:
    """How often the state was saved."""
    names = [path.stem for path in folder.glob("checkpoints/*.safetensors")]
    return max((int(name) for name in names if name.isdigit()), default=0)


def _learning(sweep: Path) -> dict[str, Path]:
    """Runs that have saved more than their first state, by their job's number."""
    locks = {path.parent: _json(path) for path in sweep.glob("*/run.lock")}
    return {
        holder["slurm_job"]: folder
        for folder, holder in locks.items()
        if holder and _saved(folder) >= 3
    }


def _breaks(folder: Path) -> int:
    """After how many the run goes on."""
    return len(_json(folder / "run.json").get("resumed", ()))


def _seed(folder: Path) -> int:
    found = re.search(r"^seed: (\d+)$", (folder / "config.yaml").read_text(), re.MULTILINE)
    assert found is not None
    return int(found[1])


def test_a_sweep_whose_jobs_are_requeued_preempted_signalled_and_killed(
    cluster: Cluster, workplace: Path, undisturbed: dict[int, Path]
) -> None:
    """Three of them go on by themselves, the one that was killed when the sweep is repeated."""
    arguments = ("-m", *RIDES, "seed=0,10,20,30", "hydra/launcher=slurm", "sweep.name=a")
    sweep = workplace / "runs/sweeps/a"
    process = _train(cluster, workplace, *arguments)
    jobs = _until(lambda: len(found := _learning(sweep)) == 4 and found, process)
    # All cores are taken: one job has to make room.
    higher = cluster.submit("--partition=high", "--wrap=sleep 600", folder=workplace)
    preempted = _until(lambda: [job for job in jobs if cluster.state(job) == "PENDING"], process)
    requeued, signalled, killed = (job for job in jobs if job not in preempted)

    cluster.ask("scontrol", "requeue", cluster.task(requeued))
    cluster.ask("scancel", "--signal=USR2", cluster.task(signalled))
    os.kill(_json(jobs[killed] / "run.lock")["pid"], signal.SIGKILL)
    _until(lambda: _status(jobs[signalled]) == "interrupted", process)
    _until(lambda: cluster.state(killed) == "FAILED", process)
    assert _status(jobs[killed]) == "running"
    _until(lambda: cluster.state(higher) == "RUNNING", process)
    cluster.ask("scancel", higher)
    _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    assert "of 4 jobs 3 done, 1 unfinished" in err.splitlines()[-1]
    restarts = {job: int(cluster.facts(job)["Restarts"]) for job in jobs}
    assert restarts == {job: int(job != killed) for job in jobs}

    status, err = _trained(cluster, workplace, *arguments)
    assert status == 0, err
    for folder in jobs.values():
        assert _breaks(folder) == 1
        assert differences(undisturbed[_seed(folder)], folder) == []


def test_a_job_of_a_sweep_without_a_name_that_runs_out_of_time(
    cluster: Cluster, workplace: Path, undisturbed: dict[int, Path]
) -> None:
    """It goes back to the queue as often as it may; then it can be resumed by hand.

    With so short a time limit submitit takes any signal for the end of time.
    """
    process = _train(
        cluster,
        workplace,
        *("-m", *RIDES, "seed=0,10", "hydra/launcher=slurm", "hydra.sweep.dir=b"),
        *("hydra.launcher.timeout_min=9", "hydra.launcher.max_num_timeout=1"),
    )
    jobs = _until(lambda: len(found := _learning(workplace / "b")) == 2 and found, process)
    once, often = jobs
    for job in jobs:
        cluster.ask("scancel", "--signal=USR2", cluster.task(job))
    _until(lambda: _breaks(jobs[often]) == 1, process)
    cluster.ask("scancel", "--signal=USR2", cluster.task(often))
    _, err = process.communicate(timeout=PATIENCE)
    assert process.returncode == 1
    logs = (workplace / "b/.submitit" / cluster.task(often)).glob("*_log.err")
    assert "timed-out too many times" in "".join(path.read_text() for path in logs)
    assert "of 2 jobs" in err.splitlines()[-1] and "1 interrupted" in err.splitlines()[-1]
    assert _status(jobs[once]) == "done" and _status(jobs[often]) == "interrupted"
    status, err = _trained(cluster, workplace, f"resume={jobs[often]}")
    assert status == 0, err
    for folder in jobs.values():
        assert differences(undisturbed[_seed(folder)], folder) == []


def test_the_script_of_the_documentation(
    cluster: Cluster, workplace: Path, undisturbed: dict[int, Path]
) -> None:
    """``docs/cluster.md``: without submitit, stopped before its time is over, and pre-empted."""
    text = (ROOT / "docs/cluster.md").read_text()
    script = re.search(r"```bash\n(#!/bin/bash\n.*?)```", text, re.DOTALL)
    assert script is not None
    train = shlex.quote(str(TRAIN))
    wanted = f"{train} {' '.join(RIDES)} seed=20"
    line, count = re.subn(r"edtorch-train experiment=\S+", wanted, script[1])
    assert count == 1
    (workplace / "job.sh").write_text(line.replace("edtorch-train resume", f"{train} resume"))
    job = cluster.submit("job.sh", folder=workplace)
    folder = workplace / "runs/long"

    def wait_until_it_learns(breaks: int) -> None:
        before = _saved(folder)
        _until(lambda: _breaks(folder) == breaks and _saved(folder) >= before + 3)

    wait_until_it_learns(0)
    cluster.ask("scancel", "--signal=USR2", job)
    wait_until_it_learns(1)
    higher = cluster.submit("--partition=high", "--ntasks=4", "--wrap=sleep 1", folder=workplace)
    _until(lambda: cluster.state(higher) == "COMPLETED")
    _until(lambda: cluster.state(job) == "COMPLETED")
    assert _status(folder) == "done"
    assert _breaks(folder) == 2
    assert differences(undisturbed[20], folder) == []
