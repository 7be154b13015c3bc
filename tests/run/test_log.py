"""CSV, TensorBoard and console: what a run reports arrives there."""

from __future__ import annotations

import csv
import io
import logging
import math
import re
from dataclasses import replace
from pathlib import Path

import pytest
from rich.console import Console
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from edtorch.run.episodes import Episode, Snapshot
from edtorch.run.log import (
    ConsoleSink,
    CsvSink,
    StderrHandler,
    TensorBoardSink,
    median_known,
)
from edtorch.run.snapshot_log import Snapshots
from sims.base import Outcome, Words

NAN = math.nan


def _snapshot(seconds: float = 5.0, value: tuple[float, float] = (-1.5, NAN)) -> Snapshot:
    return Snapshot(
        seconds=seconds,
        seeds=[7, 8],
        active=[True, False],
        episodes=[3, 1],
        failures=[2, 1],
        successes=[1, 0],
        episode_seconds=[0.5, 0.0],
        value=list(value),
        gradient=[0.25, NAN],
        error=[0.125, NAN],
        policy_norm=[2.0, 4.0],
    )


EPISODE = Episode(0, 2, 1.25, 3.5, Outcome.FAILED, {"size": 0.5}, total_reward=-7.25, success=False)
WORDS = Words("fall", "falls", "ride", "rides")


def test_median_of_what_is_a_number() -> None:
    assert median_known([1.0, NAN, 4.0, math.inf]) == 2.5
    assert math.isnan(median_known([NAN]))


