"""``meta`` of ``transitions.npz`` (docs/offline.md), checked: every value that is used is of the
type and range that it is used as."""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, NoReturn, TypeGuard

import numpy as np

from edtorch.renamed import current_component
from edtorch.run.files import FileProblem
from sims.base import Quantity, Spec

FORMAT = 1
_LARGEST = 2**63 - 1
_LONGEST = 80
"""Characters of a value that a message repeats."""
_SEEDS = '{"seed": K, "episodes": [FIRST, AFTER THE LAST]}'
_SAME = 1e-6
"""Relative difference up to which scales and periods are the same: single precision."""


@dataclass(frozen=True)
class FileLayout:
    """How to read the columns of a file in the order of the domain.

    state, action: the column of each component; state_scale, action_scale: what each is to be
    multiplied by; seeds: (seed, first episode, after the last episode) of the learners recorded.
    """

    state: list[int]
    action: list[int]
    state_scale: np.ndarray
    action_scale: np.ndarray
    seeds: list[tuple[int, int, int]]

    def seed_of(self, episode: np.ndarray) -> np.ndarray:
        """The seed ``[N]`` of each row, -1 where the file names none."""
        found = np.full(len(episode), -1, dtype=np.int64)
        for seed, first, after in self.seeds:
            found[(episode >= first) & (episode < after)] = seed
        return found


def read_meta(path: Path, text: np.ndarray, spec: Spec) -> FileLayout:
    """The layout that ``meta`` describes.  FileProblem names the file and the key otherwise."""
    meta = _Meta(path, text)
    meta.equals("format", FORMAT, str(FORMAT))
    recorded = meta.content.get("domain")
    if isinstance(recorded, str) and recorded.endswith(f":{spec.name}"):
        # Names once had the module to import in front: "module:Id".
        meta.content["domain"] = spec.name
    domain = meta.equals("domain", spec.name, spec.name)
    units = meta.content.get("units")
    if units not in ("physical", "scaled"):
        meta.refuse("units", units, "physical or scaled")
    columns = {
        kind: meta.columns(kind, domain, quantities)
        for kind, quantities in (("state", spec.state), ("action", spec.action))
    }
    scales = {
        kind: meta.scales(kind, quantities, columns[kind])
        if units == "scaled"
        else np.ones(len(quantities))
        for kind, quantities in (("state", spec.state), ("action", spec.action))
    }
    return FileLayout(
        columns["state"], columns["action"], scales["state"], scales["action"], meta.seeds()
    )


