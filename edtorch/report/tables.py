"""Tables as plain data, and as plain text or Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Table:
    """Cells are texts; the first column names the row.  note: below it, may be empty."""

    title: str
    header: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    note: str = ""

    def __post_init__(self) -> None:
        """Refuse rows that do not fit."""
        for row in self.rows:
            if len(row) != len(self.header):
                raise ValueError(f"rows: {row!r}: expected {len(self.header)} cells")


def as_text(table: Table) -> str:
    """Columns in line, for a terminal; a line is as long as it must be."""
    lines = [table.header, *table.rows]
    widths = [max(len(line[k]) for line in lines) for k in range(len(table.header))]

    def line(cells: Sequence[str]) -> str:
        first = cells[0].ljust(widths[0])
        rest = (cell.rjust(width) for cell, width in zip(cells[1:], widths[1:], strict=True))
        return "  ".join([first, *rest]).rstrip()

    rule = "-" * len(line(["-" * width for width in widths]))
    note = [table.note] if table.note else []
    return "\n".join([table.title, line(table.header), rule, *map(line, table.rows), *note])


def as_markdown(table: Table) -> str:
    """Without the title."""

    def line(cells: Sequence[str]) -> str:
        return f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in cells)} |"

    note = ["", table.note] if table.note else []
    rule = f"|{'---|' * len(table.header)}"
    return "\n".join([line(table.header), rule, *map(line, table.rows), *note])
