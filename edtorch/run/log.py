"""Where a run's progress goes: CSV, TensorBoard and the console behind one small protocol."""

from __future__ import annotations

import csv
import logging
import math
import statistics
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Protocol

from rich.console import Console
from rich.live import Live
from rich.text import Text

from edtorch.run.episodes import Episode, Snapshot
from sims.base import DEFAULT_WORDS, Words

if TYPE_CHECKING:
    from torch.utils.tensorboard.writer import SummaryWriter


def summary_writer(folder: Path) -> SummaryWriter:
    """TensorBoard's writer of event files in ``folder``."""
    # Half a second of imports, for those runs that write event files.
    from torch.utils.tensorboard.writer import SummaryWriter

    return SummaryWriter(str(folder))


class Sink(Protocol):
    """Takes what a run reports."""

    def write(self, snapshot: Snapshot, episodes: Sequence[Episode]) -> None:
        """The population now, and the episodes that ended since the last call."""
        ...

    def close(self) -> None:
        """Nothing more will come."""
        ...


def finite(values: Sequence[float]) -> list[float]:
    """The values that are numbers."""
    return [v for v in values if math.isfinite(v)]


def median(values: Sequence[float]) -> float:
    """Median of the values that are numbers; NaN if none is."""
    numbers = finite(values)
    return statistics.median(numbers) if numbers else math.nan


class CsvSink:
    """``metrics.csv``: a row per learner and snapshot, failures and successes in the words of the
    domain; ``episodes.csv``: a row per episode, with its return, whether it was a success, and the
    sim's own ``measures``; empty where there is none."""

    METRICS = (
        "active",
        "episodes",
        "failures",
        "successes",
        "episode_seconds",
        "value",
        "gradient",
        "error",
        "policy_norm",
    )

    def __init__(
        self, folder: Path, measures: Sequence[str] = (), words: Words = DEFAULT_WORDS
    ) -> None:
        self._measures = list(measures)
        self._metrics_file = (folder / "metrics.csv").open("w", newline="", encoding="utf-8")
        self._episodes_file = (folder / "episodes.csv").open("w", newline="", encoding="utf-8")
        self._metrics = csv.writer(self._metrics_file)
        self._episodes = csv.writer(self._episodes_file)
        named = {"failures": words.failures, "successes": words.successes}
        metrics = [named.get(name, name) for name in self.METRICS]
        self._metrics.writerow(("seconds", "seed", *metrics, "value_error_estimate"))
        columns = ("seed", "episode", "start_s", "seconds", "outcome", "return", "success")
        self._episodes.writerow((*columns, *self._measures))

    def write(self, snapshot: Snapshot, episodes: Sequence[Episode]) -> None:
        """Append the rows."""
        columns = [getattr(snapshot, name) for name in self.METRICS]
        columns.append(snapshot.value_error or [math.nan] * len(snapshot.seeds))
        for seed, *row in zip(snapshot.seeds, *columns, strict=True):
            self._metrics.writerow((f"{snapshot.seconds:g}", seed, *(_plain(v) for v in row)))
        for e in episodes:
            self._episodes.writerow(
                (
                    snapshot.seeds[e.row],
                    e.number,
                    f"{e.start:.6g}",
                    f"{e.seconds:.6g}",
                    e.outcome.name.lower(),
                    _plain(e.total_reward),
                    "" if e.success is None else int(e.success),
                    *(_plain(e.measures[name]) for name in self._measures),
                )
            )
        self._metrics_file.flush()
        self._episodes_file.flush()

    def close(self) -> None:
        """Close the files."""
        self._metrics_file.close()
        self._episodes_file.close()


def _plain(value: float | bool) -> str | int:
    if isinstance(value, float):
        return f"{value:.9g}" if math.isfinite(value) else ""
    return int(value)


