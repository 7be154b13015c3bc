"""Cells made in this process, without the seconds that a process of their own takes to start."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from studies import cells
from studies.cells import Cell
from tests.app.conftest import call


class _OneByOne:
    """In place of the pool of threads: a run in this process wants its signals."""

    def __init__(self, _: int) -> None: ...

    def shutdown(self, *, cancel_futures: bool) -> None: ...

    def map(self, function: Callable[[Cell], int], some: list[Cell]) -> list[int]:
        return [function(cell) for cell in some]


def _python(code: str, arguments: list[str], log: Path | None = None) -> int:
    """What ``python -c CODE ARGUMENTS`` would do."""
    name = "edtorch-train" if code == cells.TRAIN else "edtorch-report"
    result = call(name, *arguments)
    if log is not None:
        log.write_text(result.out + result.err)
    return result.status


def in_this_process(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cells, "ThreadPoolExecutor", _OneByOne)
    monkeypatch.setattr(cells, "python", _python)
