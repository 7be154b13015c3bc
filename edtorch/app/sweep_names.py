"""What a job of a sweep is known by: the overrides that can change its results."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence

NO_SETTINGS = ("debug", "log.progress", "sweep.name", "sweep.retry")
"""Overrides that change no result, beside those of Hydra: jobs that differ in these alone are the
same job."""
DIGITS = 10
"""Of the name of a job's folder."""


def key_of(override: str) -> str:
    """Which setting or group it is for."""
    return override.lstrip("+~").partition("=")[0]


def significant(overrides: Sequence[str]) -> list[str]:
    """Those that can change results, sorted, without the signs that add a setting."""

    def tells(key: str) -> bool:
        return key not in NO_SETTINGS and not key.startswith(("hydra.", "hydra/"))

    return sorted(override.lstrip("+") for override in overrides if tells(key_of(override)))


def hash_of(overrides: Sequence[str]) -> str:
    """The name of the folder of a job with these overrides, whatever their order."""
    text = "\n".join(significant(overrides))
    return hashlib.sha256(text.encode()).hexdigest()[:DIGITS]
