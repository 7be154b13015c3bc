"""The runs that the rerun tells of, by row of its tables."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from edtorch.report.runs import Run

FIGURE_2 = "figure_2/bicycle_paper"
FIGURE_3 = ("figure_3/cardea_paper", "figure_3/cardea")


@dataclass(frozen=True)
class Material:
    """runs: by row, ``TABLE/NAME``, those that there are; missing: by cell, why it is not there."""

    runs: Mapping[str, Sequence[Run]]
    missing: Mapping[str, str]

    @property
    def methods(self) -> list[str]:
        """The rows of the table of methods."""
        rows = [row for row in self.runs if row.startswith("methods/")]
        return [FIGURE_2, *rows] if FIGURE_2 in self.runs else rows

    def lost(self, row: str) -> dict[str, str]:
        """Of a row, the cells that are not there."""
        return {
            title: why
            for title, why in self.missing.items()
            if title == row or title.startswith(f"{row}/")
        }
