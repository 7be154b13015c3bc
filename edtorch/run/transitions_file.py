"""``transitions.npz``: recorded transitions, ours or somebody else's (docs/offline.md).

Everything is in physical units on the outside and inside ``Recorded``.  Whatever is wrong with a
file is said with its name and the row concerned.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import fields, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np

from edtorch.run.doubts import doubts
from edtorch.run.files import FileProblem, write_atomically
from edtorch.run.plausible import (
    FACTOR,
    FEW,
    beyond_limits,
    foreign_ends,
    off_the_clock,
    periods,
)
from edtorch.run.recorded import Recorded, first_rows, last_rows, shorter_way
from edtorch.run.recorder import Lived, ended
from edtorch.run.transitions_meta import FORMAT, read_meta
from edtorch.told_apart import told_apart
from sims.base import Quantity, Spec

Invalid = Literal["refuse", "mask"]
"""What is done about rows that are not what they should be."""

_FLAGS = ("terminated", "truncated")
_NUMBERS = ("state", "action", "next_state", "dt")
_SINGLE = float(np.finfo(np.float32).eps)
"""Of a bound, by which an action may exceed it: clipped in one precision, declared in another."""
_ROUNDINGS = 16
"""Of a file's own precision, by which numbers may differ that should be equal."""


class Loaded(NamedTuple):
    """A file's transitions, what was wrong with rows that were masked, and what is odd about the
    others (``edtorch.run.doubts``)."""

    recorded: Recorded
    masked: list[str]
    doubts: list[str]


def gathered(lives: Sequence[Lived], seeds: Sequence[int], dt: float) -> Recorded:
    """The lives of learners, one after the other, as transitions of ``dt`` seconds."""
    episode = [life.episode for life in lives]
    offset = 0
    for index, own in enumerate(episode):
        episode[index] = own + offset
        offset += int(own[-1]) + 1 if len(own) else 0
    number = np.concatenate(episode)
    terminated, succeeded = ended(np.concatenate([life.outcome for life in lives]))
    # The last of each: stopped by the time limit or by the end of the recording, if not over.
    last = np.append(np.diff(number) != 0, np.ones(min(len(number), 1), dtype=bool))
    lengths = [len(own) for own in episode]
    return Recorded(
        state=np.concatenate([life.state for life in lives]),
        action=np.concatenate([life.action for life in lives]),
        next_state=np.concatenate([life.next_state for life in lives]),
        dt=np.full(len(number), dt),
        episode=number,
        terminated=terminated,
        truncated=last & ~terminated,
        succeeded=succeeded,
        seed=np.repeat(np.array(seeds, dtype=np.int64), lengths),
        valid=np.ones(len(number), dtype=bool),
    )


def _described(quantity: Quantity, *, periodic: bool) -> dict[str, Any]:
    about: dict[str, Any] = {
        "name": quantity.name,
        "unit": quantity.unit,
        "scale": quantity.scale,
    }
    return about | ({"period": quantity.period} if periodic else {})


def _seeds(recorded: Recorded) -> list[dict[str, Any]]:
    first = first_rows(recorded.episode)
    seeds, episodes, found = recorded.seed[first], recorded.episode[first], []
    for seed in dict.fromkeys(seeds[seeds >= 0].tolist()):
        own = episodes[seeds == seed]
        found.append({"seed": seed, "episodes": [int(own.min()), int(own.max()) + 1]})
    return found


def save_transitions(
    path: Path, recorded: Recorded, spec: Spec, about: Mapping[str, Any] | None = None
) -> None:
    """Write the file, atomically; about: whatever else is to be said, such as the command."""
    meta = {
        "format": FORMAT,
        "domain": spec.name,
        "units": "physical",
        "state": [_described(q, periodic=True) for q in spec.state],
        "action": [_described(q, periodic=False) for q in spec.action],
        "seeds": _seeds(recorded),
        **(about or {}),
    }
    arrays = {name: getattr(recorded, name) for name in (*_NUMBERS, "episode", *_FLAGS)}

    def write(partial: Path) -> None:
        with partial.open("wb") as file:
            np.savez(file, **arrays, succeeded=recorded.succeeded, meta=json.dumps(meta))

    write_atomically(path, write)


