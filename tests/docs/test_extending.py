"""The code of docs/extending.md runs as printed, from an empty folder, one block after another."""

from __future__ import annotations

import importlib
import re
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.app.conftest import call

PAGE = Path(__file__).resolve().parents[2] / "docs" / "extending.md"
FENCE = re.compile(r"^```(\w+)\n(.*?)^```", re.M | re.S)
SHORT = (
    "eval.episodes=1",
    "seeds=2",
    "log.tensorboard=false",
    "log.figures=false",
    "compute.native=off",
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    """An empty current folder, of which nothing stays imported."""
    before = set(sys.modules)
    monkeypatch.setattr(sys, "path", list(sys.path))
    monkeypatch.chdir(tmp_path)
    yield tmp_path
    for name in set(sys.modules) - before:
        if str(tmp_path) in str(getattr(sys.modules[name], "__file__", "")):
            del sys.modules[name]


def _commands(block: str) -> Iterator[list[str]]:
    for line in block.replace("\\\n", " ").splitlines():
        words = shlex.split(line, comments=True)
        if words:
            yield words


def _run(words: list[str], number: int) -> None:
    assert words[0] in ("edtorch-train", "edtorch-eval"), words
    result = call(*words, *SHORT, f"hydra.run.dir=run_{number}")
    assert result.status == 0, (words, result.err)


@pytest.mark.experiment
def test_every_block_runs(folder: Path) -> None:
    number = 0
    for language, block in FENCE.findall(PAGE.read_text(encoding="utf-8")):
        named = re.match(r"# (\S+\.(?:py|yaml))\n", block)
        if language == "sh":
            for words in _commands(block):
                number += 1
                _run(words, number)
        elif named:
            path = folder / named[1]
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(block, encoding="utf-8")
            importlib.invalidate_caches()
        else:
            assert language == "python", f"a block that is neither a file nor a command:\n{block}"
            exec(compile(block, PAGE.name, "exec"), {})
    assert number > 5
