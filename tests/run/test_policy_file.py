"""Saved and loaded, a learner goes on as if nothing had been; bad files are named."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import torch

from edtorch.run.files import FileProblem, write_text
from edtorch.run.policy_file import PolicyCard, load_policy, save_policy

CARD = PolicyCard("bicycle", ["lean"], ["torque"], [0.2, 2.0], "LinearPolicy(Identity)", [0, 1])
SHAPES = {"weight": (1, 1)}


def test_policies_come_back_as_they_went(tmp_path: Path) -> None:
    policy = {"weight": torch.randn(2, 1, 1, dtype=torch.float64)}
    save_policy(tmp_path / "p.safetensors", policy, CARD)
    loaded = load_policy(tmp_path / "p.safetensors", CARD, SHAPES)
    assert torch.equal(loaded["weight"], policy["weight"])


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("domain", "cardea", "made for domain bicycle, expected domain cardea"),
        ("states", ["tilt"], "made for states"),
        ("scales", [1.0, 2.0], "made for scales"),
        ("policy", "LinearPolicy(Affine)", "made for policy"),
        ("seeds", [0], "made for seeds"),
    ],
)
def test_a_policy_for_something_else_is_refused(
    tmp_path: Path, field: str, value: Any, message: str
) -> None:
    save_policy(tmp_path / "p.safetensors", {"weight": torch.zeros(2, 1, 1)}, CARD)
    expected = replace(CARD, **{field: value})
    with pytest.raises(FileProblem, match=message):
        load_policy(tmp_path / "p.safetensors", expected, SHAPES)


def test_a_policy_of_another_size_or_no_policy_is_refused(tmp_path: Path) -> None:
    save_policy(tmp_path / "p.safetensors", {"weight": torch.zeros(2, 1, 1)}, CARD)
    with pytest.raises(FileProblem, match=r"has shape \(2, 1, 1\), expected \(2, 1, 7\)"):
        load_policy(tmp_path / "p.safetensors", CARD, {"weight": (1, 7)})
    whole = (tmp_path / "p.safetensors").read_bytes()
    for content in (b"", b"junk" * 10, whole[: len(whole) // 2]):
        (tmp_path / "p.safetensors").write_bytes(content)
        with pytest.raises(FileProblem, match="not a saved policy"):
            load_policy(tmp_path / "p.safetensors", CARD, SHAPES)


def test_a_file_that_cannot_be_finished_leaves_the_old_one(tmp_path: Path) -> None:
    write_text(tmp_path / "a.txt", "old")
    with pytest.raises(UnicodeEncodeError):
        write_text(tmp_path / "a.txt", "\ud800")
    assert (tmp_path / "a.txt").read_text() == "old"
    assert os.listdir(tmp_path) == ["a.txt"]
