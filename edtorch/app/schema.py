"""Checks a composed configuration against the constructors that will receive it.

A group with a ``_target_`` may set the arguments of that constructor and no others; a group without
one has the fields of its dataclass in ``edtorch.app.groups``.  Annotations give the types, defaults
the values that are not set, so that a configuration is complete when it is built and saved.
"""

from __future__ import annotations

import dataclasses
import inspect
import sys
import types
import typing
from collections.abc import Callable, Mapping, Sequence
from typing import Any, Literal, get_args, get_origin

from edtorch.app.construct import target_class
from edtorch.app.errors import ConfigError, unknown_key
from edtorch.app.groups import GROUPS, UNTARGETED, Whole
from edtorch.app.overrides import given, given_name
from edtorch.app.settings import Settings, merged, plain
from edtorch.renamed import current_keys

HANDED_IN = frozenset(
    "actions deviations dtype generator layout middle model names period spec states"
    " stretch".split()
)
"""Arguments of constructors that the builders hand in, which are no settings."""

FUNCTIONS = ("reward",)
"""Groups in which a function will do as well as a class."""

_YES, _NO = ("true", "yes", "on", "y", "1"), ("false", "no", "off", "n", "0")
_UNSET = inspect.Parameter.empty


@dataclasses.dataclass(frozen=True)
class _Argument:
    """An argument of a constructor: its annotation (None: any value will do) and its default."""

    kind: Any
    default: Any


class _WrongType(Exception):
    """A value is not of the type that its annotation asks for; the message says what is."""


def checked(composed: Mapping[str, Any]) -> Settings:
    """The complete configuration of ``edtorch-train``.

    composed: nested mappings, as composed or as saved, perhaps by an earlier version.  Raises
    ConfigError, which names the key as it was typed.
    """
    content = current_keys(composed)
    outside = {key: value for key, value in content.items() if key not in GROUPS}
    result = _fields("", outside, Whole, GROUPS)
    for group in GROUPS:
        result[group] = _group(group, content.get(group))
    return Settings(result)


def checked_fields(schema: type, composed: Mapping[str, Any], group: str = "") -> Settings:
    """A configuration without groups, such as that of ``edtorch-eval``, or one group of another.

    Raises ConfigError.
    """
    return Settings(_fields(group, composed, schema))


def _group(group: str, node: Any) -> Any:
    variants = UNTARGETED.get(group, ())
    if isinstance(node, Mapping) and "given" in node:
        return node  # an object of the caller's, or where there was one
    if node is None and variants:
        return _fields(group, {}, variants[0])
    if not isinstance(node, Mapping):
        raise ConfigError(f"{_shown(group, node)}: expected a mapping")
    own = getattr(variants[0], "_target_", None) if variants else _UNSET
    if not variants or node.get("_target_", own) not in (None, own):
        return _arguments(group, node)
    if len(variants) == 1:
        return _fields(group, node, variants[0])
    by_name = {variant().variant: variant for variant in variants}
    chosen = node.get("variant", next(iter(by_name)))
    if chosen not in by_name:
        raise ConfigError(f"{group}.variant={chosen}: expected one of {', '.join(by_name)}")
    return _fields(group, node, by_name[chosen])


def _fields(
    key: str, node: Mapping[str, Any], schema: type, also: Sequence[str] = ()
) -> dict[str, Any]:
    """The fields of a dataclass, from ``node`` and by default; also: further names to list."""
    return _settings(key, node, _signature(schema), also)


def _arguments(key: str, node: Mapping[str, Any]) -> dict[str, Any]:
    """The arguments of the constructor that a node names."""
    if node.get("_partial_"):
        extra = {name: value for name, value in node.items() if name != "_partial_"}
        return _settings(key, extra, {}) | {"_partial_": True}
    try:
        target = target_class(key, Settings(node))
    except ConfigError:
        if key in FUNCTIONS:
            return dict(node)  # whose builder knows how it is called
        raise
    try:
        accepted = _signature(target)
    except ValueError:
        return dict(node)  # a class of C, which does not say what it takes
    return _settings(key, node, accepted, owner=target.__qualname__)


def _signature(target: Callable[..., Any]) -> dict[str, _Argument] | None:
    """What a constructor accepts; None: anything.  Raises ValueError where it does not say."""
    parameters = inspect.signature(target).parameters.values()
    if any(p.kind is inspect.Parameter.VAR_KEYWORD for p in parameters):
        return None
    hints = _hints(target)
    factories = {}
    if dataclasses.is_dataclass(target):
        factories = {
            f.name: f.default_factory()
            for f in dataclasses.fields(target)
            if f.default_factory is not dataclasses.MISSING
        }
    return {
        p.name: _Argument(hints.get(p.name), factories.get(p.name, p.default))
        for p in parameters
        if p.kind is not inspect.Parameter.VAR_POSITIONAL
    }


