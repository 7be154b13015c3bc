"""The random numbers of kernels: those of ``edtorch.run.hashing``, bit for bit."""

from __future__ import annotations

from typing import Any

import torch

from edtorch.native.source import FOLDER
from edtorch.run.hashing import Use, hash_key, uniform


def test_the_numbers_of_kernels_are_those_of_the_hash() -> None:
    """Their text, run as plain Python; no product leaves int64, as the hash's own do not."""
    text: dict[str, Any] = {"inner": lambda function: function}
    exec((FOLDER / "hashing.py").read_text(encoding="utf-8"), text)
    key = hash_key(Use.EPISODE, 2**62 + 5, torch.arange(50))
    clock = torch.tensor([0, 1, 77, 2**29, 2**31 - 1]).repeat(10)
    wanted = uniform(key, clock, 3)
    for row, (first, second) in enumerate(key.tolist()):
        counter = 3 * int(clock[row])
        found = [text["hashed"](first, second, counter + place) for place in range(3)]
        assert found == wanted[row].tolist()