def load_transitions(path: Path, spec: Spec, invalid: Invalid = "refuse") -> Loaded:
    """The transitions of a file that was recorded in the domain ``spec``.

    A file that is not of the format, or of another domain, is refused; so are rows that are wrong,
    or they are masked, as ``invalid`` says.  Raises FileProblem, which names file and row.
    """
    arrays = _arrays(path)
    layout = read_meta(path, arrays.pop("meta"), spec)
    rounding = _ROUNDINGS * max(
        (float(np.finfo(arrays[n].dtype).eps) for n in _NUMBERS if arrays[n].dtype.kind == "f"),
        default=float(np.finfo(np.float64).eps),
    )
    _check_shapes(path, arrays, {"state": len(layout.state), "action": len(layout.action)})
    _check_flags(path, arrays)
    # What is too large for a float64 becomes inf, which is refused with its row.
    with np.errstate(over="ignore"):
        state, next_state = (
            arrays[name].astype(np.float64)[:, layout.state] * layout.state_scale
            for name in ("state", "next_state")
        )
        action = arrays["action"].astype(np.float64)[:, layout.action] * layout.action_scale
        dt = arrays["dt"].astype(np.float64)
    rows = len(state)
    recorded = Recorded(
        state=state,
        action=action,
        next_state=next_state,
        dt=dt,
        episode=arrays["episode"].astype(np.int64),
        terminated=arrays["terminated"].astype(bool),
        truncated=arrays["truncated"].astype(bool),
        succeeded=arrays["succeeded"].astype(bool),
        seed=layout.seed_of(arrays["episode"]),
        valid=np.ones(rows, dtype=bool),
    )
    # Of rows that are wrong, numbers may be anything.
    with np.errstate(all="ignore"):
        wrong = _wrong(recorded, spec, rounding)
    if wrong and invalid == "refuse":
        first = min(wrong, key=lambda w: w.row)
        others = int(np.logical_or.reduce([w.rows for w in wrong]).sum()) - 1
        more = f" ({others} more rows are wrong in some way)" if others else ""
        raise FileProblem(f"{path}: row {first.row}: {first.text}{more}")
    for each in wrong:
        recorded = replace(recorded, valid=recorded.valid & ~each.masked)
    ends = last_rows(recorded.episode)
    truncated = recorded.truncated | (ends & ~recorded.terminated)
    masked = [f"{path}: row {w.row}: {w.text} ({int(w.rows.sum())} such)" for w in wrong]
    recorded = replace(recorded, truncated=truncated)
    with np.errstate(all="ignore"):
        odd = doubts(recorded, spec)
    return Loaded(recorded, masked, [f"{path}: {line}" for line in odd])


def joined(parts: Sequence[Recorded]) -> Recorded:
    """Several files as one; their episodes get new numbers where they would be the same."""
    renumbered, offset = [], 0
    for part in parts:
        _, numbers = np.unique(part.episode, return_inverse=True)
        renumbered.append(replace(part, episode=numbers + offset))
        offset += int(numbers.max()) + 1
    return Recorded(
        **{
            f.name: np.concatenate([getattr(part, f.name) for part in renumbered])
            for f in fields(Recorded)
        }
    )


