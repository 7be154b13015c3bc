"""Objects that a Python caller hands over in place of a setting."""

from __future__ import annotations

import sys
from collections.abc import Mapping
from typing import Any

from edtorch.app.settings import Settings


class Given:
    """An object among the settings.  It is shared, never copied, by copies of the settings."""

    def __init__(self, value: Any) -> None:
        self.value = value

    def __deepcopy__(self, memo: dict[int, Any]) -> Given:
        return self

    def __repr__(self) -> str:
        return name_of(self.value)


def name_of(value: Any) -> str:
    """The full name of a function or class, that of its class for any other object."""
    named = value if hasattr(value, "__qualname__") else type(value)
    return f"{named.__module__}.{named.__qualname__}"


def with_objects(config: Mapping[str, Any], changes: Mapping[str, Any]) -> Settings:
    """``config`` with other nodes at its top, which may hold objects."""
    return Settings({**config, **changes})


def without_objects(node: Any) -> Any:
    """Settings as text can hold them: functions and classes of modules by their full name, so that
    they are found again; of any other object only that there was one."""
    if isinstance(node, Given):
        name = name_of(node.value)
        if _importable(node.value):
            return {"_target_": name, "_partial_": True}
        return {"given": name}
    if isinstance(node, Mapping):
        return {str(key): without_objects(value) for key, value in node.items()}
    if isinstance(node, list | tuple):
        return [without_objects(value) for value in node]
    return node


def _importable(value: Any) -> bool:
    module, name = getattr(value, "__module__", None), getattr(value, "__qualname__", None)
    if module in (None, "__main__") or name is None or "<" in name:
        return False
    found: Any = sys.modules.get(module)
    for part in name.split("."):
        found = getattr(found, part, None)
    return found is value
