"""States come back as they were, and files that are not whole are refused."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from safetensors.numpy import save_file

from edtorch.run.files import FileProblem
from edtorch.run.state_file import load_state, save_state


def _state() -> dict[str, Any]:
    torch.manual_seed(0)
    shared = torch.arange(6.0, dtype=torch.float64).reshape(2, 3)
    return {
        "same": shared,
        "again": shared,
        "turned": shared.T,
        "inside out": torch.rand(2, 3, 4, 5).permute(3, 1, 0, 2),
        "scalar": torch.tensor(3, dtype=torch.int64),
        "none": torch.zeros(0, 4, dtype=torch.float32),
        "flags": torch.tensor([True, False]),
        "odd": torch.tensor([math.nan, math.inf, -0.0, 5e-324], dtype=torch.float64),
        "words": np.array([2**64 - 1, 0], dtype=np.uint64),
        "generator": np.random.default_rng(3).bit_generator.state,
        "plain": [1, 2.5, None, "text", False, math.inf, {"deep": [0.1 + 0.2]}],
    }


def _same(one: Any, other: Any) -> bool:
    if isinstance(one, torch.Tensor):
        in_memory = one.numel() == 0 or one.stride() == other.stride()
        alike = (one.dtype, one.shape) == (other.dtype, other.shape)
        return alike and in_memory and _bits(one) == _bits(other)
    if isinstance(one, np.ndarray):
        return one.dtype == other.dtype and one.tobytes() == other.tobytes()
    if isinstance(one, dict):
        return list(one) == list(other) and all(_same(one[k], other[k]) for k in one)
    if isinstance(one, list):
        return len(one) == len(other) and all(map(_same, one, other))
    return type(one) is type(other) and one == other


def _bits(tensor: torch.Tensor) -> bytes:
    return tensor.contiguous().numpy().tobytes()


def test_a_state_comes_back_bit_for_bit(tmp_path: Path) -> None:
    path = tmp_path / "state.safetensors"
    save_state(path, _state())
    assert _same(load_state(path), _state())
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize("value", [{1: 2}, object(), 1j, {"$tensor": 1}])
def test_nothing_else_is_saved(tmp_path: Path, value: object) -> None:
    with pytest.raises(TypeError, match=r"\.here"):
        save_state(tmp_path / "state.safetensors", {"here": value})
    assert not list(tmp_path.iterdir())


def test_every_damaged_byte_is_noticed(tmp_path: Path) -> None:
    """Whichever bit of the file is another, it is refused, or read as it was written."""
    path, damaged = tmp_path / "state.safetensors", tmp_path / "damaged.safetensors"
    save_state(path, _state())
    content = path.read_bytes()
    for place in range(0, len(content), 37):
        damaged.write_bytes(content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :])
        try:
            assert _same(load_state(damaged), _state())
        except FileProblem as error:
            assert str(damaged) in str(error)


@pytest.mark.parametrize("part", [0, 5, 0.5, -1])
def test_half_a_file_is_refused(tmp_path: Path, part: float) -> None:
    path = tmp_path / "state.safetensors"
    save_state(path, _state())
    content = path.read_bytes()
    path.write_bytes(content[: int(part if part in (0, 5, -1) else part * len(content))])
    with pytest.raises(FileProblem, match="damaged"):
        load_state(path)


def test_other_files_and_later_formats_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "state.safetensors"
    save_file({"weight": np.zeros(3)}, path)
    with pytest.raises(FileProblem, match="names no format"):
        load_state(path)
    save_file({}, path, {"format": "2", "state": "{}", "digest": ""})
    with pytest.raises(FileProblem, match=r"format 2, expected 1 at most.*later version"):
        load_state(path)
    with pytest.raises(FileProblem, match=r"missing\.safetensors"):
        load_state(tmp_path / "missing.safetensors")
