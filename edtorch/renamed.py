"""Modules by their names before 0.1.0's packages: saved configurations and scripts still name them.

``import edtorch.fit`` gives the very module ``edtorch.model.fit``, and so does a ``_target_``.
"""

from __future__ import annotations

import importlib
import importlib.abc
import importlib.machinery
import sys
from collections.abc import Mapping, Sequence
from types import ModuleType
from typing import Any

RENAMED = {
    "edtorch.adaptive": "edtorch.model.fit_adaptive",
    "edtorch.annealing": "edtorch.learner.annealing",
    "edtorch.app.command": "edtorch.app.limit",
    "edtorch.app.keeping": "edtorch.app.best",
    "edtorch.app.rival": "edtorch.app.random_search",
    "edtorch.checkpoint": "edtorch.run.policy_file",
    "edtorch.checks": "edtorch.value.checks",
    "edtorch.closed_form": "edtorch.value.linear",
    "edtorch.closed_form.linear": "edtorch.value.linear.loop",
    "edtorch.command": "edtorch.learner.limit",
    "edtorch.decay": "edtorch.model.fit_decaying",
    "edtorch.delay": "edtorch.learner.delay",
    "edtorch.dispatch": "edtorch.value.choose",
    "edtorch.evaluation": "edtorch.run.evaluation",
    "edtorch.features": "edtorch.model.features",
    "edtorch.filtering": "edtorch.learner.filter",
    "edtorch.fit": "edtorch.model.fit",
    "edtorch.hashing": "edtorch.run.hashing",
    "edtorch.interact": "edtorch.run.training",
    "edtorch.log": "edtorch.run.log",
    "edtorch.loop": "edtorch.value.closed_loop",
    "edtorch.models": "edtorch.model.models",
    "edtorch.noise": "edtorch.model.noise",
    "edtorch.observer": "edtorch.learner.observer",
    "edtorch.offline": "edtorch.run.offline",
    "edtorch.policies": "edtorch.policy.policies",
    "edtorch.recorder": "edtorch.run.recorder",
    "edtorch.records": "edtorch.run.episodes",
    "edtorch.ridge": "edtorch.model.fit_ridge",
    "edtorch.schedule": "edtorch.learner.schedule",
    "edtorch.run.checkpoint": "edtorch.run.policy_file",
    "edtorch.spectral": "edtorch.linalg",
    "edtorch.streams": "edtorch.run.random",
    "edtorch.tick": "edtorch.run.tick",
    "edtorch.trail": "edtorch.run.trail",
    "edtorch.trouble": "edtorch.errors",
    "edtorch.unroll": "edtorch.value.unroll",
    "edtorch.update": "edtorch.policy.steps",
    "edtorch.value_error": "edtorch.value.error_estimate",
    "edtorch.world": "edtorch.run.scaled_sim",
    "sims.bicycle_displacement": "sims.bicycle.displacement",
    "sims.bicycle_life": "sims.bicycle.life",
    "sims.bicycle_lqr": "sims.bicycle.lqr",
    "sims.bicycle_optimum": "sims.bicycle.optimum",
    "sims.bicycle_physics": "sims.bicycle.physics",
    "sims.bicycle_picture": "sims.bicycle.picture",
    "sims.cardea_arm": "sims.cardea.arm",
    "sims.cardea_env": "sims.cardea.env",
    "sims.cardea_physics": "sims.cardea.physics",
    "sims.cardea_picture": "sims.cardea.picture",
    "sims.cardea_poses": "sims.cardea.poses",
    "sims.cardea_yardsticks": "sims.cardea.baselines",
    "sims.slalom": "sims.bicycle.slalom",
    "sims.wind": "sims.bicycle.wind",
}
"""New module names by old ones; what lies within a renamed package keeps its own name there."""

CLASSES = {"edtorch.inverse.features.Pairwise": "edtorch.inverse.features.PairwiseProducts"}
"""New names of configurable classes by their old ones, both in present modules."""


def current_target(name: str) -> str:
    """The present full name of a class, for a ``_target_``; ``name`` itself if not renamed."""
    present = current_name(name) or name
    return CLASSES.get(present, present)


RENAMED_KEYS = {
    "noise.exploration": "exploration.deviation",
    "noise.exploration_start": "exploration.start",
    "noise.exploration_decay": "exploration.decay",
    "rival.fall_cost": "rival.failure_cost",
    "rival.fall_penalty": "rival.failure_penalty",
    "search.degree": "search.policy.degree",
    "train.rides": "train.successes",
}
"""Settings by their former names, which command lines and saved configurations may still use."""


