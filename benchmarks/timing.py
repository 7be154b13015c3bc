"""How the benchmarks measure: functions in turn, within one process, by its CPU time.

On a shared machine the figures move by a quarter and more from minute to minute; what was measured
in turn moves together, so that the ratios hold.
"""

from __future__ import annotations

import json
import platform
import statistics
import time
from collections.abc import Callable, Mapping
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

PACKAGES = ("torch", "numpy", "jax", "numba")

Work = Callable[[], object]


def cpu_seconds(work: Work, calls: int = 1) -> float:
    """CPU seconds of one call, all threads of the process together."""
    began = time.process_time()
    for _ in range(calls):
        work()
    return (time.process_time() - began) / calls


def interleaved(
    works: Mapping[str, Work], *, rounds: int = 7, turn: float = 0.03, patience: float = 2.0
) -> dict[str, float]:
    """Median CPU seconds of one call of each function, all taking turns for ``rounds`` rounds.

    Each is called once before that, to compile; a turn is as many calls as fill ``turn`` seconds.
    A call of more than ``patience`` seconds is not repeated.
    """
    for work in works.values():
        work()
    first = {name: cpu_seconds(work) for name, work in works.items()}
    samples = {name: [seconds] for name, seconds in first.items() if seconds > patience}
    for _ in range(rounds):
        for name, work in works.items():
            if first[name] <= patience:
                calls = max(1, round(turn / max(first[name], 1e-7)))
                samples.setdefault(name, []).append(cpu_seconds(work, calls))
    return {name: statistics.median(samples[name]) for name in works}


def versions() -> dict[str, str]:
    """What the figures were measured with."""
    found = {"python": platform.python_version(), "machine": processor()}
    for package in PACKAGES:
        try:
            found[package] = version(package)
        except PackageNotFoundError:
            continue
    return found


def processor() -> str:
    """The processor's name, as far as the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def write_json(path: Path | None, content: Mapping[str, Any]) -> None:
    """The results with their versions, if there is a ``path`` to write them to."""
    if path is not None:
        everything = {**content, **versions(), "threads": 1}
        path.write_text(json.dumps(everything, indent=1) + "\n", encoding="utf-8")


def print_table(title: str, columns: list[str], table: Mapping[str, list[str]]) -> None:
    """Rows of cells under their columns, all as wide as the widest."""
    width = max(len(cell) for row in [columns, *table.values()] for cell in row) + 2
    first = max(len(name) for name in [title, *table])
    print(title.ljust(first) + "".join(column.rjust(width) for column in columns))
    for name, row in table.items():
        print(name.ljust(first) + "".join(cell.rjust(width) for cell in row), flush=True)