def test_csv(tmp_path: Path) -> None:
    made = Snapshots(WORDS)
    sink = CsvSink(tmp_path, made.columns, ["size"])
    unknown = replace(EPISODE, total_reward=NAN, success=None, measures={"size": NAN})
    sink.write(made.entry(_snapshot(), [EPISODE, unknown]))
    sink.write(made.entry(_snapshot(10.0), []))
    # Readable while the run goes on.
    with (tmp_path / "metrics.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    with (tmp_path / "episodes.csv").open(newline="") as file:
        episodes = list(csv.DictReader(file))
    sink.close()
    assert [(r["seconds"], r["seed"]) for r in rows] == [
        ("5", "7"),
        ("5", "8"),
        ("10", "7"),
        ("10", "8"),
    ]
    assert float(rows[0]["value"]) == -1.5
    assert rows[1]["value"] == ""
    assert (rows[0]["active"], rows[1]["active"]) == ("1", "0")
    assert (rows[0]["falls"], rows[0]["rides"]) == ("2", "1")
    always = {"seed": "7", "episode": "2", "start_s": "1.25", "seconds": "3.5", "outcome": "failed"}
    assert episodes == [
        always | {"return": "-7.25", "success": "0", "size": "0.5"},
        always | {"return": "", "success": "", "size": ""},
    ]


def test_tensorboard(tmp_path: Path) -> None:
    sink = TensorBoardSink(tmp_path, "noise:\n  exploration: 0.05\n")
    made = Snapshots(WORDS)
    sink.write(made.entry(_snapshot(5.0), [EPISODE]))
    sink.write(made.entry(_snapshot(10.0, (NAN, NAN)), []))
    sink.hparams({"step.alpha": 0.1, "debug": False, "model": "m"}, {"summary/falls": 4.0})
    sink.close()
    assert len(list(tmp_path.iterdir())) == 1
    board = EventAccumulator(str(tmp_path))
    board.Reload()
    assert [(e.step, e.value) for e in board.Scalars("learning/value")] == [(5, -1.5)]
    assert [(e.step, e.value) for e in board.Scalars("falls/median")] == [(5, 1.5), (10, 1.5)]
    assert [e.value for e in board.Scalars("rides/max")] == [1, 1]
    assert [e.value for e in board.Scalars("population/active")] == [1, 1]
    assert [(e.step, e.value) for e in board.Scalars("episodes/seconds_max")] == [(5, 3.5)]
    assert [(e.step, e.value) for e in board.Scalars("episodes/return")] == [(5, -7.25)]
    assert [e.value for e in board.Scalars("summary/falls")] == [4.0]
    text = board.Tensors("config/text_summary")[0].tensor_proto.string_val[0].decode()
    assert "exploration: 0.05" in text
    plugins = {t: m.plugin_data.plugin_name for t, m in board.summary_metadata.items()}
    assert plugins["_hparams_/session_start_info"] == "hparams"
    content = board.summary_metadata["_hparams_/session_start_info"].plugin_data.content
    assert b"step.alpha" in content


def _console(width: int = 60, terminal: bool = False) -> Console:
    return Console(file=io.StringIO(), width=width, force_terminal=terminal)


def _written(console: Console) -> str:
    assert isinstance(console.file, io.StringIO)
    return console.file.getvalue()


def test_console_elsewhere_is_whole_plain_lines() -> None:
    console = _console()
    made = Snapshots()
    sink = ConsoleSink(console, quiet=0.0)
    sink.write(made.entry(_snapshot(5.0), []))
    sink.write(made.entry(_snapshot(10.0), []))
    sink.close()
    lines = _written(console).splitlines()
    assert len(lines) == 2
    counts = r"failures 1\.5 \[1, 2\]  successes 0\.5 \[0, 1\]"
    assert re.fullmatch(
        rf" +10 s  {counts}  value -1\.5  1/2 learning  \d+ s per s",
        lines[1],
    )


@pytest.mark.parametrize(
    ("failures", "successes", "told"),
    [
        ([0, 0], [0, 0], r"episodes 2 \[1, 3\]"),
        ([2, 1], [0, 0], r"failures 1\.5 \[1, 2\]"),
        ([1, 0], [1, 0], r"failures 0\.5 \[0, 1\]  successes 0\.5 \[0, 1\]"),
        # Time-outs, of which nothing is known yet.
        ([0, 0], [1, 0], r"episodes 2 \[1, 3\]"),
    ],
)
def test_console_counts_what_the_domain_does_not_declare_once_there_is_some(
    failures: list[int], successes: list[int], told: str
) -> None:
    made = Snapshots(can_fail=False, can_succeed=False)
    line = made.entry(replace(_snapshot(), failures=failures, successes=successes), []).line
    assert re.match(rf" +5 s  {told}  value", line)


def test_console_elsewhere_is_quiet_in_between() -> None:
    console = _console()
    made = Snapshots()
    sink = ConsoleSink(console, quiet=3600.0)
    for second in range(5):
        sink.write(made.entry(_snapshot(float(second)), []))
    sink.close()
    # One line at once, to show that it works.
    assert _written(console).count("\n") == 1


def test_console_on_a_terminal_is_one_line(monkeypatch: pytest.MonkeyPatch) -> None:
    """Too long for the terminal it is cut off; a warning goes above it; in the end it is gone."""
    monkeypatch.setenv("TERM", "xterm")
    console = _console(width=40, terminal=True)
    logger = logging.getLogger("test_console")
    handler = StderrHandler()
    logger.addHandler(handler)
    made = Snapshots()
    sink = ConsoleSink(console)
    try:
        sink.write(made.entry(_snapshot(5.0), []))
        logger.warning("something odd")
        sink.write(made.entry(_snapshot(10.0), []))
    finally:
        sink.close()
        logger.removeHandler(handler)
    screen = _screen(_written(console))
    assert screen == ["something odd"]
    visible = re.sub(r"\x1b\[[0-9;?]*[A-Za-z]", "", _written(console))
    shown = [line for line in re.split(r"[\r\n]+", visible) if "failures" in line]
    assert len(shown) >= 2
    assert all(len(line.rstrip()) <= 40 and line.rstrip().endswith("…") for line in shown)


def _screen(written: str) -> list[str]:
    """What a terminal shows after ``written``: enough of one for a live line."""
    lines, row, column = [""], 0, 0
    for token in re.findall(r"\x1b\[[0-9;?]*[A-Za-z]|\r|\n|[^\x1b\r\n]+", written):
        if token == "\r":
            column = 0
        elif token == "\n":
            row, column = row + 1, 0
            lines += [""] * (row + 1 - len(lines))
        elif token.startswith("\x1b"):
            if token.endswith("A"):
                row -= int(token[2:-1] or 1)
            elif token.endswith("K"):
                lines[row] = "" if token == "\x1b[2K" else lines[row][:column]
        else:
            lines[row] = lines[row][:column] + token + lines[row][column + len(token) :]
            column += len(token)
    return [line.rstrip() for line in lines if line.strip()]