def _hints(target: Callable[..., Any]) -> dict[str, Any]:
    """Annotations by argument; none where they have no meaning at run time."""
    annotated = target
    if isinstance(target, type) and not dataclasses.is_dataclass(target):
        annotated = target.__init__
    try:
        return typing.get_type_hints(annotated)
    except Exception:
        # Names that only a type checker imports: the constructor checks for itself.
        return {}


def _settings(
    key: str,
    node: Mapping[str, Any],
    accepted: dict[str, _Argument] | None,
    also: Sequence[str] = (),
    owner: str | None = None,
) -> dict[str, Any]:
    """The values of ``node`` as their types want them, and the defaults of the others."""
    result: dict[str, Any] = {}
    prefix = f"{key}." if key else ""
    handed_in = frozenset() if owner is None else HANDED_IN
    for name, value in node.items():
        full = f"{prefix}{name}"
        if name in ("_target_", "_args_") or accepted is None:
            result[name] = _value(full, value, None)
        elif name in accepted:
            value = _within_default(value, accepted[name].default)
            result[name] = _value(full, value, accepted[name].kind)
        elif given(f"{prefix}_target_") is None or given(full) is not None:
            # Where the class was typed, the settings of the option's own class do not count.
            known = sorted({*accepted, *also} - handed_in - {"_target_"})
            line = unknown_key(_shown(full, value), given_name(full), known)
            raise ConfigError(line + _hint(key, name, owner) + _left_over(key, full))
    for name, argument in (accepted or {}).items():
        if name not in result and name not in handed_in:
            default = _plain_default(argument.default)
            if default is not _UNSET:
                result[name] = default
    return result


def _hint(group: str, name: str, owner: str | None) -> str:
    """For what a domain says of itself, and not its constructor's arguments."""
    if group != "domain" or name not in ("dt", "time_limit", "clip_action"):
        return ""
    return f"; {owner} sets the {name} of its spec itself: give its constructor an argument {name}"


def _left_over(group: str, key: str) -> str:
    """For a setting of an experiment whose option of the group was replaced by a typed one."""
    if given(key) is not None or given(group) is None or given("experiment") is None:
        return ""
    return f"; {given('experiment')} sets it for another {group}: leave it out with ~{key}"


def _within_default(value: Any, default: Any) -> Any:
    """Settings of an object that is built by default are changes to what it is by default."""
    if isinstance(value, Mapping) and not isinstance(default, Mapping):
        whole = _plain_default(default)
        own = value.get("_target_", _UNSET)
        if isinstance(whole, Mapping) and own in (_UNSET, whole["_target_"]):
            return merged(whole, value)
    return value


def _plain_default(default: Any) -> Any:
    """A default as configuration says it; ``_UNSET`` where it cannot."""
    if default is None or isinstance(default, bool | int | float | str):
        return default
    if isinstance(default, Mapping):
        items = {str(name): _plain_default(value) for name, value in default.items()}
        return _UNSET if _UNSET in items.values() else items
    if isinstance(default, list | tuple):
        items = [_plain_default(value) for value in default]
        return _UNSET if _UNSET in items else items
    if isinstance(default, types.FunctionType) and "<" not in default.__qualname__:
        return {"_target_": _full_name(default), "_partial_": True}
    if dataclasses.is_dataclass(default) and not isinstance(default, type):
        names = [f.name for f in dataclasses.fields(default)]
        values = {name: _plain_default(getattr(default, name)) for name in names}
        if any(value is _UNSET for value in values.values()):
            return _UNSET
        return {"_target_": _full_name(type(default)), **values}
    return _UNSET


def _full_name(target: Any) -> str:
    """The shortest name by which a class or function can be imported."""
    module, name = target.__module__, target.__qualname__
    package = module.rpartition(".")[0]
    while package and getattr(sys.modules.get(package), name, None) is target:
        module, package = package, package.rpartition(".")[0]
    return f"{module}.{name}"


def _value(key: str, value: Any, kind: Any) -> Any:
    """A value as its annotation wants it; nested targets are checked in turn."""
    if isinstance(value, Mapping) and "_target_" in value:
        return _arguments(key, value)
    try:
        return _converted(key, value, kind)
    except _WrongType as error:
        raise ConfigError(str(error)) from None


