"""Options of a group written out on the command line: ``policy='{_target_: my.MLP, hidden: 32}'``.

Hydra takes for a group only names of options.  One that is written out is registered under a name
of its own, and that name stands for it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from hydra.core.config_store import ConfigStore
from hydra.core.override_parser.overrides_parser import OverridesParser

WRITTEN_OUT = "written_out"
"""What such an option is called."""

PARTS = (
    "domain",
    "model",
    "fit",
    "policy",
    "reward",
    "noise",
    "transform",
    "step",
    "rival",
)
"""Groups whose options are made of a ``_target_`` and its arguments."""


@contextmanager
def options_named(arguments: Sequence[str]) -> Iterator[list[str]]:
    """The arguments, in which ``GROUP={...}`` has become ``GROUP=written_out``; Hydra knows these
    options meanwhile, and no longer."""
    repo = ConfigStore.instance().repo
    try:
        yield _named(arguments)
    finally:
        for group in PARTS:
            known = repo.get(group, {})
            known.pop(f"{WRITTEN_OUT}.yaml", None)
            if not known:
                repo.pop(group, None)


def _named(arguments: Sequence[str]) -> list[str]:
    named = []
    for argument in arguments:
        group, option = _written_out(argument)
        if group:
            ConfigStore.instance().store(group=group, name=WRITTEN_OUT, node=option)
            argument = f"{group}={WRITTEN_OUT}"
        named.append(argument)
    return named


def _written_out(argument: str) -> tuple[str, dict[str, Any]]:
    """The group and the option that an argument writes out; "" for any other argument."""
    group, equals, value = argument.lstrip("+").partition("=")
    if not (equals and group in PARTS and value.startswith("{")):
        return "", {}
    option: Any = OverridesParser.create().parse_override(f"{group}={value}").value()
    return group, {str(key): each for key, each in option.items()}


def without_presets(content: dict[str, Any], arguments: Sequence[str]) -> dict[str, Any]:
    """``content`` in which groups that were written out have only keys that the arguments give:
    those of an experiment were for the option that it had chosen."""
    kept = dict(content)
    for group, option in map(_written_out, arguments):
        if group and isinstance(kept.get(group), dict):
            typed = {
                a.lstrip("+~").partition("=")[0].split(".")[1]
                for a in arguments
                if a.lstrip("+~").startswith(f"{group}.")
            }
            kept[group] = {k: v for k, v in kept[group].items() if k in {*option, *typed}}
    return kept
