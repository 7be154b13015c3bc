"""Sweeps whose jobs run in other processes: joblib's and submitit's."""

from __future__ import annotations

import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

Start = Callable[..., "subprocess.Popen[str]"]


@pytest.mark.experiment
@pytest.mark.parametrize("launcher", ["joblib", "submitit_local"])
def test_a_refused_job_ends_in_the_line_that_it_ends_in_alone(
    start: Start, workplace: Path, patience: float, launcher: str
) -> None:
    process = start(
        *("edtorch-train", "-m", "step.alpha=-1", "seed=1,2", "hydra.sweep.dir=s"),
        f"hydra/launcher={launcher}",
        PYTHONWARNINGS="ignore",
    )
    _, err = process.communicate(timeout=patience)
    assert process.returncode == 1
    assert "Traceback" not in err
    assert err.splitlines()[-1] == "edtorch-train: step.alpha=-1.0: expected a number >= 0"
    # A worker may be stopped before it has removed its empty folder.
    assert not [path for path in (workplace / "s").glob("[01]/**/*") if path.is_file()]


@pytest.mark.experiment
def test_paths_are_relative_to_where_the_command_was_called(
    start: Start, workplace: Path, patience: float
) -> None:
    process = start(
        "edtorch-train",
        *("experiment=bicycle_offline", "offline.data=data.npz", "hydra.job.chdir=true"),
    )
    (workplace / "data.npz").write_bytes(b"not a file of arrays")
    _, err = process.communicate(timeout=patience)
    assert process.returncode == 1
    assert "data.npz: cannot be read as an .npz file of arrays" in err
