"""Seconds of experience until the standard tasks are solved, and what each ingredient is worth.

    python -m studies.tasks [options: see studies/cells.py]

Every cell of ``tasks.yaml`` is a population of searches in ``runs/tasks/TABLE/CELL``.  Tables of
all kept results are written to ``tasks.md`` beside them, for ``docs/tasks.md``.
"""

from __future__ import annotations

import json
import math
import statistics
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

from edtorch.report.proportions import Proportion
from edtorch.run.files import write_text
from studies import cells as making
from studies.cells import Finished

KEPT = Path("runs/reference/tasks")
PUBLISHED = Path(__file__).with_name("tasks_published.yaml")


def within(summary: Mapping[str, Any], seconds: float) -> Proportion:
    """How many of the seeds had solved their task after so many seconds of experience."""
    solved = summary["seconds_to_solved"]["per_seed"]
    return Proportion(sum(s is not None and s <= seconds + 1e-9 for s in solved), len(solved))


def seconds_told(summary: Mapping[str, Any]) -> str:
    """Median [least, greatest], an unsolved seed counting as infinity."""
    spread = summary["seconds_to_solved"]
    return "{} [{}, {}]".format(*(_number(spread[name]) for name in ("median", "min", "max")))


def _number(value: float | None) -> str:
    return "∞" if value is None else f"{value:.3g}"


def share(proportion: Proportion) -> str:
    """Count, share and Wilson's 95 % interval."""
    low, high = proportion.wilson()
    percent = f"{100 * proportion.rate:.1f} % [{100 * low:.1f}, {100 * high:.1f}]"
    return f"{proportion.count} of {proportion.total}: {percent}"


def record_row(name: str, summary: Mapping[str, Any], about: Mapping[str, Any]) -> list[str]:
    """One row of the table of records."""
    limit = float(about.get("within", math.inf))
    rates = summary.get("success_rate") or summary["return"]
    fresh = [rate for rate in rates["per_seed"] if rate is not None]
    cpu = [s for own in summary["cpu_s_of_trial"] for s in own]
    return [
        name.replace("_", " "),
        seconds_told(summary),
        f"{share(within(summary, limit))} within {limit:g} s",
        f"{statistics.median(fresh):.4g} [{min(fresh):.4g}]",
        f"{statistics.median(cpu):.1f}",
        summary["told"],
        str(about.get("published", "–")),
    ]


def ablation_row(name: str, summary: Mapping[str, Any]) -> list[str]:
    """One row of an ablation: solved after the first trial, and at all."""
    trials = summary["trials_to_solved"]["per_seed"]
    return [
        name.replace("_", " "),
        share(Proportion(sum(count == 1 for count in trials), len(trials))),
        share(within(summary, math.inf)),
        seconds_told(summary),
        f"{statistics.median(s for own in summary['cpu_s_of_trial'] for s in own):.1f}",
    ]


def other_row(name: str, summary: Mapping[str, Any]) -> list[str]:
    """One row of a method without trials to count: what it had, and how good it was then."""
    rates = summary["success_rate"]["per_seed"]
    return [
        name.replace("_", " "),
        f"{max(summary['simulated_seconds']):g}",
        share(within(summary, math.inf)),
        seconds_told(summary),
        f"{statistics.median(rates):.4g} [{min(rates):.4g}, {max(rates):.4g}]",
        f"{summary['cpu_s'] / len(rates):.1f}",
    ]


RECORDS = (
    *("task", "seconds to solved, median [min, max]", "solved, Wilson 95 %"),
    *("success, or return, in other episodes, median [min]", "CPU s a trial", "told", "published"),
)
OTHERS = (
    *("task", "seconds of experience, at most", "solved", "seconds to solved, median [min, max]"),
    *("success in other episodes, median [min, max]", "CPU s a seed"),
)
OTHER_METHODS = ("online", "rivals")
"""Tables of methods that do not search between trials."""
ABLATION = (
    *("without", "solved after the first trial", "solved", "seconds, median [min, max]"),
    "CPU s a trial",
)
HEADERS = {
    "records": RECORDS,
    "gradient": ("policy, and belief", *ABLATION[1:]),
    **dict.fromkeys(OTHER_METHODS, OTHERS),
}
"""By table; ABLATION of all others."""


def table(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """In Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def report(study: Finished) -> int:
    """Write the tables of what is kept, now or before; nothing else can fail to be made."""
    if study.keep is None:
        return 0
    published = yaml.safe_load(PUBLISHED.read_text(encoding="utf-8"))
    parts: dict[str, list[list[str]]] = {}
    for cell in study.plan.cells:
        place = cell.folder(study.keep) / "summary.json"
        if not place.exists():
            continue
        summary = json.loads(place.read_text(encoding="utf-8"))
        own = parts.setdefault(cell.table, [])
        if cell.table == "records":
            own.append(record_row(cell.name, summary, published.get(cell.name, {})))
        elif cell.table in OTHER_METHODS:
            own.append(other_row(cell.name, summary))
        else:
            own.append(ablation_row("nothing" if cell.baseline else cell.name, summary))
    texts = [
        f"## {name.replace('_', ' ').capitalize()}\n\n" + table(HEADERS.get(name, ABLATION), rows)
        for name, rows in parts.items()
    ]
    if texts:
        write_text(study.keep / "tasks.md", "\n".join(texts))
        print("\n".join(texts))
    return 0


def main() -> None:
    about = "Seconds of experience until the standard tasks are solved."
    making.main("tasks", about, report, output=Path("runs/tasks"), keep=KEPT)


if __name__ == "__main__":
    main()
