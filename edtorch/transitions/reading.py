"""Foreign files by their kind, into transitions of a domain."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edtorch.run.files import FileProblem
from edtorch.run.recorded import Recorded
from edtorch.run.transitions_file import save_transitions
from edtorch.transitions.arrays import opened
from edtorch.transitions.candidates import Candidates, kept
from edtorch.transitions.columns import FileColumn, parse_column
from edtorch.transitions.csv_log import Clock, from_csv
from edtorch.transitions.d4rl import from_d4rl, npz_arrays
from edtorch.transitions.minari import EPISODE, MAIN, from_minari
from sims.base import Quantity, Spec

_SUFFIXES = (".csv", ".npz", ".hdf5", ".h5")


@dataclass(frozen=True)
class Imported:
    """Transitions from a foreign file; rows: how many it holds; dropped: rows by reason; broken:
    how many rows within an episode do not end where the next one begins, and so end it."""

    recorded: Recorded
    rows: int
    dropped: Mapping[str, int]
    broken: int


def _columns(given: Sequence[str | FileColumn]) -> list[FileColumn]:
    return [parse_column(each) if isinstance(each, str) else each for each in given]


def read(
    path: str | Path,
    spec: Spec,
    state: Sequence[str | FileColumn] = (),
    action: Sequence[str | FileColumn] = (),
    time: str | FileColumn | None = None,
    episode: str | None = None,
    gap: float | None = None,
) -> Imported:
    """The transitions of a foreign file in the units of ``spec``, a sim's or ``described_spec``.

    state, action: ``NAME[UNIT]=COLUMN[UNIT]``; a component that is not mentioned has the column of
    its name (CSV) or place (arrays), in its own unit.  For CSV: time: the column of the stamps,
    ``t[ms]``, without it each step takes ``spec.dt``; episode: the column of the episode; gap:
    seconds, a longer step is dropped.  Raises FileProblem with file and key or line.
    """
    path = _file(Path(path))
    clock = Clock(parse_column(time) if isinstance(time, str) else time, episode, gap)
    rows = _rows(path, spec, _columns(state), _columns(action), clock)
    recorded, dropped = kept(rows)
    if not len(recorded):
        reasons = "; ".join(f"{count} rows: {reason}" for reason, count in dropped.items())
        raise FileProblem(f"{path}: no transition is left of {len(rows.dt)} rows ({reasons})")
    return Imported(recorded, len(rows.dt), dropped, int(rows.broken.sum()))


def _file(path: Path) -> Path:
    """The file to read; of a Minari data set's folder its main one."""
    if path.is_dir():
        inside = [path / MAIN, path / "data" / MAIN]
        found = [each for each in inside if each.is_file()]
        if not found:
            raise FileProblem(f"{path}: expected a folder with {MAIN}, or a file")
        return found[0]
    if path.suffix.lower() not in _SUFFIXES:
        raise FileProblem(f"{path}: expected a name that ends in one of {', '.join(_SUFFIXES)}")
    if not path.exists():
        raise FileProblem(f"{path}: no such file")
    return path


def _rows(
    path: Path, spec: Spec, state: list[FileColumn], action: list[FileColumn], clock: Clock
) -> Candidates:
    """The rows of a file, by its kind."""
    suffix = path.suffix.lower()
    if suffix == ".csv":
        return from_csv(path, spec, state, action, clock)
    if clock != Clock():
        raise FileProblem(f"{path}: time, episode and gap are of CSV files, expected none of them")
    if suffix == ".npz":
        return from_d4rl(path, npz_arrays(path), spec, state, action)
    with opened(path) as content:
        if any(name.startswith(EPISODE) for name in content):
            return from_minari(path, content, spec, state, action)
        return from_d4rl(path, content, spec, state, action)


def check_new(path: Path) -> None:
    """Refuse, as FileProblem, a file that exists or whose folder does not."""
    if path.exists():
        raise FileProblem(f"{path}: exists already, expected the name of a new file")
    if not path.parent.is_dir():
        raise FileProblem(f"{path}: expected a folder {path.parent} to write to")


def _about(quantity: Quantity) -> dict[str, str]:
    return {"name": quantity.name} | ({"unit": quantity.unit} if quantity.unit else {})


def save_imported(
    path: Path, imported: Imported, spec: Spec, about: Mapping[str, Any] | None = None
) -> None:
    """Write ``transitions.npz``; its ``meta`` has what was dropped.  A file that exists is refused.

    Of the components it says names and units, so that the domain's own scales and periods apply.
    """
    check_new(path)
    meta = {
        "state": [_about(q) for q in spec.state],
        "action": [_about(q) for q in spec.action],
        "dropped": dict(imported.dropped),
        "broken": imported.broken,
    }
    save_transitions(path, imported.recorded, spec, meta | dict(about or {}))
