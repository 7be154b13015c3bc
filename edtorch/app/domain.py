"""From the group ``domain`` to a sim."""

from __future__ import annotations

from typing import Any

from edtorch.app.construct import argument, construct
from edtorch.app.errors import ConfigError, unknown_key
from edtorch.app.given import Given
from edtorch.app.settings import Settings
from sims.base import Sim


def build_sim(config: Any) -> Sim:
    """The domain."""
    if isinstance(config, Settings) and "given" in config:
        return argument("domain", config.given if isinstance(config.given, Given) else config)
    return construct("domain", config, "initial", "restart", "step", "observe", "outcome")


def changed_domain(domain: Any, changes: Any, key: str) -> Settings:
    """The domain's node with the changes asked for under ``key``; unknown names are refused."""
    if not isinstance(domain, Settings):
        raise ConfigError(f"domain={domain}: expected a mapping with a _target_")
    known = sorted(str(k) for k in domain if k != "_target_")
    for name, value in changes.items():
        if name not in domain:
            raise ConfigError(unknown_key(f"{key}.{name}={value}", f"{key}.{name}", known))
    return domain.merged(changes)
