"""Functions told apart by what they compute."""

from __future__ import annotations

import json
from collections.abc import Callable
from enum import IntEnum

import pytest

from edtorch.errors import Unavailable
from edtorch.native.fingerprint import fingerprint


def scaled(factor: float, inner: Callable[[float], float]) -> Callable[[float], float]:
    def function(x: float) -> float:
        return factor * inner(x)

    return function


def same(x: float) -> float:
    return x


def other(x: float) -> float:
    return -x


def test_a_fingerprint_follows_what_a_function_closes_over() -> None:
    texts = [fingerprint(scaled(f, g)) for f in (1.0, 2.0) for g in (same, other)]
    assert len(set(texts)) == 4
    assert fingerprint(scaled(1.0, same)) == texts[0]
    assert "0x" not in "".join(texts)


def keyed(value: float) -> Callable[[float], float]:
    def function(x: float, *, factor: float = value) -> float:
        return factor * x

    return function


def test_a_fingerprint_follows_defaults_and_members() -> None:
    assert fingerprint(keyed(1.0)) != fingerprint(keyed(2.0))
    kinds = [IntEnum("Kind", {"ONE": value}) for value in (1, 2)]
    texts = [fingerprint(scaled(1.0, lambda x, kind=kind: x + kind.ONE)) for kind in kinds]
    assert texts[0] != texts[1]


def test_a_fingerprint_refuses_modules_whose_content_may_change() -> None:
    with pytest.raises(Unavailable, match=r"module json: expected its functions and numbers"):
        fingerprint(lambda x: json.decoder)


def test_a_fingerprint_refuses_what_it_cannot_describe() -> None:
    with pytest.raises(Unavailable, match="object: expected functions, numbers"):
        fingerprint(scaled(object(), same))  # pyright: ignore[reportArgumentType]
