"""Ctrl-C and SIGTERM: the folder says so, and what was learned is saved."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
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
from studies.same_runs import differences

Start = Callable[..., subprocess.Popen[str]]
Handler = Callable[[int, FrameType | None], None]


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


@pytest.fixture
def handlers() -> Iterator[None]:
    """A process that has been stopped is deaf from then on; this one goes on."""
    before = {number: signal.getsignal(number) for number in SIGNALS}
    yield
    for number, handler in before.items():
        signal.signal(number, handler)


def _exit(signum: int, frame: FrameType | None) -> None:
    sys.exit(3)


def _give_up(signum: int, frame: FrameType | None) -> None:
    raise RuntimeError("not requeued")


@pytest.mark.usefixtures("handlers")
class TestSomebodyElseHandlesTheSignal:
    """As under submitit: the state is saved, and what happens then is for that handler to say."""

    ARGUMENTS = (
        *("seeds=2", "train.seconds=6", "train.successes=null", "eval.episodes=1"),
        *("compute.native=off", "log.figures=false", "log.checkpoint_wall=1e6"),
    )

    @pytest.fixture
    def signalled(
        self, command: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
    ) -> Callable[[Handler, str], Any]:
        """A run that gets SIGUSR2 once, after two seconds of learning."""

        def run(handler: Handler, folder: str) -> Any:
            advance, sent = Training.advance, []

            def one(training: Training, ahead: int) -> int:
                if training.clock >= 200 and not sent:
                    sent.append(training.clock)
                    signal.raise_signal(signal.SIGUSR2)
                return advance(training, min(ahead, 16))

            signal.signal(signal.SIGUSR2, handler)
            with monkeypatch.context() as patch:
                patch.setattr(Training, "advance", one)
                return command("edtorch-train", *self.ARGUMENTS, f"hydra.run.dir={folder}")

        return run

    @pytest.fixture
    def whole(self, command: Callable[..., Any], workplace: Path) -> Path:
        result = command("edtorch-train", *self.ARGUMENTS, "hydra.run.dir=whole")
        assert result.status == 0, result.err
        return workplace / "whole"

    @pytest.mark.experiment
    @pytest.mark.parametrize(("handler", "status"), [(_exit, 3), (_give_up, 1)])
    def test_and_ends_the_process(
        self,
        handler: Handler,
        status: int,
        signalled: Callable[[Handler, str], Any],
        command: Callable[..., Any],
        workplace: Path,
        whole: Path,
    ) -> None:
        """The run was interrupted, it has not failed, and goes on from there."""
        folder = workplace / "cut"
        assert signalled(handler, "cut").status == status
        assert json.loads((folder / "status.json").read_text())["status"] == "interrupted"
        saved = last_checkpoint(folder)
        assert saved is not None and saved.seconds == pytest.approx(2, abs=0.5)
        assert not (folder / "run.lock").exists()
        assert command("edtorch-train", "resume=cut").status == 0
        assert differences(whole, folder) == []

    @pytest.mark.experiment
    def test_and_lets_it_go_on(
        self, signalled: Callable[[Handler, str], Any], workplace: Path, whole: Path
    ) -> None:
        folder = workplace / "bypassed"
        found: list[float] = []

        def bypass(signum: int, frame: FrameType | None) -> None:
            saved = last_checkpoint(folder)
            assert saved is not None
            found.append(saved.seconds)

        result = signalled(bypass, "bypassed")
        assert result.status == 0, result.err
        assert found == [pytest.approx(2, abs=0.5)]
        assert json.loads((folder / "status.json").read_text())["status"] == "done"
        assert differences(whole, folder) == []

    @pytest.mark.parametrize("number", SIGNALS)
    def test_the_handler_waits_for_the_tick_and_for_what_is_written(
        self, number: signal.Signals
    ) -> None:
        happened: list[str] = []
        signal.signal(number, lambda *_: happened.append("handled"))
        stop = Stop()
        with stop.listening():
            with stop.between_ticks():
                signal.raise_signal(number)
                happened.append("saved")
                stop.hand_on()
            with stop.not_now():
                signal.raise_signal(number)
                happened.append("written")
            signal.raise_signal(number)
        assert happened == ["saved", "handled", "written", "handled", "handled"]
        assert not stop.asked

    def test_a_signal_that_comes_while_another_is_handled_waits(self) -> None:
        """``scontrol requeue``, which submitit calls on SIGUSR2, sends SIGTERM."""
        happened: list[str] = []

        def requeue(signum: int, frame: FrameType | None) -> None:
            signal.raise_signal(signal.SIGTERM)
            happened.append("requeued")

        signal.signal(signal.SIGUSR2, requeue)
        signal.signal(signal.SIGTERM, lambda *_: happened.append("bypassed"))
        stop = Stop()
        with stop.listening(), stop.between_ticks():
            signal.raise_signal(signal.SIGUSR2)
            stop.hand_on()
        assert happened == ["requeued", "bypassed"]

    def test_nothing_interrupts_a_process_that_a_handler_ends(self) -> None:
        """SLURM may send a signal twice, and a job that is in the queue cannot be put there."""
        happened: list[str] = []

        def requeue(signum: int, frame: FrameType | None) -> None:
            happened.append("requeued")
            sys.exit(3)

        signal.signal(signal.SIGUSR2, requeue)
        stop = Stop()
        with pytest.raises(SystemExit), stop.listening(), stop.between_ticks():
            signal.raise_signal(signal.SIGUSR2)
            signal.raise_signal(signal.SIGUSR2)
            try:
                stop.hand_on()
            finally:
                signal.raise_signal(signal.SIGUSR2)
        signal.raise_signal(signal.SIGUSR2)
        assert happened == ["requeued"]


@pytest.mark.usefixtures("handlers")
class TestStop:
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
