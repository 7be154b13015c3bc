"""The paper's Figure 3 of several runs at once, from what their folders hold.

    python -m studies.cardea_figure FOLDER FILE LABEL=RUN [LABEL=RUN ...]

Writes ``FILE.png`` and ``FILE.svg`` into ``FOLDER``.
"""

from __future__ import annotations

import csv
import sys
from collections.abc import Sequence
from pathlib import Path

from edtorch.report.domain import Domain
from edtorch.report.figures import save_figure
from edtorch.report.task_curve import task_curve
from edtorch.run.episodes import Episode
from sims.base import Outcome
from sims.cardea.cardea import MEASURES, WORDS


def episodes_of(folder: Path, measures: Sequence[str] = ()) -> tuple[list[Episode], int]:
    """The finished episodes of a run, with these measures, and how many learners it has."""
    with (folder / "episodes.csv").open(newline="", encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    seeds = sorted({int(row["seed"]) for row in rows})
    episodes = [
        Episode(
            row=seeds.index(int(row["seed"])),
            number=int(row["episode"]),
            start=float(row["start_s"]),
            seconds=float(row["seconds"]),
            outcome=Outcome[row["outcome"].upper()],
            measures={name: float(row[name]) for name in measures},
        )
        for row in rows
    ]
    return episodes, len(seeds)


def main() -> None:
    folder, name, *given = sys.argv[1:]
    pairs = (argument.partition("=") for argument in given)
    runs = {label: episodes_of(Path(path), [m.name for m in MEASURES]) for label, _, path in pairs}
    title = "Cardea: error and speed at the ends of the episodes, with 2 % torque noise"
    figure = task_curve(runs, Domain("cardea", WORDS, MEASURES), title)
    save_figure(figure, Path(folder), name)


if __name__ == "__main__":
    main()
