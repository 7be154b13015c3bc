"""Where a run's progress goes: CSV, TensorBoard and the console behind one small protocol."""

from __future__ import annotations

import csv
import logging
import math
import statistics
import sys
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol, TextIO

from rich.console import Console
from rich.live import Live
from rich.text import Text

from edtorch.run.episodes import Episode
from edtorch.run.files import FileProblem
from sims.base import Outcome

if TYPE_CHECKING:
    from torch.utils.tensorboard.writer import SummaryWriter


EPISODES = "episodes.csv"
EVENTS = "events.out.tfevents.*"
"""TensorBoard's event files: one for each process that wrote to the folder."""


def summary_writer(folder: Path) -> SummaryWriter:
    """TensorBoard's writer of event files in ``folder``."""
    # Half a second of imports, for those runs that write event files.
    from torch.utils.tensorboard.writer import SummaryWriter

    return SummaryWriter(str(folder))


@dataclass(frozen=True)
class Entry:
    """What a run reports of one moment; nothing by default.

    rows: of ``metrics.csv``; scalars: for TensorBoard by tag, at ``step``, those that are not
    finite left out; line: for the console; episodes: those that have ended since the entry before,
    each with the seed of its learner; news: a line that stays on the console.
    """

    rows: Sequence[Sequence[Any]] = ()
    scalars: Mapping[str, float] = field(default_factory=dict)
    step: int = 0
    line: str = ""
    episodes: Sequence[tuple[int, Episode]] = ()
    news: str = ""


class Sink(Protocol):
    """Takes what a run reports."""

    def write(self, entry: Entry) -> None:
        """One entry more."""
        ...

    def flush(self) -> Sequence[Path]:
        """Have the files hold what was written; returns those that are only ever appended to."""
        ...

    def close(self) -> None:
        """Nothing more will come."""
        ...


def finite(values: Sequence[float]) -> list[float]:
    """The values that are numbers."""
    return [v for v in values if math.isfinite(v)]


def median_known(values: Sequence[float]) -> float:
    """Median of the values that are numbers; NaN if none is."""
    numbers = finite(values)
    return statistics.median(numbers) if numbers else math.nan


class CsvSink:
    """``metrics.csv`` with these columns; with ``measures``, the names of the sim's own, also
    ``episodes.csv``: a row per episode, with its return and whether it was a success; empty where
    there is none.  Files that are there are continued.

    The numbers of ``episodes.csv`` are exact: ``read_episodes`` gives the episodes back.
    """

    EPISODES = ("seed", "episode", "start_s", "seconds", "outcome", "return", "success")

    def __init__(
        self, folder: Path, columns: Sequence[str], measures: Sequence[str] | None = None
    ) -> None:
        self._measures = [] if measures is None else list(measures)
        self._metrics = _continued(folder / "metrics.csv", columns)
        self._episodes = None
        if measures is not None:
            header = (*self.EPISODES, *measures)
            self._episodes = _continued(folder / EPISODES, header)

    def write(self, entry: Entry) -> None:
        """Append the rows."""
        csv.writer(self._metrics).writerows([_plain(v) for v in row] for row in entry.rows)
        self._metrics.flush()
        if self._episodes is not None:
            csv.writer(self._episodes).writerows(self._row(*each) for each in entry.episodes)
            self._episodes.flush()

    def _row(self, seed: int, e: Episode) -> tuple[str | int, ...]:
        return (
            seed,
            e.number,
            _exact(e.start),
            _exact(e.seconds),
            e.outcome.name.lower(),
            _exact(e.total_reward),
            "" if e.success is None else int(e.success),
            *(_exact(e.measures[name]) for name in self._measures),
        )

    def flush(self) -> Sequence[Path]:
        """See ``Sink``."""
        files = [file for file in (self._metrics, self._episodes) if file is not None]
        for file in files:
            file.flush()
        return [Path(file.name) for file in files]

    def close(self) -> None:
        """Close the files."""
        self._metrics.close()
        if self._episodes is not None:
            self._episodes.close()


def _continued(path: Path, header: Sequence[str]) -> TextIO:
    """The file, to append to; with its header if it is a new one."""
    file = path.open("a", newline="", encoding="utf-8")
    if file.tell() == 0:
        csv.writer(file).writerow(header)
    return file


