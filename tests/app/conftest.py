"""The commands, called as a user would: in this process (fast), or as processes of their own."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import redirect_stderr, redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import pytest
from hydra._internal.hydra import Hydra

from edtorch.app import evaluate, import_, report, train
from edtorch.app.signals import SIGNALS

MAINS = {
    "edtorch-train": train.main,
    "edtorch-eval": evaluate.main,
    "edtorch-report": report.main,
    "edtorch-import": import_.main,
}
MODULES = {"edtorch-train": "edtorch.app.train", "edtorch-eval": "edtorch.app.evaluate"}
PATIENCE = 280
"""Seconds until a process counts as hanging: it starts in a few, on a machine that is free."""
QUICK = (
    "seeds=2",
    "train.seconds=3",
    "eval.episodes=1",
    "log.tensorboard=false",
    "log.figures=false",
    "compute.native=off",
)


@dataclass(frozen=True)
class Result:
    """What a command left: exit status, and its two streams."""

    status: int
    out: str
    err: str

    @property
    def line(self) -> str:
        """The one line of stderr of a command that was refused."""
        lines = self.err.splitlines()
        assert len(lines) == 1, self.err
        return lines[0]


def call(command: str, *arguments: str) -> Result:
    """Run a command in this process, with no configuration left over from another one."""
    out, err = StringIO(), StringIO()
    handlers = {number: signal.getsignal(number) for number in SIGNALS}
    with pytest.MonkeyPatch.context() as patch, redirect_stdout(out), redirect_stderr(err):
        patch.setattr(sys, "argv", [command, *arguments])
        if not any("hydra.mode" in each for each in arguments):
            # Hydra composes once more before, only to find this setting, which no file has.
            patch.setattr(Hydra, "get_mode", lambda self, config_name, overrides: None)
        with pytest.raises(SystemExit) as left:
            MAINS[command]()
    for number, handler in handlers.items():
        signal.signal(number, handler)
    code = left.value.code
    status = code if isinstance(code, int) else int(code is not None)
    return Result(status, out.getvalue(), err.getvalue())


def environment() -> dict[str, str]:
    """For a process of its own."""
    return os.environ | {"OMP_NUM_THREADS": "1", "PYTHONWARNINGS": "default"}


def argv(command: str, *arguments: str) -> list[str]:
    """What to start for ``command``."""
    return [sys.executable, "-m", MODULES[command], *arguments]


@pytest.fixture
def workplace(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty working directory."""
    monkeypatch.chdir(tmp_path)
    yield tmp_path


@pytest.fixture
def command(workplace: Path) -> Callable[..., Result]:
    """Calls a command in this process, in ``workplace``."""
    return call


@pytest.fixture
def start(workplace: Path) -> Iterator[Callable[..., subprocess.Popen[str]]]:
    """Starts a command as a process of its own, in ``workplace``."""
    started: list[subprocess.Popen[str]] = []

    def begin(name: str, *arguments: str, **more: str) -> subprocess.Popen[str]:
        process = subprocess.Popen(
            argv(name, *arguments),
            cwd=workplace,
            env=environment() | more,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        started.append(process)
        return process

    yield begin
    for process in started:
        if process.poll() is None:
            process.kill()
        process.communicate()


@pytest.fixture(scope="session")
def patience() -> float:
    """Seconds to wait for a process."""
    return PATIENCE


@pytest.fixture
def quick() -> tuple[str, ...]:
    """Overrides that make a run of edtorch-train short."""
    return QUICK


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder of a short run on the bicycle with everything switched on."""
    folder = tmp_path_factory.mktemp("runs") / "finished"
    result = call(
        "edtorch-train",
        "experiment=bicycle_squared",
        "seeds=2",
        "seed=3",
        "train.seconds=12",
        "eval.episodes=2",
        f"hydra.run.dir={folder}",
    )
    assert result.status == 0, result.err
    return folder


@pytest.fixture(scope="session")
def quick_runs() -> Callable[..., None]:
    """Makes a run folder quickly."""

    def make(*arguments: str) -> None:
        result = call("edtorch-train", *QUICK, *arguments)
        assert result.status == 0, result.err

    return make


@pytest.fixture(scope="session")
def quick_command() -> Callable[..., Result]:
    """Calls a command in this process, wherever that is."""
    return call
