"""What can be said of a configuration before anything is built from it."""

from __future__ import annotations

import math
from collections.abc import Iterable, Mapping
from typing import Any

from edtorch.app.errors import ConfigError
from edtorch.app.overrides import given, typed
from edtorch.app.settings import Settings


def at_least(key: str, value: float, least: float) -> None:
    """Refuse what is no finite number of at least ``least``."""
    if not (math.isfinite(value) and value >= least):
        kind = "an integer" if isinstance(value, int) else "a finite number"
        raise ConfigError(f"{key}={value}: expected {kind} >= {least:g}")


def positive(key: str, value: float) -> None:
    """Refuse what is no finite number above 0."""
    if not (math.isfinite(value) and value > 0):
        raise ConfigError(f"{key}={value}: expected a number > 0")


def check_component(key: str, value: Any, name: str, known: Iterable[str]) -> None:
    """Refuse a ``name`` of a component that the domain does not have."""
    known = list(known)
    if name not in known:
        raise ConfigError(f"{key}={value}: expected one of {', '.join(known)}{preset_hint(key)}")


def preset_hint(key: str) -> str:
    """For a setting that does not fit the domain: the preset that made it, "" if it was typed."""
    words = [override.lstrip("+~").partition("=")[0] for override in typed()]
    if given(key) or any(f"{key}.".startswith(f"{word}.") for word in words):
        return ""
    preset = given("experiment") or "the default experiment"
    return f"; {preset} sets it for another domain, experiment=regulation takes any"


def check_numbers(config: Any, key: str = "") -> None:
    """Refuse NaN everywhere, and infinities where a constructor of ours would take them."""
    items: list[tuple[str, Any]] = []
    if isinstance(config, Mapping):
        items = [(f"{key}.{k}" if key else str(k), config[k]) for k in config]
    elif isinstance(config, list):
        items = [(f"{key}[{i}]", value) for i, value in enumerate(config)]
    for name, value in items:
        check_numbers(value, name)
        if isinstance(value, float) and (
            math.isnan(value) or (math.isinf(value) and not name.startswith("domain."))
        ):
            raise ConfigError(f"{name}={value}: expected a finite number")


def check_seeds(config: Settings) -> None:
    """Refuse numbers of seeds that are out of range."""
    at_least("seed", config.seed, 0)
    at_least("seeds", config.seeds, 1)
    if config.seed + config.seeds > 2**63:
        raise ConfigError(f"seed={config.seed}: expected seed + seeds <= 2^63")
