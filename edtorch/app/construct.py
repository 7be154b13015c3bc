"""From a ``_target_`` node to an object, with every error under its full key."""

from __future__ import annotations

import inspect
import logging
from collections.abc import Mapping
from typing import Any

from hydra.utils import get_class, get_method, instantiate

from edtorch.app.errors import ConfigError, under, unknown_key
from edtorch.app.given import Given
from edtorch.app.settings import Settings, plain
from edtorch.beside import hidden
from edtorch.renamed import current_target

# What it says of a class that it cannot find is in the error, too.
logging.getLogger("hydra.utils").setLevel(logging.CRITICAL)

_GATHERING = (inspect.Parameter.VAR_POSITIONAL, inspect.Parameter.VAR_KEYWORD)


def known_keys(group: str, config: Mapping[str, Any], known: set[str]) -> None:
    """Refuse keys of a group that are not ``known``."""
    for key, value in config.items():
        if key not in known:
            name = f"{group}.{key}"
            settable = sorted(k for k in known if not k.startswith("_"))
            raise ConfigError(unknown_key(f"{name}={value}", name, settable))


def target_class(group: str, config: Any) -> Any:
    """The class that a node names; Hydra looks it up and vets it."""
    if not isinstance(config, Mapping) or "_target_" not in config:
        raise ConfigError(f"{group}={config}: expected a mapping with a _target_")
    name = config["_target_"]
    try:
        return get_class(current_target(name))
    except Exception as error:
        why = " ".join(str(error).split()) or type(error).__name__
        package = str(name).partition(".")[0]
        folder = hidden(package) if package in ("edtorch", "sims") else None
        if folder is not None:
            why += f"; {folder} is hidden by edtorch's package of that name, rename it"
        raise ConfigError(
            f"{group}._target_={name}: expected the full name of a class ({why})"
        ) from error


def accepts(target: Any, name: str) -> bool:
    """Whether a constructor has an argument of this name."""
    try:
        return name in inspect.signature(target).parameters
    except ValueError:
        return False


def argument(key: str, value: Any) -> Any:
    """A constructor's argument: nested targets become objects, other nodes plain containers."""
    if isinstance(value, Given):
        return value.value
    if isinstance(value, Mapping) and "given" in value:
        raise ConfigError(f"{key}: was an object, {value['given']}; expected it to be given again")
    if isinstance(value, Mapping) and value.get("_partial_"):
        # The function itself: Hydra's own partial would vet its target again at every call.
        known_keys(key, value, {"_target_", "_partial_"})
        try:
            return get_method(value["_target_"])
        except Exception as error:
            why = " ".join(str(error).split())
            raise ConfigError(
                f"{key}._target_={value['_target_']}: expected the full name of a function ({why})"
            ) from error
    if isinstance(value, Mapping) and "_target_" in value:
        return construct(key, value)
    return plain(value)


def is_given(config: Any) -> bool:
    """Whether a node holds an object, or the name of one that it held (``edtorch.app.given``)."""
    return isinstance(config, Mapping) and "given" in config


def given_part(group: str, config: Settings) -> Any:
    """The object; ConfigError where only its name is left."""
    given = config.given
    named = isinstance(given, Given | Mapping)
    return argument(group, given if named else config)


def construct(group: str, config: Any, *methods: str, **more: Any) -> Any:
    """An object from a ``_target_`` node; keys that its constructor does not know are refused.

    methods: what the object must be able to do; more: arguments that do not come from the
    configuration, of which the constructor gets those that it knows; ``_args_`` in the node are
    arguments by place, with which it gets nothing else.
    """
    target = target_class(group, config)
    lacking = [name for name in methods if not hasattr(target, name)]
    if lacking:
        raise ConfigError(
            f"{group}._target_={config['_target_']}: expected a class with {', '.join(methods)};"
            f" it lacks {', '.join(lacking)}"
        )
    try:
        accepted = inspect.signature(target).parameters
    except ValueError as error:
        raise ConfigError(f"{group}._target_={config['_target_']}: {error}") from error
    if not any(p.kind is _GATHERING[1] for p in accepted.values()):
        known_keys(group, config, (set(accepted) - set(more)) | {"_target_", "_args_"})
    places = [
        argument(f"{group}._args_[{place}]", value)
        for place, value in enumerate(config.get("_args_", ()))
    ]
    arguments = {
        str(k): argument(f"{group}.{k}", v)
        for k, v in config.items()
        if k not in ("_target_", "_args_")
    }
    arguments |= {k: v for k, v in more.items() if k in accepted and not places}
    for name, parameter in accepted.items():
        optional = parameter.kind in _GATHERING or parameter.default is not inspect.Parameter.empty
        if not optional and name not in arguments and not places:
            raise ConfigError(f"{group}.{name}: no value given; set it with {group}.{name}=...")
    # Called here and not by Hydra, so that its errors reach us as they are.
    constructor = instantiate({"_target_": current_target(config["_target_"]), "_partial_": True})
    with under(group):
        try:
            return constructor(*places, **arguments)
        except (ValueError, TypeError):
            raise
        except Exception as error:
            # Whatever a constructor cannot do, it cannot do with this configuration.
            why = f"{type(error).__name__}: {error}"
            raise ConfigError(
                f"{group}._target_={config['_target_']}: {why} (debug=true shows where)"
            ) from error
