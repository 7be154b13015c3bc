"""Without the extra [cardea] everything else works, and what needs it says what to install."""

from __future__ import annotations

import sys

import pytest

from edtorch.app.construct import construct
from edtorch.app.errors import ConfigError
from sims.cardea import Cardea
from sims.cardea.physics import URDF
from sims.kinematics import Chain


def test_without_pybullet(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pybullet", None)
    with pytest.raises(
        ModuleNotFoundError, match=r"needs PyBullet.* expected: pip install .*cardea"
    ):
        Cardea()
    with pytest.raises(ConfigError, match=r"domain\._target_=sims.*pip install") as refusal:
        construct("domain", {"_target_": "sims.cardea.Cardea"})
    assert "\n" not in str(refusal.value)


def test_without_pytorch_kinematics(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "pytorch_kinematics", None)
    with pytest.raises(ModuleNotFoundError, match=r"pytorch-kinematics.* expected: pip install"):
        Chain(URDF, "body", "hand")
