"""The episodes that a run kept, read back."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path

from edtorch.run.episodes import Episode
from sims.base import Outcome


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
