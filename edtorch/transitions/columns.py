"""Which column of a file is which component of a domain, and in which units."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np

from edtorch.run.files import FileProblem
from edtorch.transitions.units import conversion
from sims.base import Quantity, Spec

_SIDE = r"\s*(?P<{0}>[^=\[\]]*[^=\[\]\s])\s*(?:\[(?P<{0}_unit>[^\]]*)\])?\s*"
_COLUMN = re.compile(_SIDE.format("name") + f"(?:={_SIDE.format('source')})?")


@dataclass(frozen=True)
class FileColumn:
    """A component ``name`` in ``unit`` from the column ``source`` in ``source_unit``.

    None: the unit of the domain, the column of the same name or place, the unit of the component.
    """

    name: str
    unit: str | None = None
    source: str | None = None
    source_unit: str | None = None


def parse_column(text: str) -> FileColumn:
    """``NAME[UNIT]=COLUMN[UNIT]``, such as ``angle[rad]=theta[deg]``; all but NAME may be absent.

    Raises ValueError.
    """
    match = _COLUMN.fullmatch(text)
    if match is None:
        raise ValueError(f"{text!r}: expected NAME[UNIT]=COLUMN[UNIT], as in angle[rad]=theta[deg]")
    found = match.groupdict()
    return FileColumn(found["name"], found["name_unit"], found["source"], found["source_unit"])


def described_spec(
    domain: str, dt: float, state: Sequence[FileColumn], action: Sequence[FileColumn]
) -> Spec:
    """A domain of which only names, units and the time step (s) are known.  Raises ValueError."""
    if not (math.isfinite(dt) and dt > 0):
        raise ValueError(f"dt={dt}: expected a finite number of seconds > 0")
    for kind, columns in (("state", state), ("action", action)):
        names = [column.name for column in columns]
        if not names or len(set(names)) < len(names):
            raise ValueError(f"{kind}={names}: expected one name or more, each once")
    quantities = [
        tuple(Quantity(c.name, c.unit or "") for c in columns) for columns in (state, action)
    ]
    return Spec(
        name=domain,
        state=quantities[0],
        action=quantities[1],
        dt=dt,
        time_limit=math.inf,
        disturbance_dim=0,
        reset_dim=0,
        clip_action=False,
        headline=state[0].name,
    )


Get = Callable[[str], np.ndarray]
"""A column ``[N]`` of a file by its name; raises FileProblem."""


def matched(
    where: str,
    quantities: Sequence[Quantity],
    columns: Sequence[FileColumn],
    default: Callable[[int, Quantity], str],
) -> list[tuple[str, float]]:
    """The column and the factor of each component; default: the column of one that names none.

    where: file and array, for messages.  Raises FileProblem.
    """
    known = [q.name for q in quantities]
    for column in columns:
        if column.name not in known:
            raise FileProblem(
                f"{where}: {column.name!r} is no component of the domain, expected one of"
                f" {', '.join(known)}"
            )
    if len({column.name for column in columns}) < len(columns):
        raise FileProblem(f"{where}: {[c.name for c in columns]}, expected each component once")
    given = {column.name: column for column in columns}
    found = []
    for place, q in enumerate(quantities):
        column = given.get(q.name, FileColumn(q.name))
        source = default(place, q) if column.source is None else column.source
        try:
            factor = 1.0 if column.unit is None else conversion(column.unit, q.unit)
            if column.source_unit is not None:
                factor = conversion(column.source_unit, q.unit)
        except ValueError as error:
            raise FileProblem(f"{where}: {q.name}: {error}") from error
        if any(source == other for other, _ in found):
            raise FileProblem(
                f"{where}: {q.name}: column {source!r} is another component's already"
            )
        found.append((source, factor))
    return found


def matrix(get: Get, sources: Sequence[tuple[str, float]]) -> np.ndarray:
    """The components ``[N, n]`` in the domain's units."""
    return np.stack(
        [get(source).astype(np.float64) * factor for source, factor in sources], axis=-1
    )
