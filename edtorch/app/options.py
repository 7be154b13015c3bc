"""Options of a group written out on the command line: ``policy='{_target_: my.MLP, hidden: 32}'``.

Hydra takes for a group only names of options.  One that is written out is registered under a name
of its own, and that name stands for it.
"""

from __future__ import annotations

from collections.abc import Sequence

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


def with_options_named(arguments: Sequence[str]) -> list[str]:
    """The arguments, in which ``GROUP={...}`` has become ``GROUP=written_out``."""
    named = []
    for argument in arguments:
        group, equals, value = argument.lstrip("+").partition("=")
        if equals and group in PARTS and value.startswith("{"):
            option = OverridesParser.create().parse_override(f"{group}={value}").value()
            ConfigStore.instance().store(group=group, name=WRITTEN_OUT, node=option)
            argument = f"{group}={WRITTEN_OUT}"
        named.append(argument)
    return named
