"""Composition by Hydra, and YAML: the only place where configurations are not plain yet."""

from __future__ import annotations

import re
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import hydra
from hydra._internal.utils import _run_hydra, get_args_parser
from hydra.core.override_parser.overrides_parser import OverridesParser
from hydra.errors import HydraException
from hydra.version import setbase
from omegaconf import DictConfig, OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from edtorch.app.errors import ConfigError, one_line
from edtorch.app.options import options_named, without_presets
from edtorch.app.overrides import typed, typing
from edtorch.app.schema import checked
from edtorch.app.settings import Settings
from edtorch.app.sweep_names import hash_of
from edtorch.beside import ROOT
from edtorch.renamed import REMOVED_KEYS, RENAMED_KEYS

_OVERRIDE = re.compile(
    r"(?P<sign>\+\+|\+|~|)(?P<key>[A-Za-z_]\w*(\.[^.=@/]+)*)(?P<rest>=.*|)", re.S
)

CONF = ROOT / "conf"
"""Found beside the package and not by name: a user's own folder ``conf`` may come first there."""


TRIAL_MODELS = ("auto", "implicit", "products", "monomials")
"""Options of ``model`` that are fitted between trials."""
IN_TRIALS = {"regulation": "regulation_in_trials"}
"""What an experiment of a learner is with such a model."""


def _unless_recorded(value: Any, *, _root_: Any) -> Any:
    """In the files: a default of learners that live, null where they learn from recorded data."""
    recorded = OmegaConf.select(_root_, "offline.variant") == "recorded"
    return None if recorded else value


def _where_named(named: Any, unnamed: Any, *, _root_: Any) -> Any:
    """One value in a sweep with a name, another in one without."""
    return unnamed if OmegaConf.select(_root_, "sweep.name") is None else named


def _hash_of_job(*, _root_: Any) -> str:
    """The name of a job's folder in a sweep with a name."""
    return hash_of(OmegaConf.select(_root_, "hydra.overrides.task"))


# Here, so that they are known wherever a job is composed: in the processes of launchers, too.
OmegaConf.register_new_resolver("unless_recorded", _unless_recorded, replace=True)
OmegaConf.register_new_resolver("where_named", _where_named, replace=True)
OmegaConf.register_new_resolver("hash_of_job", _hash_of_job, replace=True)


def compose(overrides: Sequence[str] = (), name: str = "train") -> Settings:
    """The complete settings of ``edtorch-train`` with these overrides.  Raises ConfigError."""
    with typing(overrides):
        try:
            with (
                options_named(overrides) as named,
                hydra.initialize_config_dir(str(CONF), version_base="1.3"),
            ):
                composed = hydra.compose(name, prepared(named))
        except (HydraException, OmegaConfBaseException, ValueError) as error:
            raise ConfigError(one_line(error)) from error
        return checked(plainly(composed))


def prepared(overrides: Sequence[str]) -> list[str]:
    """The overrides as Hydra gets them.

    Settings within a group are added with ``++`` whether or not a file of the group lists them:
    the constructor that they are for knows its arguments (``edtorch.app.schema``).  Former names
    become the present ones.  An experiment of a learner, with a model that is learned from whole
    trials, is its counterpart in ``IN_TRIALS``.  Raises ConfigError where both names of a setting
    are given.
    """
    keys = {override.lstrip("+~").partition("=")[0] for override in overrides}
    found = [_prepared(override, keys) for override in overrides]
    if any(override.startswith("model=") and override[6:] in TRIAL_MODELS for override in found):
        named = {f"experiment={name}": f"experiment={other}" for name, other in IN_TRIALS.items()}
        return [named.get(override, override) for override in found]
    return found


def _prepared(override: str, keys: set[str]) -> str:
    match = _OVERRIDE.fullmatch(override)
    if match is None or "." not in match["key"] or match["key"].startswith("hydra."):
        return override
    if match["key"] in REMOVED_KEYS:
        raise ConfigError(f"{override}: was removed; {REMOVED_KEYS[match['key']]}")
    key = RENAMED_KEYS.get(match["key"], match["key"])
    if key != match["key"] and key in keys:
        raise ConfigError(f"{override}: is now called {key}, which is given as well")
    sign = match["sign"] if match["sign"] == "~" else "++"
    return f"{sign}{key}{match['rest']}"


def settings_typed() -> dict[str, Any]:
    """Of a command line that names a run to go on with, ``resume=RUN``, the settings by full key;
    empty of any other.  Raises ConfigError where there is more than settings."""
    overrides = [each for each in typed() if not each.startswith("-")]
    if not any(each.lstrip("+").startswith("resume=") for each in overrides):
        return {}
    options = [each for each in typed() if each.startswith("-")]
    if options:
        raise ConfigError(f"{options[0]}: expected none with resume=RUN, which is one run")
    settings: dict[str, Any] = {}
    for override in OverridesParser.create().parse_overrides(prepared(overrides)):
        if override.is_sweep_override() or override.is_delete():
            line = str(override.input_line).lstrip("+")
            raise ConfigError(f"{line}: expected KEY=VALUE with one value")
        if override.key_or_group in settings:
            raise ConfigError(f"{override.key_or_group}: expected it once with resume=RUN")
        settings[override.key_or_group] = plain_value(override.value())
    return settings


def plain_value(value: Any) -> Any:
    """A value of Hydra's grammar as text, number, list or dict."""
    return OmegaConf.to_container(OmegaConf.create({"value": value}))["value"]  # pyright: ignore


def plainly(composed: Any) -> dict[str, Any]:
    """What Hydra composed as dicts and lists, interpolations resolved."""
    content = OmegaConf.to_container(composed, resolve=True, throw_on_missing=True)
    assert isinstance(content, dict)
    settings = {str(key): value for key, value in content.items() if key != "hydra"}
    return without_presets(settings, typed())


def launch(task: Callable[[Any], Any], folder: Path, name: str) -> None:
    """Run ``task`` on what Hydra composes from the command line, once or, with -m, often.

    folder, name: of the primary configuration.
    """
    here = str(Path.cwd())
    if here not in sys.path:
        sys.path.append(here)  # for _target_=my_module.MyClass
    parser = get_args_parser()
    arguments = parser.parse_args()
    setbase("1.3")
    overrides = arguments.overrides
    with typing(overrides), options_named(overrides) as named:
        arguments.overrides = prepared(named)
        _run_hydra(
            args=arguments,
            args_parser=parser,
            task_function=task,
            config_path=str(folder),
            config_name=name,
        )


def as_yaml(content: Mapping[str, Any]) -> str:
    """The text of a configuration file; content: dicts and lists."""
    return OmegaConf.to_yaml(OmegaConf.create(dict(content)))


def read_yaml(path: Path) -> Mapping[str, Any]:
    """The content of a configuration file.  Raises ValueError where it is none."""
    try:
        loaded = OmegaConf.load(path)
        content = OmegaConf.to_container(loaded, resolve=True)
    except (YAMLError, OmegaConfBaseException, UnicodeDecodeError, OSError) as error:
        raise ValueError(" ".join(str(error).split())) from error
    if not isinstance(loaded, DictConfig) or not isinstance(content, dict):
        raise ValueError("not a mapping")
    return {str(key): value for key, value in content.items()}
