"""Ctrl-C and SIGTERM: the folder says so, and what was learned is saved."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
from safetensors.torch import load_file

from edtorch.app import learners
from edtorch.app.build import build
from edtorch.app.checkpoints import last_checkpoint
from edtorch.app.rundir import load_config
from edtorch.app.signals import SIGNALS, Stop
from edtorch.run.training import Training

Start = Callable[..., subprocess.Popen[str]]


def _wait_for(
    condition: Callable[[], bool], process: subprocess.Popen[str], patience: float
) -> None:
    deadline = time.monotonic() + patience
    while not condition():
        assert process.poll() is None, process.communicate()
        assert time.monotonic() < deadline
        time.sleep(0.05)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_signal_in_mid_run(
    start: Start, workplace: Path, number: signal.Signals, patience: float
) -> None:
    """Of several signals the first counts; nothing is left half written."""
    process = start(
        "edtorch-train",
        "seeds=2",
        "train.seconds=1e6",
        "train.successes=null",
        "log.every=1",
        "hydra.run.dir=run",
    )
    folder = workplace / "run"
    metrics = folder / "metrics.csv"
    _wait_for(lambda: metrics.exists() and metrics.read_text().count("\n") > 4, process, patience)
    for _ in range(1 if number == signal.SIGTERM else 4):
        process.send_signal(number)
        time.sleep(0.02)
    _, err = process.communicate(timeout=patience)
    assert process.returncode == 130
    assert err.splitlines()[-1] == f"edtorch-train: interrupted; saved in {folder}"
    assert "Traceback" not in err
    status = json.loads((folder / "status.json").read_text())
    assert status["status"] == "interrupted"
    setup = build(load_config(folder))
    training = Training(setup.learner, setup.world, setup.seeds, setup.budget)
    checkpoint = last_checkpoint(folder)
    assert checkpoint is not None
    training.restore(checkpoint.state["work"]["training"], [])
    assert training.clock > 100
    (saved,) = load_file(folder / "policy.safetensors").values()
    assert torch.equal(saved, next(iter(training.learners.policy.values())))
    assert not list(folder.glob(".*"))
    assert not (folder / "summary.json").exists()


def test_an_interrupted_run_can_be_evaluated_and_ends_after_a_whole_tick(
    command: Callable[..., Any], workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What is saved is what a run of so many ticks has."""
    advance = Training.advance

    def interrupted(training: Training, ticks: int) -> int:
        if training.clock >= 300:
            os.kill(os.getpid(), signal.SIGTERM)
        return advance(training, ticks)

    options = ("seeds=2", "train.successes=null", "log.figures=false", "eval.episodes=0")
    with monkeypatch.context() as patch:
        patch.setattr(Training, "advance", interrupted)
        command("edtorch-train", *options, "train.seconds=100", "hydra.run.dir=cut")
    folder = workplace / "cut"
    assert json.loads((folder / "status.json").read_text())["status"] == "interrupted"
    setup = build(load_config(folder))
    training = Training(setup.learner, setup.world, setup.seeds, setup.budget)
    checkpoint = last_checkpoint(folder)
    assert checkpoint is not None
    training.restore(checkpoint.state["work"]["training"], [])
    seconds = training.clock * setup.world.dt
    command("edtorch-train", *options, f"train.seconds={seconds}", "hydra.run.dir=whole")
    cut, whole = (load_file(workplace / n / "policy.safetensors") for n in ("cut", "whole"))
    assert all(torch.equal(cut[name], whole[name]) for name in cut)
    assert command("edtorch-eval", "run=cut", "episodes=1").status == 0


def test_a_crash_is_recorded(
    command: Callable[..., Any], workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A defect keeps its traceback; the folder says failed and why, and keeps what was learned."""

    def crash(*arguments: object, **more: object) -> None:
        raise RuntimeError("the pictures fell off the wall")

    monkeypatch.setattr(learners, "draw", crash)
    with pytest.raises(RuntimeError, match="fell off"):
        command("edtorch-train", "seeds=1", "train.seconds=2", "eval.episodes=0", "hydra.run.dir=x")
    folder = workplace / "x"
    status = json.loads((folder / "status.json").read_text())
    assert status["status"] == "failed"
    assert status["why"] == "RuntimeError: the pictures fell off the wall"
    assert "Traceback" in (folder / "run.log").read_text()
    assert (folder / "policy.safetensors").exists()


def test_full_disk_is_one_line_and_recorded(
    command: Callable[..., Any], workplace: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*arguments: object, **more: object) -> None:
        raise OSError(28, "No space left on device", "learning_curve.png")

    monkeypatch.setattr(learners, "draw", full)
    result = command(
        "edtorch-train", "seeds=1", "train.seconds=2", "eval.episodes=0", "hydra.run.dir=x"
    )
    assert result.status == 1
    assert result.err.splitlines()[-1] == (
        "edtorch-train: learning_curve.png: No space left on device"
    )
    status = json.loads((workplace / "x" / "status.json").read_text())
    assert status["status"] == "failed"


class TestStop:
    @pytest.fixture(autouse=True)
    def handlers(self) -> Iterator[None]:
        """A process that has been stopped is deaf from then on; this one goes on."""
        before = {number: signal.getsignal(number) for number in SIGNALS}
        yield
        for number, handler in before.items():
            signal.signal(number, handler)

    def test_interrupts_at_once_elsewhere(self) -> None:
        stop = Stop()
        with stop.listening(), pytest.raises(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)
        assert stop.asked
        signal.raise_signal(signal.SIGTERM)

    def test_waits_for_the_tick_and_then_ignores_more(self) -> None:
        stop = Stop()
        with stop.listening():
            with stop.between_ticks():
                signal.raise_signal(signal.SIGINT)
                assert stop.asked
            signal.raise_signal(signal.SIGINT)
            with stop.not_now():
                signal.raise_signal(signal.SIGINT)

    def test_a_second_one_breaks_off_a_tick_that_hangs(self) -> None:
        stop = Stop()
        with stop.listening(), stop.between_ticks():
            signal.raise_signal(signal.SIGINT)
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)

    def test_remembers_what_came_while_saving(self) -> None:
        stop = Stop()
        with stop.listening(), stop.not_now():
            signal.raise_signal(signal.SIGINT)
        assert stop.asked

    def test_leaves_the_handlers_as_they_were(self) -> None:
        before = [signal.getsignal(number) for number in SIGNALS]
        with Stop().listening():
            pass
        assert [signal.getsignal(n) for n in SIGNALS] == before
