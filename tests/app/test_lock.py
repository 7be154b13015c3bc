"""The lock of a run's folder; what commands do with it is in ``test_resume``."""

from __future__ import annotations

import os
import time
from pathlib import Path

import pytest

from edtorch.app import lock
from edtorch.app.lock import LOCK, STALE, Lock


def test_a_process_gives_signs_of_life_whatever_it_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, patience: float
) -> None:
    monkeypatch.setattr(lock, "BEAT", 0.01)
    path, deadline = tmp_path / LOCK, time.monotonic() + patience
    with Lock(tmp_path).held():
        os.utime(path, (0, 0))
        while path.stat().st_mtime < time.time() - STALE:
            assert time.monotonic() < deadline
            time.sleep(0.01)
    assert not path.exists()
