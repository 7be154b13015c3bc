"""What can be said of a configuration before anything is built from it."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any

from edtorch.app.errors import ConfigError
from edtorch.app.settings import Settings


def at_least(key: str, value: float, least: float) -> None:
    """Refuse what is no finite number of at least ``least``."""
    if not (math.isfinite(value) and value >= least):
        kind = "an integer" if isinstance(value, int) else "a finite number"
        raise ConfigError(f"{key}={value}: expected {kind} >= {least:g}")


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
