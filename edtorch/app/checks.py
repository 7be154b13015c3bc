"""What can be said of a configuration before anything is built from it."""

from __future__ import annotations

import math
from typing import Any

from omegaconf import DictConfig, ListConfig, OmegaConf

from edtorch.app.construct import known_keys
from edtorch.app.errors import ConfigError, unknown_key


def at_least(key: str, value: float, least: float) -> None:
    """Refuse what is no finite number of at least ``least``."""
    if not (math.isfinite(value) and value >= least):
        kind = "an integer" if isinstance(value, int) else "a finite number"
        raise ConfigError(f"{key}={value}: expected {kind} >= {least:g}")


def check_keys(config: DictConfig) -> None:
    """Refuse keys that were forced in with "+" beside those of a schema."""
    kind = OmegaConf.get_type(config)
    for key in config:
        node = config._get_node(key)
        if key not in getattr(kind, "__dataclass_fields__", (key,)):
            raise ConfigError(unknown_key(f"{key}={node}", str(key), sorted(kind.__annotations__)))
        if isinstance(node, DictConfig) and not node._is_none():
            fields = getattr(OmegaConf.get_type(node), "__dataclass_fields__", None)
            if fields is not None:
                known_keys(str(key), node, set(fields))


def check_numbers(config: Any, key: str = "") -> None:
    """Refuse NaN everywhere, and infinities where a constructor of ours would take them."""
    items: list[tuple[str, Any]] = []
    if isinstance(config, DictConfig) and not config._is_missing() and not config._is_none():
        items = [(f"{key}.{k}" if key else str(k), config[k]) for k in config]
    elif isinstance(config, ListConfig):
        items = [(f"{key}[{i}]", value) for i, value in enumerate(config)]
    for name, value in items:
        check_numbers(value, name)
        if isinstance(value, float) and (
            math.isnan(value) or (math.isinf(value) and not name.startswith("domain."))
        ):
            raise ConfigError(f"{name}={value}: expected a finite number")


def check_seeds(config: DictConfig) -> None:
    """Refuse seeds that are none."""
    at_least("seed", config.seed, 0)
    at_least("seeds", config.seeds, 1)
    if config.seed + config.seeds > 2**63:
        raise ConfigError(f"seed={config.seed}: expected seed + seeds <= 2^63")
