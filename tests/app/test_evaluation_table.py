"""The table of edtorch-eval on a terminal of any width."""

from io import StringIO

import pytest
from rich.console import Console
from rich.table import Table

from edtorch.app.evaluate import _print_whole  # pyright: ignore[reportPrivateUsage]

FIGURES = ["-79.723", "1,028.7", "370.33", "0.98123"]


@pytest.mark.parametrize("width", [10, 25, 40, 200])
def test_no_word_or_figure_is_cut(width: int) -> None:
    table = Table()
    for heading in ("shaping reward, summed over time", "path, m", "episode, s", "share"):
        table.add_column(heading)
    table.add_row(*FIGURES)
    printed = StringIO()
    _print_whole(Console(file=printed, width=width), table)
    assert "…" not in printed.getvalue()
    assert all(text in printed.getvalue() for text in [*FIGURES, "shaping", "episode,"])
