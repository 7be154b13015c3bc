"""A number that is refused is refused by the key and in the unit in which it was typed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from copy import deepcopy
from typing import Any

import pytest
import yaml

from edtorch.app.build import build
from edtorch.app.build_planned import build_planned, is_planned
from edtorch.app.compose import CONF, compose
from edtorch.app.errors import ConfigError
from edtorch.app.random_search import build_search, is_rival, is_search
from edtorch.app.rivals import build_rival
from edtorch.app.schema import checked
from tests.app.test_configs import BESIDE, OPTIONS, RIVALS


def _numbers(node: Mapping[str, Any], before: tuple[str, ...] = ()) -> Iterator[tuple[str, ...]]:
    """The paths of the numbers in nested settings; of parts of one kind, those of the first."""
    kinds: set[frozenset[str]] = set()
    for key, value in node.items():
        path = (*before, key)
        if isinstance(value, Mapping):
            kind = frozenset(value)
            if kind not in kinds or _are_names(value):
                yield from _numbers(value, path)
            kinds.add(kind)
        elif isinstance(value, int | float) and not isinstance(value, bool):
            yield path


def _are_names(node: Mapping[str, Any]) -> bool:
    """Whether the keys are components of a domain, which many settings are given by."""
    return all(isinstance(value, int | float) for value in node.values())


def _bases() -> list[list[str]]:
    """One option of each class, and one experiment of each rival."""
    bases: dict[str, list[str]] = {}
    for group, option in OPTIONS:
        content = yaml.safe_load((CONF / group / f"{option}.yaml").read_text(encoding="utf-8"))
        what = (content or {}).get("_target_") or (content or {}).get("variant") or group
        if group not in ("offline", "rival") and any(_numbers(content or {})):
            bases.setdefault(what, [f"{group}={option}", *BESIDE.get((group, option), [])])
    return [*bases.values(), *([f"experiment={name}"] for name in RIVALS)]


def _with(settings: Mapping[str, Any], path: tuple[str, ...], value: int) -> dict[str, Any]:
    changed = deepcopy(dict(settings))
    node = changed
    for name in path[:-1]:
        node = node[name]
    node[path[-1]] = type(node[path[-1]])(value)
    return changed


def _refusal(settings: Mapping[str, Any]) -> str | None:
    try:
        config = checked(settings)
        if is_rival(config) and is_search(config):
            build_search(config)
        elif is_rival(config):
            build_rival(config)
        elif is_planned(config):
            build_planned(config)
        else:
            build(config)
    except ConfigError as error:
        return str(error)
    return None


@pytest.mark.parametrize("base", _bases(), ids=lambda base: base[0])
def test_a_refused_number_is_named_by_its_key(base: list[str]) -> None:
    if any("cardea" in override for override in base):
        pytest.importorskip("pybullet", reason="the extra [cardea] is not installed")
    group = base[0].partition("=")[0].replace("experiment", "rival")
    settings = compose(base).plain()
    assert _refusal(settings) is None
    for path in _numbers({group: settings[group]}):
        for value in (-1, 0):
            message = _refusal(_with(settings, path, value))
            if message is not None and not message.startswith("reward.state={"):  # no weight > 0
                assert message.startswith(f"{'.'.join(path)}={value}")
