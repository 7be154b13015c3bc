"""Run folders as they are found on disk: what is usable, and what is left out for which reason.

A finished run is a folder with the resolved ``config.yaml`` and ``summary.json``; ``run.json`` and
``status.json`` are read where they are (of a committed result only the first two are kept).
"""

from __future__ import annotations

import json
import math
import os
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NoReturn

import yaml

from edtorch.renamed import current_keys, current_target
from edtorch.report import legacy
from edtorch.report.domain import Domain, from_json
from edtorch.report.statistics import GENERIC

CONFIG, SUMMARY, STATUS, ABOUT = "config.yaml", "summary.json", "status.json", "run.json"
ABOUT_KINDS: dict[str, type] = {"versions": dict, "command": str, "git": str}
"""What is only shown, wherever it stands."""
FlatSettings = Mapping[str, Any]
Known = Callable[[FlatSettings], Domain | None]
"""From the settings of a run whose summary does not describe its domain to the domain, if known."""


class Unusable(Exception):
    """A folder that cannot be part of a report; the message says why."""


@dataclass(frozen=True)
class LeftOut:
    """What is not in the report, and why."""

    path: Path
    why: str


@dataclass(frozen=True)
class FinishedRun:
    """A finished run.

    settings: every leaf of its configuration by its full key; summary: in the keys of today; about:
    of ``run.json``, empty where there is none.
    """

    path: Path
    settings: FlatSettings
    summary: Mapping[str, Any]
    about: Mapping[str, Any]
    domain: Domain

    @property
    def is_search(self) -> bool:
        """Whether it is of a rival that counts policies, not of learners with a seed each."""
        return "seeds" not in self.summary

    @property
    def learns(self) -> bool:
        """Whether it is of a method that learns from experience: a regulator has none."""
        lived = self.summary.get("simulated_seconds")
        return not isinstance(lived, list) or any(lived)

    @property
    def seeds(self) -> list[int]:
        """In the order of the summary's figures."""
        return [self.summary["seed"]] if self.is_search else list(self.summary["seeds"])

    def per_seed(self, *keys: str) -> list[float | None] | None:
        """The figures under this path in the summary; None where it has no such figure."""
        found: Any = self.summary
        for key in keys:
            found = found.get(key) if isinstance(found, Mapping) else None
        return found["per_seed"] if isinstance(found, Mapping) and "per_seed" in found else None


def flat(node: Mapping[str, Any], prefix: str = "") -> dict[str, Any]:
    """Leaves by full key; an empty mapping has none.  Targets have their present names."""
    leaves: dict[str, Any] = {}
    for key, value in node.items():
        if isinstance(value, Mapping):
            leaves |= flat(value, f"{prefix}{key}.")
        elif key == "_target_" and isinstance(value, str):
            leaves[f"{prefix}{key}"] = current_target(value)
        else:
            leaves[f"{prefix}{key}"] = value
    return leaves


def find(folders: Sequence[Path]) -> tuple[list[Path], list[LeftOut]]:
    """The run folders in and under these, each once, in the order given and then by name.

    A folder that holds a configuration or a summary is taken for a run and not looked into; names
    that begin with a dot are not looked at.
    """
    found: dict[Path, Path] = {}
    left_out: list[LeftOut] = []
    for folder in folders:
        inside = list(_runs_under(folder))
        if not inside:
            left_out.append(LeftOut(folder, f"holds no run: no {CONFIG} in it or below"))
        for path in inside:
            found.setdefault(path.resolve(), path)
    return list(found.values()), left_out


def _natural(name: str) -> list[tuple[int, int, str]]:
    """Sorts job 2 before job 10."""
    pieces = "".join(c if c.isdigit() else f" {c} " for c in name).split()
    return [(0, int(p), "") if p.isdecimal() else (1, 0, p) for p in pieces]


def _runs_under(folder: Path) -> list[Path]:
    found: list[Path] = []
    for place, folders, files in os.walk(folder):
        if CONFIG in files or SUMMARY in files:
            found.append(Path(place))
            folders.clear()
        folders[:] = sorted((f for f in folders if not f.startswith(".")), key=_natural)
    return found


