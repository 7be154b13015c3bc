"""Every configuration in ``runs/reference`` still builds: what made a result can be run again."""

from __future__ import annotations

from pathlib import Path

import pytest

from edtorch.app.errors import ConfigError
from edtorch.app.rundir import CONFIG, load_config
from edtorch.app.work import planned

REFERENCE = Path(__file__).parents[2] / "runs" / "reference"
LACK_THEIR_DATA = {"paper/methods/bicycle_offline"}
"""Whose transitions are not kept in the repository."""


@pytest.mark.oracle
def test_every_saved_configuration_builds(monkeypatch: pytest.MonkeyPatch) -> None:
    pytest.importorskip("pybullet", reason="the extra [cardea] is not installed: no PyBullet")
    monkeypatch.chdir(REFERENCE.parents[1])
    folders = sorted(path.parent for path in REFERENCE.rglob(CONFIG))
    refused = {}
    for folder in folders:
        try:
            seeds, _ = planned(load_config(folder))
        except ConfigError as error:
            refused[folder.relative_to(REFERENCE).as_posix()] = str(error)
        else:
            assert seeds, folder
    assert len(folders) > 100
    assert refused.keys() == LACK_THEIR_DATA
    assert all("no such file" in line for line in refused.values())