class _Meta:
    """The JSON object of one file."""

    def __init__(self, path: Path, text: np.ndarray) -> None:
        self._path = path
        if text.size != 1:
            raise FileProblem(f"{path}: meta has shape {text.shape}, expected one text")
        try:
            content = json.loads(str(text.item()), object_pairs_hook=_without_duplicates)
        except (ValueError, RecursionError) as error:
            raise FileProblem(f"{path}: meta is not JSON ({error})") from error
        if not isinstance(content, dict):
            raise FileProblem(f"{path}: meta: expected a JSON object")
        self.content = content

    def refuse(self, key: str, value: Any, expected: str) -> NoReturn:
        raise FileProblem(f"{self._path}: meta.{key}={_shown(value)}: expected {expected}")

    def equals(self, key: str, wanted: Any, expected: str) -> Any:
        value = self.content.get(key)
        if type(value) is not type(wanted) or value != wanted:
            self.refuse(key, value, expected)
        return value

    def columns(self, kind: str, domain: str, quantities: Sequence[Quantity]) -> list[int]:
        """The column of the file that each component of the domain is in."""
        listed = self.content.get(kind)
        if not isinstance(listed, list) or not all(
            isinstance(q, dict) and isinstance(q.get("name"), str) for q in listed
        ):
            raise FileProblem(
                f"{self._path}: meta.{kind}: expected a list of objects with a name each"
            )
        names = [current_component(domain, about["name"]) for about in listed]
        known = [q.name for q in quantities]
        for name in names:
            if name not in known:
                raise FileProblem(
                    f"{self._path}: meta.{kind}: {name!r} is none of the domain's"
                    f" {', '.join(known)}"
                )
        if sorted(names) != sorted(known):
            raise FileProblem(f"{self._path}: meta.{kind}: {names}, expected each of {known} once")
        places = [names.index(name) for name in known]
        for place, quantity in zip(places, quantities, strict=True):
            self._check_column(kind, place, quantity)
        return places

    def _check_column(self, kind: str, place: int, quantity: Quantity) -> None:
        about: Mapping[str, Any] = self.content[kind][place]
        for field in ("scale", "period"):
            value = about.get(field)
            if value is not None and not _is_number(value):
                self.refuse(f"{kind}[{place}].{field}", value, "a finite number")
        unit, period = about.get("unit"), about.get("period")
        wrong = ""
        if unit is not None and unit != quantity.unit:
            wrong = f"unit {_shown(unit)}, expected {quantity.unit}"
        if period is not None and not math.isclose(period, quantity.period, rel_tol=_SAME):
            wrong = f"period {_shown(period)}, expected {quantity.period}"
        if wrong:
            raise FileProblem(f"{self._path}: meta.{kind}: {quantity.name} has {wrong}")

    def scales(self, kind: str, quantities: Sequence[Quantity], places: list[int]) -> np.ndarray:
        """The domain's scales, if the file was divided by the same."""
        for place, q in zip(places, quantities, strict=True):
            found = self.content[kind][place].get("scale")
            if found is None or not math.isclose(found, q.scale, rel_tol=_SAME):
                raise FileProblem(
                    f"{self._path}: meta.{kind}: {q.name} is scaled by {_shown(found)}, expected"
                    f" {q.scale}, the domain's; physical units fit any scale"
                )
        return np.array([q.scale for q in quantities])

    def seeds(self) -> list[tuple[int, int, int]]:
        """Seed, first episode, and the one after the last, of each entry."""
        if "seeds" not in self.content:
            return []
        listed = self.content["seeds"]
        if not isinstance(listed, list):
            self.refuse("seeds", listed, f"a list of {_SEEDS}")
        found: list[tuple[int, int, int]] = []
        for place, each in enumerate(listed):
            key = f"seeds[{place}]"
            if not isinstance(each, dict):
                self.refuse(key, each, _SEEDS)
            seed, span = each.get("seed"), each.get("episodes")
            if not _is_index(seed) or seed < 0:
                self.refuse(f"{key}.seed", seed, f"an integer from 0 to 2^63 - 1 in {_SEEDS}")
            if (
                not isinstance(span, list)
                or len(span) != 2
                or not all(_is_index(number) for number in span)
                or span[0] >= span[1]
            ):
                self.refuse(f"{key}.episodes", span, f"two integers, FIRST below, of {_SEEDS}")
            found.append((seed, span[0], span[1]))
        self._check_overlaps(found)
        return found

    def _check_overlaps(self, seeds: list[tuple[int, int, int]]) -> None:
        order = sorted(range(len(seeds)), key=lambda place: seeds[place][1:])
        for one, other in pairwise(order):
            if seeds[other][1] < seeds[one][2]:
                self.refuse(
                    f"seeds[{other}].episodes",
                    list(seeds[other][1:]),
                    f"episodes that seeds[{one}], {list(seeds[one][1:])}, does not have",
                )


def _without_duplicates(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found = dict(pairs)
    if len(found) < len(pairs):
        names = [name for name, _ in pairs]
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"{_shown(twice)} is given twice")
    return found


def _is_index(value: Any) -> TypeGuard[int]:
    return type(value) is int and abs(value) <= _LARGEST


def _is_number(value: Any) -> TypeGuard[float]:
    return type(value) in (int, float) and abs(value) <= sys.float_info.max


def _shown(value: Any) -> str:
    """A value of the JSON on one line."""
    text = value if isinstance(value, str) and value.isprintable() else json.dumps(value)
    return text if len(text) <= _LONGEST else f"{text[:_LONGEST]}..."
