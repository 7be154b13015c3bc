"""Runs of one configuration with different seeds are one group; groups differ by their settings."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from edtorch.report.domain import Domain, ReturnOf
from edtorch.report.runs import FIRST, FinishedRun, FlatSettings, LeftOut

Defaults = Callable[[FlatSettings], FlatSettings]
"""From the settings of a run to those that it does not name, with the values they have today."""


class BaselineUnknown(ValueError):
    """No group answers to the name of the baseline; the message lists the labels."""


HOW_NOT_WHAT = (
    "seed",
    "seeds",
    "debug",
    "log",
    "sweep",
    "compute.threads",
    "compute.native",
    "domain.workers",
    "rival.processes",
    "rival.slots",
    "rival.look",
)
"""Settings, or groups of them, that say how a run is made and change none of its figures."""
UNSET = "unset"
"""Shown for a setting that the configuration does not have."""
MOST_SETTINGS = 3
"""Beyond so many differing settings a label tells only what differs from the baseline."""
LONGEST_LABEL = 60


@dataclass(frozen=True)
class Place:
    """Where the figures of a seed stand: of this run, in this row."""

    seed: int
    run: FinishedRun
    row: int


@dataclass(frozen=True)
class Group:
    """Runs of one configuration.  label: what it is called in the report; name: after its first
    folder; differing: its value of every setting in which the groups of its section differ."""

    label: str
    name: str
    differing: Mapping[str, Any]
    settings: FlatSettings
    runs: tuple[FinishedRun, ...]
    places: tuple[Place, ...]

    @property
    def learns(self) -> bool:
        """Whether its method learns."""
        return any(run.learns for run in self.runs)

    @property
    def seeds(self) -> list[int]:
        """Each once."""
        return [place.seed for place in self.places]

    def per_seed(self, *keys: str) -> list[float | None]:
        """The figures under this path in the summaries, one for each seed; None for none."""
        columns = {id(run): run.per_seed(*keys) for run in self.runs}
        return [
            None if (column := columns[id(place.run)]) is None else column[place.row]
            for place in self.places
        ]


@dataclass(frozen=True)
class Section:
    """Groups that can be compared: of one domain, and all learners or all searches."""

    domain: str
    searches: bool
    groups: tuple[Group, ...]

    @property
    def about(self) -> Domain:
        """What its results are called, with the measures of all runs."""
        found = [run.domain for group in self.groups for run in group.runs]
        measures = {m.name: m for domain in found for m in domain.measures}
        kinds: list[ReturnOf] = [domain.return_of for domain in found if domain.return_of]
        return replace(
            found[0], measures=tuple(measures.values()), return_of=kinds[0] if kinds else ""
        )

    @property
    def title(self) -> str:
        """For headings."""
        return f"{self.domain}: {'searches' if self.searches else 'learners'}"


def telling(settings: FlatSettings) -> dict[str, Any]:
    """Without those that change no figure."""

    def tells(key: str) -> bool:
        return not any(key == name or key.startswith(f"{name}.") for name in HOW_NOT_WHAT)

    return {key: value for key, value in settings.items() if tells(key)}


def sections(
    runs: Sequence[FinishedRun], defaults: Defaults, *, baseline: str | None, by_folder: bool
) -> tuple[list[Section], list[LeftOut]]:
    """Sort the runs; the first group of each section is what the others are compared with.

    baseline: label or folder of the group that is to be first; by_folder: labels are the names of
    folders.  Raises BaselineUnknown for a baseline that no group answers to.
    """
    kinds: dict[tuple[str, str, bool], list[FinishedRun]] = {}
    for run in runs:
        kind = (run.settings["domain._target_"], _name(run), run.is_search)
        kinds.setdefault(kind, []).append(run)
    left_out: list[LeftOut] = []
    names = _short_names([run.path for run in runs])
    made, found, known = [], baseline is None, []
    for (_, domain, searches), members in kinds.items():
        pools: dict[str, tuple[dict[str, Any], list[FinishedRun]]] = {}
        for run in members:
            settings = telling({**defaults(run.settings), **run.settings})
            # Numbers that are equal are written alike: 10 and 10.0 are one setting.
            key = repr(sorted((k, _plain(v)) for k, v in settings.items()))
            pools.setdefault(key, (settings, []))[1].append(run)
        pooled = [_pool(members, left_out) for _, members in pools.values()]
        every = [settings for settings, _ in pools.values()]
        titles = _titles(pooled, names)
        differing = _differing(every)
        first = 0
        if baseline is not None:
            labels = _labels(every, differing, titles, 0, by_folder)
            known += labels
            matches = [
                k
                for k, label in enumerate(labels)
                if baseline in (label, titles[k], pooled[k][0].path.name)
            ]
            first, found = (matches[0], True) if matches else (0, found)
        labels = _labels(every, differing, titles, first, by_folder)
        groups = [
            Group(
                label=label,
                name=title,
                differing={key: settings.get(key, UNSET) for key in differing},
                settings=settings,
                runs=tuple(own),
                places=tuple(places(own)),
            )
            for label, title, settings, own in zip(labels, titles, every, pooled, strict=True)
        ]
        groups.insert(0, groups.pop(first))
        made.append(Section(domain, searches, tuple(groups)))
    if not found:
        raise BaselineUnknown(f"baseline={baseline}: expected one of {', '.join(known)}")
    return made, left_out


def _name(run: FinishedRun) -> str:
    """Of its domain: the class, or which of the many environments that the class can be."""
    target = str(run.settings["domain._target_"]).rpartition(".")[2]
    return str(run.settings.get("domain.env_id", target))


def _plain(value: Any) -> Any:
    return float(value) if isinstance(value, int) and not isinstance(value, bool) else value


def _pool(runs: list[FinishedRun], left_out: list[LeftOut]) -> list[FinishedRun]:
    """The runs that add a seed; what repeats one is named."""
    kept: list[FinishedRun] = []
    owners: dict[int, FinishedRun] = {}
    for run in runs:
        repeated = [seed for seed in run.seeds if seed in owners]
        if repeated:
            other = owners[repeated[0]]
            same = _figures(run, repeated) == _figures_of(owners, repeated)
            figures = "the same figures" if same else "other figures"
            those = "all of its seeds" if len(repeated) == len(run.seeds) else _listed(repeated)
            left_out.append(
                LeftOut(run.path, f"{those}: counted once, from {other.path} ({figures})")
            )
        if len(repeated) < len(run.seeds):
            kept.append(run)
        for seed in run.seeds:
            owners.setdefault(seed, run)
    return kept


def _figures(run: FinishedRun, seeds: list[int]) -> list[Any]:
    """What tells whether two runs of a seed went alike."""
    if run.is_search:
        return [{k: v for k, v in run.summary.items() if isinstance(v, dict) and "count" in v}]
    columns = [run.per_seed(key) for key in (*FIRST, "episode_s")]
    rows = [run.seeds.index(seed) for seed in seeds]
    return [[column[row] for column in columns if column is not None] for row in rows]


def _figures_of(owners: Mapping[int, FinishedRun], seeds: list[int]) -> list[Any]:
    return [figures for seed in seeds for figures in _figures(owners[seed], [seed])]


def _listed(seeds: Sequence[int], most: int = 8) -> str:
    shown = ", ".join(map(str, seeds[:most]))
    more = f" and {len(seeds) - most} more" if len(seeds) > most else ""
    return f"seed{'s' if len(seeds) > 1 else ''} {shown}{more}"


def places(runs: Sequence[FinishedRun]) -> list[Place]:
    """Of every seed once, in order."""
    found: dict[int, Place] = {}
    for run in runs:
        for row, seed in enumerate(run.seeds):
            found.setdefault(seed, Place(seed, run, row))
    return sorted(found.values(), key=lambda place: place.seed)


def _short_names(paths: Sequence[Path]) -> dict[Path, str]:
    """The shortest ends of the paths that tell them apart."""
    parts = {path: path.resolve().parts for path in paths}
    names: dict[Path, str] = {}
    for path, own in parts.items():
        others = [p for p in parts.values() if p != own]
        for length in range(1, len(own) + 1):
            if all(other[-length:] != own[-length:] for other in others):
                names[path] = "/".join(own[-length:])
                break
        else:
            names[path] = str(path)
    return names


def _differing(every: Sequence[FlatSettings]) -> list[str]:
    """The settings in which the groups differ.

    Where two groups have different objects somewhere (``fit._target_``), the object's name tells
    that, and its own settings are compared among those with the same one only.
    """
    keys = sorted({key for settings in every for key in settings})
    targets = [key for key in keys if key.endswith("._target_")]

    def kin(key: str, settings: FlatSettings) -> tuple[Any, ...]:
        above = [t for t in targets if key != t and key.startswith(t.removesuffix("_target_"))]
        return tuple(settings.get(t) for t in above)

    differing: list[str] = []
    for key in keys:
        values: dict[tuple[Any, ...], set[str]] = {}
        for settings in every:
            family = values.setdefault(kin(key, settings), set())
            family.add(repr(_plain(settings.get(key, UNSET))))
        if any(len(family) > 1 for family in values.values()):
            differing.append(key)
    return differing


def shown(key: str, value: Any) -> str:
    """``fit=RecursiveLeastSquares``, ``step.alpha=0.3``."""
    if key.endswith("._target_"):
        return f"{key.removesuffix('._target_')}={str(value).rpartition('.')[2]}"
    if isinstance(value, float):
        return f"{key}={value:g}"
    # As it is written in a configuration and on the command line.
    return f"{key}={json.dumps(value) if isinstance(value, bool | None) else value}"


def _titles(pooled: Sequence[Sequence[FinishedRun]], names: Mapping[Path, str]) -> list[str]:
    """Of each group: the folder that holds all of its runs, if it has several and no other group
    has one there, else that of its first run."""
    parents = [{run.path.parent for run in members} for members in pooled]
    titles: list[str] = []
    for members, own in zip(pooled, parents, strict=True):
        name = names[members[0].path]
        alone = len(own) == 1 and sum(bool(own & others) for others in parents) == 1
        above = name.rpartition("/")[0]
        titles.append(above if len(members) > 1 and alone and above else name)
    return titles


def _labels(
    every: Sequence[FlatSettings],
    differing: Sequence[str],
    titles: Sequence[str],
    first: int,
    by_folder: bool,
) -> list[str]:
    if by_folder or not differing:
        return list(titles)
    few = len(differing) <= MOST_SETTINGS
    base = every[first]
    labels: list[str] = []
    for settings in every:
        told = [
            shown(key, settings[key])
            for key in differing
            if key in settings and (few or settings[key] != base.get(key))
        ]
        labels.append(", ".join(told))
    return [
        title if not label or len(label) > LONGEST_LABEL or labels.count(label) > 1 else label
        for label, title in zip(labels, titles, strict=True)
    ]
