"""Arrays of observations and actions in a file, by column."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from edtorch.run.files import FileProblem
from edtorch.transitions.columns import FileColumn, matched, matrix
from sims.base import Quantity


@contextmanager
def opened(path: Path) -> Iterator[Any]:
    """An HDF5 file.  Raises FileProblem where it, or h5py, is none."""
    try:
        import h5py  # pyright: ignore[reportMissingImports]
    except ModuleNotFoundError as error:
        raise FileProblem(
            f"{path}: expected h5py to read HDF5 with: pip install 'edtorch[data]'"
        ) from error
    try:
        with h5py.File(path, "r") as file:
            yield file
    except FileProblem:
        raise
    except (OSError, RuntimeError, LookupError, ValueError, TypeError) as error:
        why = " ".join(str(error).split())
        raise FileProblem(f"{path}: cannot be read as HDF5 ({why})") from error


def values(where: str, node: Any) -> np.ndarray:
    """The numbers of an array or an HDF5 dataset, as they are stored."""
    if not hasattr(node, "dtype") or node.dtype.kind not in "biuf":
        held = getattr(node, "dtype", "other arrays")
        raise FileProblem(f"{where}: holds {held}, expected numbers")
    return np.asarray(node[()])


def flags(where: str, node: Any, rows: int) -> np.ndarray:
    """``[rows]`` of true and false, or 1 and 0."""
    found = values(where, node)
    if found.shape not in ((rows,), (rows, 1)):
        raise FileProblem(f"{where}: has shape {found.shape}, expected {(rows,)}, as the actions")
    found = found.reshape(rows)
    other = np.flatnonzero((found != 0) & (found != 1))
    if len(other):
        row = int(other[0])
        raise FileProblem(
            f"{where}: row {row} is {found[row]}, expected true and false, or 1 and 0"
        )
    return found.astype(bool)


def _by_name(where: str, node: Any) -> dict[str, np.ndarray]:
    """Columns: "0", "1"... of an array ``[N]`` or ``[N, k]``, "key/0"... of a group of them."""
    if hasattr(node, "keys"):
        return {
            f"{key}/{name}": column
            for key in node
            for name, column in _by_name(f"{where}/{key}", node[key]).items()
        }
    array = values(where, node)
    if array.ndim not in (1, 2):
        raise FileProblem(f"{where}: has shape {array.shape}, expected rows and columns")
    columns = array[:, None] if array.ndim == 1 else array
    return {str(place): column for place, column in enumerate(columns.T)}


def components(
    where: str, node: Any, quantities: Sequence[Quantity], columns: Sequence[FileColumn]
) -> np.ndarray:
    """The components ``[N, n]`` in the domain's units; where: file and array.

    One that names no column is at its own place, if there are as many columns as components.
    """
    known = _by_name(where, node)
    lengths = {name: len(column) for name, column in known.items()}
    if len(set(lengths.values())) > 1:
        raise FileProblem(f"{where}: has columns of lengths {lengths}, expected one length")

    def get(name: str) -> np.ndarray:
        if name not in known:
            raise FileProblem(f"{where}: has no column {name!r}, but {', '.join(known) or 'none'}")
        return known[name]

    def default(place: int, quantity: Quantity) -> str:
        if hasattr(node, "keys") or len(known) != len(quantities):
            raise FileProblem(
                f"{where}: {quantity.name} has no column: expected {len(quantities)} columns, or"
                f" {quantity.name}=COLUMN with one of {', '.join(known)}"
            )
        return str(place)

    return matrix(get, matched(where, quantities, columns, default))
