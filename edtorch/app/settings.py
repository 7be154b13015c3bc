"""A complete configuration as a plain, frozen tree, which the builders read."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any


class Settings(Mapping[str, Any]):
    """A mapping whose values are also attributes; nested mappings are ``Settings``, lists lists.

    ``settings.unroll.horizon`` is ``settings["unroll"]["horizon"]``.
    """

    def __init__(self, content: Mapping[str, Any]) -> None:
        self._content = {str(key): _frozen(value) for key, value in content.items()}

    def __getitem__(self, key: str) -> Any:
        return self._content[key]

    def __iter__(self) -> Iterator[str]:
        return iter(self._content)

    def __len__(self) -> int:
        return len(self._content)

    def __getattr__(self, name: str) -> Any:
        # Without an underscore: pickle asks for methods before there is any content.
        if not name.startswith("_") or name == "_target_":
            try:
                return self._content[name]
            except KeyError:
                pass
        raise AttributeError(f"these settings have no {name}")

    def __repr__(self) -> str:
        return repr(self.plain())

    def plain(self) -> dict[str, Any]:
        """The same as dicts and lists."""
        return {key: plain(value) for key, value in self._content.items()}

    def without(self, *keys: str) -> Settings:
        """A copy that lacks these keys."""
        return Settings({key: value for key, value in self.items() if key not in keys})

    def merged(self, changes: Mapping[str, Any]) -> Settings:
        """A copy with ``changes``, which reach into nested mappings."""
        return Settings(merged(self, changes))


def plain(value: Any) -> Any:
    """A value of ``Settings`` as dicts and lists."""
    if isinstance(value, Mapping):
        return {str(key): plain(each) for key, each in value.items()}
    return [plain(each) for each in value] if isinstance(value, list | tuple) else value


def _frozen(value: Any) -> Any:
    if isinstance(value, Mapping):
        return value if isinstance(value, Settings) else Settings(value)
    return [_frozen(each) for each in value] if isinstance(value, list | tuple) else value


def merged(base: Mapping[str, Any], changes: Mapping[str, Any]) -> dict[str, Any]:
    """``base`` with ``changes``, mappings within mappings merged in turn."""
    result = dict(base)
    for key, value in changes.items():
        before = result.get(key)
        if isinstance(before, Mapping) and isinstance(value, Mapping):
            result[key] = merged(before, value)
        else:
            result[key] = value
    return result