def _nothing(settings: FlatSettings) -> None:
    return None


def load_run(path: Path, known: Known = _nothing) -> FinishedRun:
    """Raises Unusable."""
    status = _json(path / STATUS) if (path / STATUS).exists() else None
    if status is not None and status.get("status") != "done":
        why = status.get("why")
        reason = f": {why}" if why else ""
        raise Unusable(f"unfinished: {STATUS} says {status.get('status')}{reason}")
    if not (path / SUMMARY).exists():
        raise Unusable(f"unfinished: it has no {SUMMARY}")
    if not (path / CONFIG).exists():
        raise Unusable(f"it has no {CONFIG}")
    settings = _settings(path / CONFIG)
    if "domain._target_" not in settings:
        raise Unusable(f"{CONFIG}: expected domain._target_, which names the domain")
    about = _json(path / ABOUT) if (path / ABOUT).exists() else {}
    summary = _json(path / SUMMARY)
    domain = _domain(summary, settings, known)
    if "domain" not in summary:
        summary = legacy.modern(summary, domain)
    run = FinishedRun(path, settings, summary, about, domain)
    (_check_search if run.is_search else _check_learning)(summary)
    return run


def _domain(summary: Mapping[str, Any], settings: FlatSettings, known: Known) -> Domain:
    if "domain" not in summary:
        name = str(settings["domain._target_"]).rpartition(".")[2]
        return known(settings) or legacy.old_domain(name, summary)
    try:
        return from_json(summary["domain"])
    except (KeyError, TypeError, ValueError) as error:
        why = f"domain: expected name, words and measures ({error})"
        raise Unusable(f"corrupted: {SUMMARY}: {why}") from error


def load_all(
    folders: Sequence[Path], known: Known = _nothing
) -> tuple[list[FinishedRun], list[LeftOut]]:
    """The finished runs in and under the folders, and what cannot be used."""
    paths, left_out = find(folders)
    runs: list[FinishedRun] = []
    for path in paths:
        try:
            runs.append(load_run(path, known))
        except Unusable as error:
            left_out.append(LeftOut(path, str(error)))
    return runs, left_out


def _text(path: Path) -> str:
    try:
        return path.read_text(encoding="utf-8")
    except UnicodeDecodeError as error:
        raise Unusable(f"corrupted: {path.name} is not UTF-8 text ({error.reason})") from error
    except OSError as error:
        raise Unusable(f"{path.name} cannot be read ({error.strerror})") from error


def _no_number(name: str) -> NoReturn:
    raise ValueError(f"{name} is no JSON")


def _finite(text: str) -> float:
    """A number that a report can print again: 1e999 is none."""
    number = float(text)
    if not math.isfinite(number):
        _no_number(text)
    return number


def _whole(text: str) -> int:
    _finite(text)
    return int(text)


def _json(path: Path) -> dict[str, Any]:
    try:
        content = json.loads(
            _text(path), parse_constant=_no_number, parse_float=_finite, parse_int=_whole
        )
    except (ValueError, RecursionError) as error:
        raise Unusable(f"corrupted: {path.name} is not JSON ({error})") from error
    if not isinstance(content, dict):
        raise Unusable(f"corrupted: {path.name}: expected an object")
    for key, kind in ABOUT_KINDS.items():
        if not isinstance(content.get(key), kind | None):
            expected = f"{kind.__name__} or nothing"
            raise Unusable(f"corrupted: {path.name}: {key}: expected {expected}")
    return content


def _settings(path: Path) -> dict[str, Any]:
    try:
        content = yaml.safe_load(_text(path))
        if isinstance(content, dict):
            return flat(current_keys(content))
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        why = " ".join(str(error).split())
        raise Unusable(f"corrupted: {path.name} is not YAML ({why})") from error
    raise Unusable(f"corrupted: {path.name}: expected a mapping of settings")


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def _is_list_of(kind: type, value: object) -> bool:
    return isinstance(value, list) and all(
        isinstance(v, kind) and not isinstance(v, bool) for v in value
    )


FIRST = ("failures_before_first_success", "seconds_before_first_success")
"""Known for every seed, where success is defined."""


