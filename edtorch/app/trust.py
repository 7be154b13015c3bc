"""Whose code a saved configuration may import."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from edtorch.app.errors import ConfigError

_OURS = ("edtorch", "sims")


def check_trust(node: Any, trust: bool | Sequence[str], key: str = "") -> None:
    """Refuse settings that would import code of packages that are neither ours nor trusted.

    node: a configuration, or a part of it; trust: names of packages, True: any.  Raises
    ConfigError.
    """
    if trust is True:
        return
    trusted = {*_OURS, *(trust or ())}
    for name, value in node.items() if isinstance(node, Mapping) else ():
        full = f"{key}.{name}" if key else str(name)
        if isinstance(value, Mapping):
            check_trust(value, trust, full)
        elif isinstance(value, str):
            imported = value.split(".")[0] if name == "_target_" else ""
            if name == "env_id" and ":" in value:
                imported = value.split(":")[0].split(".")[0]
            if imported and imported not in trusted:
                raise ConfigError(
                    f"{full}={value}: code of {imported!r} would be imported; expected"
                    f" trust=[{imported!r}], or trust=True for any"
                )


def trusted(given: Any) -> bool | Sequence[str]:
    """``trust`` as it was typed: true, or names of packages.  Raises ConfigError."""
    if isinstance(given, bool):
        return given
    names = [given] if isinstance(given, str) else given
    if not isinstance(names, Sequence) or not all(isinstance(name, str) for name in names):
        raise ConfigError(f"trust={given}: expected true, or names of packages, [NAME,...]")
    return names