class TensorBoardSink:
    """Scalars by simulated seconds, over the population: median, and extremes where they tell."""

    def __init__(self, folder: Path, config_text: str, words: Words = DEFAULT_WORDS) -> None:
        self._words = words
        self.writer = summary_writer(folder)
        self.writer.add_text("config", f"```yaml\n{config_text}\n```")

    def write(self, snapshot: Snapshot, episodes: Sequence[Episode]) -> None:
        """Append the scalars."""
        step = round(snapshot.seconds)
        scalars: dict[str, float] = {
            "learning/value": median(snapshot.value),
            "learning/gradient": median(snapshot.gradient),
            "learning/model_error": median(snapshot.error),
            "learning/policy_norm": median(snapshot.policy_norm),
            "population/active": float(sum(snapshot.active)),
        }
        if snapshot.value_error is not None:
            scalars["learning/value error estimate"] = median(snapshot.value_error)
        words = self._words
        for name, numbers in (
            (words.failures, snapshot.failures),
            (words.successes, snapshot.successes),
        ):
            counts = [float(v) for v in numbers]
            scalars |= {
                f"{name}/median": median(counts),
                f"{name}/min": min(counts),
                f"{name}/max": max(counts),
            }
        if episodes:
            lengths = [e.seconds for e in episodes]
            scalars |= {
                "episodes/seconds_median": median(lengths),
                "episodes/seconds_max": max(lengths),
                "episodes/return": median([e.total_reward for e in episodes]),
            }
            for measure in episodes[0].measures:
                scalars[f"episodes/{measure}"] = median([e.measures[measure] for e in episodes])
        for name, value in scalars.items():
            if math.isfinite(value):
                self.writer.add_scalar(name, value, step)

    def spreads(self, group: str, figures: Mapping[str, Any], step: int) -> None:
        """Median and extremes over the seeds of each figure (``edtorch.report.statistics``)."""
        for name, spread in figures.items():
            for part in ("median", "min", "max"):
                if spread.get(part) is not None:
                    self.writer.add_scalar(f"{group}/{name}_{part}", spread[part], step)

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

    def close(self) -> None:
        """Flush and close."""
        self.writer.close()


class ConsoleSink:
    """One live line on a terminal; elsewhere a line every ``quiet`` wall seconds.

    can_fail, can_succeed: whether the domain declares it; otherwise failures and successes are
    counted from the first one on, and without either the episodes are.
    """

    def __init__(
        self,
        console: Console,
        quiet: float = 10.0,
        words: Words = DEFAULT_WORDS,
        *,
        can_fail: bool = True,
        can_succeed: bool = True,
    ) -> None:
        self._console = console
        self._words = words
        self._declared = can_fail, can_succeed
        self._quiet = quiet
        self._last_printed = -math.inf  # the first line at once
        self._last_seconds, self._last_time = 0.0, time.monotonic()
        self._live: Live | None = None
        if console.is_terminal:
            self._live = Live(console=console, auto_refresh=False, transient=True)
            self._live.start()

    def write(self, snapshot: Snapshot, episodes: Sequence[Episode]) -> None:
        """Show the population."""
        now = time.monotonic()
        speed = (snapshot.seconds - self._last_seconds) / max(now - self._last_time, 1e-9)
        self._last_seconds, self._last_time = snapshot.seconds, now
        line = (
            f"{snapshot.seconds:6.0f} s  {self._counts(snapshot)}  "
            f"value {median(snapshot.value):.3g}  "
            f"{sum(snapshot.active)}/{len(snapshot.seeds)} learning  {speed:.0f} s per s"
        )
        if self._live is not None:
            # Cut off rather than wrapped where the terminal is narrow: it must stay one line.
            self._live.update(Text(line, no_wrap=True, overflow="ellipsis"), refresh=True)
        elif now - self._last_printed >= self._quiet:
            self._last_printed = now
            self._console.print(line, soft_wrap=True, highlight=False)

    def _counts(self, snapshot: Snapshot) -> str:
        counted = (
            (self._words.failures, snapshot.failures),
            (self._words.successes, snapshot.successes),
        )
        told = [
            f"{name} {_spread(counts)}"
            for (name, counts), declared in zip(counted, self._declared, strict=True)
            if declared or any(counts)
        ]
        return "  ".join(told) or f"episodes {_spread(snapshot.episodes)}"

    def close(self) -> None:
        """Leave the terminal as it was."""
        if self._live is not None:
            self._live.stop()


def _spread(counts: Sequence[int]) -> str:
    return f"{median(counts):g} [{min(counts)}, {max(counts)}]"


class StderrHandler(logging.Handler):
    """Messages to whatever ``sys.stderr`` is at the time.

    While a live line is on the screen that is its console's own, which puts them above the line.
    """

    def emit(self, record: logging.LogRecord) -> None:
        """Print the message."""
        print(self.format(record), file=sys.stderr)