def _check_learning(summary: Mapping[str, Any]) -> None:
    seeds = summary["seeds"]
    if not _is_list_of(int, seeds) or not seeds or len(set(seeds)) != len(seeds):
        raise Unusable(f"corrupted: {SUMMARY}: seeds: expected different integers, at least one")
    if not any(key in summary for key in (*FIRST, *GENERIC)):
        raise Unusable(f"corrupted: {SUMMARY}: expected figures, such as {GENERIC[0]}")
    if any(key in summary for key in (*FIRST, "never_succeeded")):
        _check_first(summary, seeds)
    _check_spreads(summary, len(seeds), "")
    _check_milestones(summary, seeds)
    if not isinstance(summary.get("final", {}), dict):
        raise Unusable(f"corrupted: {SUMMARY}: final: expected figures by name")
    evaluations = summary.get("evaluations", [])
    if not isinstance(evaluations, list) or not all(map(_is_evaluation, evaluations)):
        raise Unusable(f"corrupted: {SUMMARY}: evaluations: expected figures, each with minutes")


def _check_first(summary: Mapping[str, Any], seeds: Sequence[int]) -> None:
    for key in FIRST:
        values = summary.get(key)
        values = values.get("per_seed") if isinstance(values, dict) else None
        if not isinstance(values, list) or not all(map(_is_number, values)):
            raise Unusable(f"corrupted: {SUMMARY}: {key}.per_seed: expected a number per seed")
    never = summary.get("never_succeeded")
    if not _is_list_of(int, never) or not set(never or ()) <= set(seeds):
        raise Unusable(f"corrupted: {SUMMARY}: never_succeeded: expected some of its seeds")


def _check_milestones(summary: Mapping[str, Any], seeds: Sequence[int]) -> None:
    """Each with what was paid, and the seeds that were never there."""
    found = summary.get("milestones", {})
    if not isinstance(found, dict):
        raise Unusable(f"corrupted: {SUMMARY}: milestones: expected figures by name")
    for name, told in found.items():
        never = told.get("never") if isinstance(told, dict) else None
        if not _is_list_of(int, never) or not set(never or ()) <= set(seeds):
            raise Unusable(
                f"corrupted: {SUMMARY}: milestones.{name}.never: expected some of its seeds"
            )


def _is_evaluation(node: Any) -> bool:
    return (
        isinstance(node, dict)
        and _is_number(node.get("minutes"))
        and all(isinstance(v, dict) for k, v in node.items() if k != "minutes")
    )


def _check_spreads(node: Any, size: int, place: str) -> None:
    """Every figure per seed has one for each, a number or null."""
    if isinstance(node, list):
        for k, item in enumerate(node):
            _check_spreads(item, size, f"{place.removesuffix('.')}[{k}].")
    if not isinstance(node, dict):
        return
    for key, value in node.items():
        if key != "per_seed":
            _check_spreads(value, size, f"{place}{key}.")
        elif not isinstance(value, list) or len(value) != size:
            raise Unusable(f"corrupted: {SUMMARY}: {place}per_seed: expected {size} figures")
        elif not all(v is None or _is_number(v) for v in value):
            raise Unusable(f"corrupted: {SUMMARY}: {place}per_seed: expected numbers or null")


RATE = ("count", "total")
"""What a share is told by."""


def _check_search(summary: Mapping[str, Any]) -> None:
    if not isinstance(summary.get("seed"), int) or not shares_of(summary):
        raise Unusable(
            f"{SUMMARY}: expected the figures of learners (seeds) or of a search (seed and shares)"
        )
    for key, share in shares_of(summary).items():
        count, total = (share[name] for name in RATE)
        if not (_is_list_of(int, [count, total]) and 0 <= count <= total and total > 0):
            raise Unusable(f"corrupted: {SUMMARY}: {key}: expected a count out of a total")


def shares_of(summary: Mapping[str, Any]) -> dict[str, Mapping[str, Any]]:
    """The shares in the summary of a search, by name."""
    return {
        key: value
        for key, value in summary.items()
        if isinstance(value, Mapping) and all(name in value for name in RATE)
    }