_NATIVE = "the compiler is numba now: compute.native=auto|on|off, compute.threads=N"
REMOVED_KEYS = {
    "compute.compile": _NATIVE,
    "compute.compile_after": _NATIVE,
    "compute.precision": f"everything is computed in float64; {_NATIVE}",
    "log.checkpoint": "states are saved by the clock on the wall: log.checkpoint_wall=SECONDS",
}
"""Settings that are gone, with what to say of them: refused where they are typed, and left out of
saved configurations."""


def current_keys(settings: Mapping[str, Any]) -> dict[str, Any]:
    """A configuration, nested, with its settings under their present names."""
    result = {key: dict(v) if isinstance(v, Mapping) else v for key, v in settings.items()}
    for removed in REMOVED_KEYS:
        group, _, key = removed.partition(".")
        if isinstance(result.get(group), dict):
            result[group].pop(key, None)
    for old, new in RENAMED_KEYS.items():
        (old_group, _, old_key), (group, _, key) = old.partition("."), new.partition(".")
        before = result.get(old_group)
        if isinstance(before, dict) and old_key in before:
            result[group] = _with(result.get(group), key, before.pop(old_key))
    domain = result.get("domain")
    inner = domain.get("sim") if isinstance(domain, dict) else None
    for node in (domain, inner):
        if isinstance(node, Mapping) and node.get("_target_") in _DOMAINS:
            name = _DOMAINS[node["_target_"]]
            result |= {key: _components(name, result[key]) for key in _NAMING if key in result}
    return result


def _with(node: Any, key: str, value: Any) -> dict[str, Any]:
    """A copy of a node, empty if it is none, with a dotted ``key`` set."""
    head, _, rest = key.partition(".")
    known = dict(node) if isinstance(node, Mapping) else {}
    return known | {head: _with(known.get(head), rest, value) if rest else value}


COMPONENTS = {"linear": {"s": "state_", "a": "action_"}}
"""By domain, what comes before the numbers of its components, by what came before them earlier."""

_DOMAINS = {"sims.linear.LinearSystem": "linear"}
_NAMING = ("domain", "reward", "command", "observation", "offline")
"""The groups whose settings name components."""


def current_component(domain: str, name: str) -> str:
    """The present name of a component of a domain."""
    for old, new in COMPONENTS.get(domain, {}).items():
        if name.startswith(old) and name.removeprefix(old).isdigit():
            return new + name.removeprefix(old)
    return name


def _components(domain: str, node: Any) -> Any:
    """A node of the settings with the present names of components."""
    if isinstance(node, Mapping):
        return {
            current_component(domain, key): _components(domain, value)
            for key, value in node.items()
        }
    if isinstance(node, list):
        return [_components(domain, value) for value in node]
    return current_component(domain, node) if isinstance(node, str) else node


def former_keys(key: str) -> list[str]:
    """The names that a setting had before."""
    parent, _, last = key.rpartition(".")
    names = [old for old, new in RENAMED_KEYS.items() if new == key]
    for prefixes in COMPONENTS.values():
        for old, new in prefixes.items():
            if last.startswith(new) and last.removeprefix(new).isdigit():
                names.append(f"{parent}.{old}{last.removeprefix(new)}")
    return names


def current_name(name: str) -> str | None:
    """The present name of a module that was called ``name``, None where it was not renamed."""
    head, tail = name, ""
    while head:
        if head in RENAMED:
            return RENAMED[head] + tail
        head, _, last = head.rpartition(".")
        tail = f".{last}{tail}"
    return None


class _Alias(importlib.abc.Loader):
    """Loads a module under its old name as the one that it is now."""

    def __init__(self, present: str) -> None:
        self._present = present
        self._spec: importlib.machinery.ModuleSpec | None = None

    def create_module(self, spec: importlib.machinery.ModuleSpec) -> ModuleType:
        """The module under its present name."""
        module = importlib.import_module(self._present)
        self._spec = module.__spec__
        return module

    def exec_module(self, module: ModuleType) -> None:
        """Give the module its own spec back: the import system has put the alias's there."""
        module.__spec__ = self._spec


class _Finder(importlib.abc.MetaPathFinder):
    """Knows the old names."""

    def find_spec(
        self, name: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        """A spec for an old name, None for any other."""
        present = current_name(name)
        return None if present is None else importlib.machinery.ModuleSpec(name, _Alias(present))


def install() -> None:
    """Let old names be imported; once is enough."""
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        # First: a folder that an update has left empty would be taken for a package.
        sys.meta_path.insert(0, _Finder())