def _arrays(path: Path) -> dict[str, np.ndarray]:
    """All arrays of the file, each what it is taken for."""
    wanted = (*_NUMBERS, "episode", *_FLAGS, "meta")
    try:
        # Opened here, since numpy leaves open what is only half a file.
        with path.open("rb") as opened:
            file = np.load(opened, allow_pickle=False)
            if not isinstance(file, np.lib.npyio.NpzFile):
                raise FileProblem(f"{path}: expected an .npz file of several arrays")
            lacking = [name for name in wanted if name not in file.files]
            if lacking:
                raise FileProblem(f"{path}: lacks {', '.join(lacking)}")
            arrays = {name: file[name] for name in wanted}
            if "succeeded" in file.files:
                arrays["succeeded"] = file["succeeded"]
    except FileProblem:
        raise
    except FileNotFoundError as error:
        raise FileProblem(f"{path}: no such file") from error
    except Exception as error:
        # Zip, zlib, the headers' parser and numpy each raise their own about a broken file.
        why = " ".join(str(error).split()) or type(error).__name__
        raise FileProblem(f"{path}: cannot be read as an .npz file of arrays ({why})") from error
    if "succeeded" not in arrays:
        arrays["succeeded"] = np.zeros(arrays["terminated"].shape, dtype=bool)
    for name, array in arrays.items():
        if not isinstance(array, np.ndarray):
            raise FileProblem(f"{path}: {name} is no array in NumPy's format")
        kinds = "U" if name == "meta" else "fiu" if name in _NUMBERS else "iu"
        kinds += "b" if name in (*_FLAGS, "succeeded") else ""
        if array.dtype.kind not in kinds:
            kind = {"U": "text", "fiu": "numbers", "iu": "integers", "iub": "true and false"}[kinds]
            raise FileProblem(f"{path}: {name} holds {array.dtype}, expected {kind}")
    return arrays


def _check_shapes(path: Path, arrays: Mapping[str, np.ndarray], sizes: Mapping[str, int]) -> None:
    rows = arrays["state"].shape[0] if arrays["state"].ndim else 0
    if rows == 0:
        raise FileProblem(f"{path}: holds no transitions")
    n, m = sizes["state"], sizes["action"]
    for name, array in arrays.items():
        wanted = {"state": (rows, n), "next_state": (rows, n), "action": (rows, m)}.get(
            name, (rows,)
        )
        if array.shape != wanted:
            raise FileProblem(f"{path}: {name} has shape {array.shape}, expected {wanted}")


def _check_flags(path: Path, arrays: Mapping[str, np.ndarray]) -> None:
    for name in (*_FLAGS, "succeeded"):
        other = np.flatnonzero((arrays[name] != 0) & (arrays[name] != 1))
        if len(other):
            row = int(other[0])
            raise FileProblem(
                f"{path}: row {row}: {name} is {arrays[name][row]}, expected true and false, or 1"
                " and 0"
            )


class _Wrong(NamedTuple):
    """rows ``[N]``: what is wrong; masked ``[N]``: what is not to be learned from; row, text: the
    first."""

    rows: np.ndarray
    masked: np.ndarray
    row: int
    text: str


def _wrong(recorded: Recorded, spec: Spec, rounding: float) -> list[_Wrong]:
    """Everything that is wrong with single rows."""
    found: list[_Wrong] = []

    def note(rows: np.ndarray, text: Any, masked: np.ndarray | None = None) -> None:
        if rows.any():
            row = int(np.flatnonzero(rows)[0])
            found.append(_Wrong(rows, rows if masked is None else masked, row, text(row)))

    names = {"state": spec.state, "next_state": spec.state, "action": spec.action}
    sound = np.ones(len(recorded), dtype=bool)
    for kind, quantities in names.items():
        array = getattr(recorded, kind)
        for column, quantity in enumerate(quantities):
            bad = ~np.isfinite(array[:, column])
            sound &= ~bad

            def text(row: int, kind: str = kind, column: int = column, q: Quantity = quantity):
                value = getattr(recorded, kind)[row, column]
                return f"{kind} {q.name} is {value}, expected a finite number"

            note(bad, text)
    dt = recorded.dt
    note(
        ~(np.isfinite(dt) & (dt > 0)),
        lambda row: f"dt is {dt[row]}, expected a finite number > 0 (s)",
    )
    _note_bounds(recorded, spec, rounding, note)
    _note_episodes(recorded, spec, rounding, sound, note)
    _note_contradictions(recorded, spec, rounding, found, note)
    return found