def _converted(key: str, value: Any, kind: Any) -> Any:
    origin, arguments = get_origin(kind), get_args(kind)
    if origin is Literal:
        if value not in arguments:
            listed = ", ".join("null" if a is None else str(a) for a in arguments)
            raise _WrongType(f"{_shown(key, value)}: expected one of {listed}")
        return value
    if origin in (typing.Union, types.UnionType):
        return _one_of(key, value, arguments)
    plainly = origin or kind
    if not isinstance(plainly, type) or plainly is object:
        return plain(value)
    if plainly in _SIMPLE:
        expected, convert = _SIMPLE[plainly]
        if value is None:
            expected = "a value, not null"
        converted = _UNSET if value is None else convert(value)
        if converted is _UNSET:
            raise _WrongType(f"{_shown(key, value)}: expected {expected}")
        return converted
    if issubclass(plainly, Mapping):
        if not isinstance(value, Mapping):
            raise _WrongType(f"{_shown(key, value)}: expected a mapping {{NAME: VALUE}}")
        of = arguments[1] if len(arguments) == 2 else None
        return {str(name): _value(f"{key}.{name}", each, of) for name, each in value.items()}
    if issubclass(plainly, Sequence):
        if not isinstance(value, list | tuple):
            raise _WrongType(f"{_shown(key, value)}: expected a list [VALUE, ...]")
        of = [a for a in arguments if a is not ...] or [None]
        kinds = of if len(of) == len(value) else [of[0]] * len(value)
        return [
            _value(f"{key}[{i}]", each, k)
            for i, (each, k) in enumerate(zip(value, kinds, strict=True))
        ]
    return plain(value)


def _one_of(key: str, value: Any, kinds: Sequence[Any]) -> Any:
    """The first alternative of a union that takes the value."""
    if value is None and type(None) in kinds:
        return None
    alternatives = [kind for kind in kinds if kind is not type(None)]
    known = [k for k in alternatives if k in _SIMPLE or get_origin(k) is not None]
    problems = []
    for kind in known if known and not isinstance(value, Mapping) else alternatives:
        try:
            return _converted(key, value, kind)
        except _WrongType as error:
            problems.append(error)
    raise problems[0]


def _number(value: Any) -> Any:
    is_number = isinstance(value, int | float) and not isinstance(value, bool)
    return float(value) if is_number else _UNSET


def _integer(value: Any) -> Any:
    return value if isinstance(value, int) and not isinstance(value, bool) else _UNSET


def _truth(value: Any) -> Any:
    word = str(value).lower()
    return word in _YES if word in _YES + _NO else _UNSET


def _text(value: Any) -> Any:
    if isinstance(value, str):
        return value
    return str(value) if isinstance(value, int | float) else _UNSET


_SIMPLE: dict[Any, tuple[str, Callable[[Any], Any]]] = {
    float: ("a number", _number),
    int: ("an integer", _integer),
    bool: ("true or false", _truth),
    str: ("text", _text),
}


def _shown(key: str, value: Any) -> str:
    """The setting as it was typed; as it is where it was not."""
    words = {None: "null", True: "true", False: "false"}
    text = words[value] if value is None or isinstance(value, bool) else str(plain(value))
    return given(key) or f"{key}={text}"


def defaults(settings: Mapping[str, Any]) -> dict[str, Any]:
    """What a flat configuration leaves out, by full key, as it is by default."""
    found: dict[str, Any] = {f.name: f.default for f in dataclasses.fields(Whole)}
    for group, variants in UNTARGETED.items():
        if settings.get(f"{group}._target_") is not None:
            continue
        by_name = {getattr(v, "variant", None): v for v in variants}
        chosen = by_name.get(settings.get(f"{group}.variant"), variants[0])
        found |= _flat(group, _fields(group, {}, chosen))
    for key, target in settings.items():
        if key.endswith("._target_") and target is not None:
            prefix = key.removesuffix("._target_")
            try:
                found |= _flat(prefix, _arguments(prefix, {"_target_": target}))
            except ConfigError:
                continue  # a function, or a class that is not there any more
    return found


def _flat(prefix: str, node: Mapping[str, Any]) -> dict[str, Any]:
    leaves: dict[str, Any] = {}
    for name, value in node.items():
        nested = isinstance(value, Mapping)
        leaves |= _flat(f"{prefix}.{name}", value) if nested else {f"{prefix}.{name}": value}
    return leaves