def read_episodes(path: Path, seeds: Sequence[int]) -> list[Episode]:
    """The episodes in an ``episodes.csv``, as they were when the rows were written.

    Raises FileProblem for another file.
    """
    row_of = {seed: row for row, seed in enumerate(seeds)}
    try:
        with path.open(newline="", encoding="utf-8") as file:
            return [
                Episode(
                    row=row_of[int(row["seed"])],
                    number=int(row["episode"]),
                    start=float(row["start_s"]),
                    seconds=float(row["seconds"]),
                    outcome=Outcome[row["outcome"].upper()],
                    measures={k: _number(v) for k, v in row.items() if k not in CsvSink.EPISODES},
                    total_reward=_number(row.get("return", "")),
                    success=None if not row.get("success") else bool(int(row["success"])),
                )
                for row in csv.DictReader(file)
            ]
    except (LookupError, ValueError, AttributeError, TypeError) as error:
        raise FileProblem(f"{path}: cannot be read as the episodes of a run ({error!r})") from error


def _number(text: str) -> float:
    return float(text) if text else math.nan


def _exact(value: float) -> str:
    """The shortest of a few texts that gives the number back; empty for NaN."""
    if math.isnan(value):
        return ""
    short = f"{value:.9g}"
    return short if float(short) == value else repr(float(value))


def _plain(value: float | str) -> str | int:
    if isinstance(value, float):
        return f"{value:.9g}" if math.isfinite(value) else ""
    return value if isinstance(value, str) else int(value)


class TensorBoardSink:
    """The scalars, and ``writer`` for all else; config_text: the settings."""

    def __init__(self, folder: Path, config_text: str) -> None:
        is_new = not list(folder.glob(EVENTS))
        self._folder = folder
        self.writer = summary_writer(folder)
        if is_new:
            self.writer.add_text("config", f"```yaml\n{config_text}\n```")

    def write(self, entry: Entry) -> None:
        """Append the scalars."""
        for name, value in entry.scalars.items():
            if math.isfinite(value):
                self.writer.add_scalar(name, value, entry.step)

    def hparams(self, settings: dict[str, str | float | bool], results: dict[str, float]) -> None:
        """The settings beside the results, in this run's own event file."""
        from torch.utils.tensorboard.summary import hparams

        writer = self.writer.file_writer
        if writer is None:
            raise ValueError("the TensorBoard sink is closed")
        for summary in hparams(settings, results):
            writer.add_summary(summary)
        for name, value in results.items():
            self.writer.add_scalar(name, value)

    def flush(self) -> Sequence[Path]:
        """See ``Sink``."""
        self.writer.flush()
        return sorted(self._folder.glob(EVENTS))

    def close(self) -> None:
        """Flush and close."""
        self.writer.close()


class ConsoleSink:
    """One live line on a terminal; elsewhere a line every ``quiet`` wall seconds."""

    def __init__(self, console: Console, quiet: float = 10.0) -> None:
        self._console = console
        self._quiet = quiet
        self._last_printed = -math.inf  # the first line at once
        self._live: Live | None = None
        if console.is_terminal:
            self._live = Live(console=console, auto_refresh=False, transient=True)
            self._live.start()

    def write(self, entry: Entry) -> None:
        """Show the line, if there is one."""
        now = time.monotonic()
        if not entry.line:
            return
        if self._live is not None:
            # Cut off rather than wrapped where the terminal is narrow: it must stay one line.
            text = Text(entry.line, no_wrap=True, overflow="ellipsis")
            self._live.update(text, refresh=True)
        elif now - self._last_printed >= self._quiet:
            self._last_printed = now
            self._console.print(entry.line, soft_wrap=True, highlight=False)

    def flush(self) -> Sequence[Path]:
        """It writes no files."""
        return ()

    def close(self) -> None:
        """Leave the terminal as it was."""
        if self._live is not None:
            self._live.stop()


class StderrHandler(logging.Handler):
    """Messages to whatever ``sys.stderr`` is at the time.

    While a live line is on the screen that is its console's own, which puts them above the line.
    """

    def emit(self, record: logging.LogRecord) -> None:
        """Print the message."""
        print(self.format(record), file=sys.stderr)


def spread_scalars(group: str, figures: Mapping[str, Any]) -> dict[str, float]:
    """Median and extremes over the seeds of each figure (``edtorch.report.statistics``)."""
    return {
        f"{group}/{name}_{part}": spread[part]
        for name, spread in figures.items()
        for part in ("median", "min", "max")
        if spread.get(part) is not None
    }