def _note_contradictions(
    recorded: Recorded, spec: Spec, rounding: float, wrong: Sequence[_Wrong], note: Any
) -> None:
    """Rows that contradict the others or the domain, of those that nothing is wrong with so far."""
    dt = recorded.dt
    note(
        off_the_clock(recorded, spec),
        lambda row: (
            f"dt is {dt[row]:g}, expected less than {FACTOR:g} times more or less than the domain's"
            f" {spec.dt:g} (s)"
        ),
    )
    sound = ~np.logical_or.reduce([np.zeros(len(dt), dtype=bool), *(w.masked for w in wrong)])
    found = beyond_limits(recorded, spec) & sound[:, None]
    rows = found.any(-1)
    if rows.sum() > FEW * len(rows):

        def text(row: int) -> str:
            column = int(found[row].argmax())
            q = spec.state[column]
            values = (recorded.state[row, column], recorded.next_state[row, column])
            limit = f"within {q.limit:g}" if q.limit < math.inf else f"{q.low:g} to {q.high:g}"
            return (
                f"state {q.name} goes from {values[0]:g} to {values[1]:g} {q.unit}, expected"
                f" {limit} where an episode does not end; so {int(rows.sum())} of {len(rows)} rows:"
                f" expected the domain's units and limits"
            )

        note(rows, text)
    note(
        foreign_ends(recorded, spec, rounding, sound),
        lambda row: (
            f"the last next_state of episode {recorded.episode[row]} is the first state of another"
            " episode, and does not follow from the state before"
        ),
    )


def _note_bounds(recorded: Recorded, spec: Spec, rounding: float, note: Any) -> None:
    if not spec.clip_action:
        return
    for column, q in enumerate(spec.action):
        given = recorded.action[:, column]
        high, low = (
            bound + sign * (rounding * q.scale + _SINGLE * abs(bound))
            for bound, sign in ((q.high, 1), (q.low, -1))
        )
        note(
            (given > high) | (given < low),
            lambda row, given=given, q=q: (
                "action {} is {}, expected the action as applied, within {} to {}".format(
                    q.name, *told_apart(float(given[row]), q.low, q.high)
                )
            ),
        )


def _note_episodes(
    recorded: Recorded, spec: Spec, rounding: float, sound: np.ndarray, note: Any
) -> None:
    """Whether the rows of an episode follow one another, to its end."""
    episode = recorded.episode
    first, last = first_rows(episode), last_rows(episode)
    piece = np.cumsum(first) - 1
    # Each number's first piece is the episode; the others were put between other episodes.
    starts = np.flatnonzero(first)
    _, places = np.unique(episode[starts], return_index=True)
    whole = np.zeros(len(starts), dtype=bool)
    whole[places] = True
    scattered = ~whole[piece]
    note(
        scattered & first,
        lambda row: f"episode {episode[row]} goes on after another one, expected its rows together",
        scattered,
    )
    over = recorded.terminated | recorded.truncated
    before = np.cumsum(over) - over
    late = (before - before[starts][piece]) > 0
    note(
        late,
        lambda row: f"episode {episode[row]} goes on after its end (terminated or truncated)",
    )
    note(
        last & ~over,
        lambda row: (
            f"episode {episode[row]} has no end at its last row: expected terminated or truncated"
        ),
        np.zeros(len(episode), dtype=bool),
    )
    note(
        recorded.succeeded & ~recorded.terminated,
        lambda row: f"episode {episode[row]} succeeded here, but is not terminated",
        np.zeros(len(episode), dtype=bool),
    )
    inner = np.flatnonzero(~last & ~over & sound & np.append(sound[1:], False))
    gap = np.abs(shorter_way(recorded.next_state[inner] - recorded.state[inner + 1], periods(spec)))
    scale = np.array([q.scale for q in spec.state])
    allowed = rounding * (scale + np.abs(recorded.state[inner + 1]))
    broken = np.zeros(len(episode), dtype=bool)
    broken[inner] = (gap > allowed).any(-1)

    def text(row: int) -> str:
        place = int(np.searchsorted(inner, row))
        column = int((gap[place] > allowed[place]).argmax())
        ends, follows = told_apart(
            float(recorded.next_state[row, column]), float(recorded.state[row + 1, column])
        )
        return (
            f"next_state {spec.state[column].name} is {ends}, but the next row of the episode"
            f" begins with {follows}"
        )

    # Which of the two is wrong is not known.
    note(broken, text, broken | np.append(False, broken[:-1]))
