"""Foreign files by their kind, into transitions of a domain."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from edtorch.run.checkpoint import FileProblem
from edtorch.run.recorded import Recorded
from edtorch.run.transitions_file import save_transitions
from edtorch.transitions.candidates import Candidates, kept
from edtorch.transitions.columns import FileColumn, parse_column
from edtorch.transitions.csv_log import Clock, from_csv
from sims.base import Quantity, Spec

_Reader = Callable[[Path, Spec, list[FileColumn], list[FileColumn], Clock], Candidates]
_READERS: dict[str, _Reader] = {".csv": from_csv}


@dataclass(frozen=True)
class Imported:
    """Transitions from a foreign file; rows: how many it holds; dropped: rows by reason."""

    recorded: Recorded
    rows: int
    dropped: Mapping[str, int]


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
    path = Path(path)
    suffix = path.suffix.lower()
    if suffix not in _READERS:
        raise FileProblem(f"{path}: expected a name that ends in one of {', '.join(_READERS)}")
    if not path.exists():
        raise FileProblem(f"{path}: no such file")
    clock = Clock(parse_column(time) if isinstance(time, str) else time, episode, gap)
    if suffix != ".csv" and clock != Clock():
        raise FileProblem(f"{path}: time, episode and gap are of CSV files, expected none of them")
    rows = _READERS[suffix](path, spec, _columns(state), _columns(action), clock)
    recorded, dropped = kept(rows)
    if not len(recorded):
        reasons = "; ".join(f"{count} rows: {reason}" for reason, count in dropped.items())
        raise FileProblem(f"{path}: no transition is left of {len(rows.dt)} rows ({reasons})")
    return Imported(recorded, len(rows.dt), dropped)


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
    }
    save_transitions(path, imported.recorded, spec, meta | dict(about or {}))
