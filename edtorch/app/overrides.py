"""The overrides that the user typed, which messages repeat."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from contextvars import ContextVar

from edtorch.renamed import former_keys

_TYPED: ContextVar[Sequence[str] | None] = ContextVar("typed", default=None)


@contextmanager
def typing(overrides: Sequence[str]) -> Iterator[None]:
    """Meanwhile these are what the user typed, instead of the command line."""
    token = _TYPED.set(overrides)
    try:
        yield
    finally:
        _TYPED.reset(token)


def typed() -> list[str]:
    """The overrides of the present command or call, as they were typed."""
    overrides = _TYPED.get()
    return list(sys.argv[1:] if overrides is None else overrides)


def given(key: str) -> str | None:
    """The override of ``key`` as it was typed, without its sign; None if there was none."""
    for override in reversed(typed()):
        bare = override.lstrip("+~")
        if bare.partition("=")[0] in {key, *former_keys(key)}:
            return bare
    return None


def given_name(key: str) -> str:
    """``key``, by the former name that the user typed if that is what was typed."""
    found = given(key)
    return key if found is None else found.partition("=")[0]
