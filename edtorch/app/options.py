"""Options of a group written out on the command line: ``policy='{_target_: my.MLP, hidden: 32}'``.

Hydra takes for a group only names of options.  One that is written out is registered under a name
of its own, and that name stands for it.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager

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
        group, equals, value = argument.lstrip("+").partition("=")
        if equals and group in PARTS and value.startswith("{"):
            option = OverridesParser.create().parse_override(f"{group}={value}").value()
            ConfigStore.instance().store(group=group, name=WRITTEN_OUT, node=option)
            argument = f"{group}={WRITTEN_OUT}"
        named.append(argument)
    return named
