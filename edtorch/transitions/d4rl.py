"""D4RL's flat arrays, HDF5 or npz: all rows of all episodes one after the other.

observations ``[N, k]``, actions ``[N, m]``, terminals and timeouts ``[N]``, and perhaps
next_observations ``[N, k]``.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from edtorch.run.files import FileProblem
from edtorch.run.plausible import periods
from edtorch.run.recorded import shorter_way
from edtorch.transitions.arrays import components, flags
from edtorch.transitions.candidates import Candidates, followed
from edtorch.transitions.columns import FileColumn
from sims.base import Spec

_WANTED = ("observations", "actions", "terminals", "timeouts")
_NEXT = "next_observations"


def npz_arrays(path: Path) -> dict[str, np.ndarray]:
    """Those arrays of an npz file that are of the layout.  Raises FileProblem."""
    try:
        with path.open("rb") as file:
            content = np.load(file, allow_pickle=False)
            if isinstance(content, np.lib.npyio.NpzFile):
                return {name: content[name] for name in (*_WANTED, _NEXT) if name in content}
    except Exception as error:
        # Zip, zlib, the headers' parser and numpy each raise their own about a broken file.
        why = " ".join(str(error).split()) or type(error).__name__
        raise FileProblem(f"{path}: cannot be read as an .npz file of arrays ({why})") from error
    raise FileProblem(f"{path}: expected an .npz file of several arrays")


def from_d4rl(
    path: Path,
    content: Mapping[str, Any],
    spec: Spec,
    state: Sequence[FileColumn],
    action: Sequence[FileColumn],
) -> Candidates:
    """A transition for each row, of ``spec.dt`` seconds; without next_observations to the next row,
    and none from the last row of an episode.  Raises FileProblem."""
    lacking = [name for name in _WANTED if name not in content]
    if lacking:
        raise FileProblem(f"{path}: lacks {', '.join(lacking)}")
    actions = components(f"{path}: actions", content["actions"], spec.action, action)
    rows = len(actions)

    def observed(name: str) -> np.ndarray:
        found = components(f"{path}: {name}", content[name], spec.state, state)
        if len(found) != rows:
            raise FileProblem(f"{path}: {name} has {len(found)} rows, expected {rows}, as actions")
        return found

    states = observed("observations")
    terminals, timeouts = (flags(f"{path}: {name}", content[name], rows) for name in _WANTED[2:])
    ends = terminals | timeouts
    follows = followed(states)
    if _NEXT in content:
        next_states, unusable = observed(_NEXT), {}
        apart = np.abs(shorter_way(next_states - follows, periods(spec)))
        # Rounding only: rows that do not meet would be refused as one episode.
        broken = ~ends & (apart > 2 * np.spacing(np.abs(follows))).any(-1)
    else:
        next_states, broken = follows, np.zeros(rows, dtype=bool)
        unusable = {
            "the end of an episode: no next observation": ends,
            "the last row: no next observation": np.arange(rows) == rows - 1,
        }
    return Candidates(
        states,
        actions,
        next_states,
        np.full(rows, spec.dt),
        np.cumsum(ends) - ends,
        terminals,
        unusable,
        broken,
    )
