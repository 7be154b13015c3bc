"""A thousand generated mutations of a file of recorded transitions.

Each is learned from with the right result, or refused in one line; where it changes what the data
say, that is said.  The system has no noise, so that any of its rows give the same weights: those of
the file as it was are the oracle, also for what is left of a file whose rows are masked.
"""

from __future__ import annotations

import io
import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
import torch
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from edtorch.model.fit import RecursiveLeastSquares
from edtorch.policy.steps import PlainStep
from edtorch.run.files import FileProblem
from edtorch.run.offline import Lessons, Offline
from edtorch.run.recorded import Recorded
from edtorch.run.scaled_sim import World
from edtorch.run.transitions_file import Loaded, load_transitions
from sims.linear import LinearSystem
from tests.recorded import derivative_learner, linear_arrays

pytestmark = pytest.mark.oracle

WORLD = World(LinearSystem([[1, 0.02], [0, 1]], [[0], [0.06]], dt=0.01, time_limit=1.0))
EPISODES, ROWS = 6, 5
SIZE = EPISODES * ROWS
WEIGHT = torch.tensor([[0.0, 2.0, 0.0], [0.0, 0.0, 6.0]], dtype=torch.float64)
"""ds/dt = W (s, a)."""
BASE = linear_arrays(EPISODES, ROWS)
NUMBERS = ("state", "action", "next_state", "dt")
ROWWISE = (*NUMBERS, "episode", "terminated", "truncated")

Arrays = dict[str, Any]


class Mutation(NamedTuple):
    """What is done to the arrays, and what may come of it: ``same``: the same result; ``said``:
    refused, or learned from with a warning; ``refused``."""

    name: str
    change: Callable[[Arrays, Any], object]
    outcome: str


def _weight(recorded: Recorded) -> torch.Tensor:
    contents = tuple(
        np.ascontiguousarray(getattr(recorded, name)).tobytes() for name in (*NUMBERS, "valid")
    )
    return _learned(contents, len(recorded))


@cache
def _learned(contents: tuple[bytes, ...], size: int) -> torch.Tensor:
    """What is learned from all valid rows; kept, for most mutations leave the numbers alone."""
    state, action, next_state, dt = (
        np.frombuffer(part).reshape(size, -1).copy() for part in contents[:4]
    )
    rows = np.arange(size)
    none = np.zeros(size, dtype=bool)
    recorded = Recorded(
        state=state,
        action=action,
        next_state=next_state,
        dt=dt[:, 0],
        episode=rows,
        terminated=none,
        truncated=~none,
        succeeded=none,
        seed=np.full(size, -1),
        valid=np.frombuffer(contents[4], dtype=bool),
    )
    learner = derivative_learner(RecursiveLeastSquares(1e10), None, PlainStep(0.0))
    offline = Offline(learner, WORLD, recorded, [0], Lessons("all"), None)
    offline.advance(size)
    return offline.learners.model["weight"][0]


def _loaded(path: Path, content: bytes, invalid: Any = "refuse") -> Loaded | None:
    """None where it is refused, in one line that names the file."""
    path.write_bytes(content)
    try:
        return load_transitions(path, WORLD.spec, invalid)
    except FileProblem as problem:
        line = str(problem)
        assert str(path) in line and len(line.splitlines()) == 1, line
        return None


def _packed(arrays: Arrays) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def _right(weight: torch.Tensor, tolerance: float = 1e-5) -> bool:
    return bool(torch.allclose(weight, WEIGHT, rtol=0, atol=tolerance))


# What leaves the meaning as it is.


def _columns(arrays: Arrays, draw: Any) -> None:
    meta = json.loads(arrays["meta"])
    meta["state"].reverse()
    for name in ("state", "next_state"):
        arrays[name] = arrays[name][:, ::-1]
    arrays["meta"] = json.dumps(meta)


def _episodes(arrays: Arrays, draw: Any) -> None:
    order = draw(st.permutations(range(EPISODES)))
    rows = np.concatenate([np.arange(k * ROWS, (k + 1) * ROWS) for k in order])
    for name in ROWWISE:
        arrays[name] = arrays[name][rows]


def _renumbered(arrays: Arrays, draw: Any) -> None:
    numbers = draw(
        st.lists(
            st.integers(-(2**63), 2**63 - 1), min_size=EPISODES, max_size=EPISODES, unique=True
        )
    )
    arrays["episode"] = np.array(numbers)[arrays["episode"]]


def _stored(arrays: Arrays, draw: Any) -> None:
    kind = draw(st.sampled_from([">f8", "<f8", "F", "g"]))
    for name in NUMBERS:
        array = arrays[name]
        arrays[name] = np.asfortranarray(array) if kind == "F" else array.astype(kind)


def _flags(arrays: Arrays, draw: Any) -> None:
    kind = draw(st.sampled_from(["i1", "u1", "i8", ">i4"]))
    for name in ("terminated", "truncated"):
        arrays[name] = arrays[name].astype(kind)


def _small_integers(arrays: Arrays, draw: Any) -> None:
    arrays["episode"] = arrays["episode"].astype(draw(st.sampled_from(["i1", "u2", "u8", ">i4"])))


def _more(arrays: Arrays, draw: Any) -> None:
    arrays["observations"] = np.zeros(draw(st.integers(0, 9)))
    arrays["succeeded"] = np.zeros(SIZE, dtype=bool)


def _windows(arrays: Arrays, draw: Any) -> None:
    """An episode cut in two, as somebody cuts a log."""
    cut = draw(st.integers(0, SIZE - 2).filter(lambda k: k % ROWS != ROWS - 1))
    arrays["truncated"][cut] = True
    after = (np.arange(SIZE) > cut) & (arrays["episode"] == arrays["episode"][cut])
    arrays["episode"] = np.where(after, 99, arrays["episode"])


def _copies(arrays: Arrays, draw: Any) -> None:
    times = draw(st.integers(2, 3))
    for name in ROWWISE:
        arrays[name] = np.concatenate([arrays[name]] * times)
    arrays["episode"] = np.arange(SIZE * times) // ROWS


def _fewer(arrays: Arrays, draw: Any) -> None:
    keep = draw(st.sets(st.integers(0, EPISODES - 1), min_size=3))
    rows = np.isin(arrays["episode"], list(keep))
    for name in ROWWISE:
        arrays[name] = arrays[name][rows]


def _clocks(arrays: Arrays, draw: Any) -> None:
    """Other time steps, the states moving accordingly."""
    factor = draw(st.floats(0.2, 5.0))
    arrays["dt"] = arrays["dt"] * factor
    given = np.concatenate([arrays["state"], arrays["action"]], axis=1)
    moved = factor * 0.01 * given @ WEIGHT.numpy().T
    for start in range(0, SIZE, ROWS):
        state = arrays["state"][start]
        for row in range(start, start + ROWS):
            arrays["state"][row] = state
            moved = np.concatenate([state, arrays["action"][row]]) @ WEIGHT.numpy().T
            state = arrays["next_state"][row] = state + arrays["dt"][row] * moved


# What contradicts itself.


def _no_number(arrays: Arrays, draw: Any) -> None:
    array = arrays[draw(st.sampled_from(NUMBERS))]
    array.flat[draw(st.integers(0, array.size - 1))] = draw(
        st.sampled_from([np.nan, np.inf, -np.inf])
    )


def _foreign(arrays: Arrays, draw: Any) -> None:
    arrays["next_state"] = np.roll(arrays["state"], -1, axis=0)


def _time(arrays: Arrays, draw: Any) -> None:
    factor = draw(st.sampled_from([1e-9, 1e-3, 0.09, 11.0, 1000.0, -1.0, 0.0]))
    rows = draw(st.sampled_from([slice(None), slice(3, 4), slice(10, None)]))
    arrays["dt"][rows] *= factor


def _gap(arrays: Arrays, draw: Any) -> None:
    row = draw(st.integers(0, SIZE - 1).filter(lambda k: k % ROWS != ROWS - 1))
    arrays["next_state"][row, draw(st.integers(0, 1))] += draw(st.sampled_from([-1, 1e-9, 1e300]))


def _ends(arrays: Arrays, draw: Any) -> None:
    row = draw(st.integers(0, SIZE - 1))
    which = draw(st.sampled_from(["terminated", "truncated"]))
    arrays[which][row] = not (arrays["terminated"] | arrays["truncated"])[row]
    if row % ROWS == ROWS - 1:
        arrays["terminated"][row] = arrays["truncated"][row] = False


def _scattered(arrays: Arrays, draw: Any) -> None:
    row = draw(st.integers(ROWS, SIZE - 1))
    arrays["episode"][row] = (arrays["episode"][row] + draw(st.integers(1, 3))) % EPISODES


def _shapes(arrays: Arrays, draw: Any) -> None:
    name = draw(st.sampled_from(ROWWISE))
    change = draw(
        st.sampled_from(
            [
                lambda a: a[:-1],
                lambda a: a[None],
                lambda a: a.T if a.ndim == 2 else a[:, None],
                lambda a: a.ravel()[0],
                lambda a: a[:0],
                lambda a: np.stack([a, a], axis=-1),
            ]
        )
    )
    arrays[name] = change(arrays[name])


def _kinds(arrays: Arrays, draw: Any) -> None:
    name = draw(st.sampled_from(ROWWISE))
    kind = draw(st.sampled_from(["U8", "S8", "c16", "M8[s]", "V8"]))
    arrays[name] = np.zeros(arrays[name].shape, dtype=kind)


def _lacks(arrays: Arrays, draw: Any) -> None:
    del arrays[draw(st.sampled_from([*ROWWISE, "meta"]))]


def _flag_values(arrays: Arrays, draw: Any) -> None:
    name = draw(st.sampled_from(["terminated", "truncated"]))
    arrays[name] = arrays[name].astype(int)
    arrays[name][draw(st.integers(0, SIZE - 1))] = draw(st.sampled_from([2, -1, 255]))


# What may be, but is odd.


def _spike(arrays: Arrays, draw: Any) -> None:
    row, column = draw(st.integers(0, SIZE - 1)), draw(st.integers(0, 1))
    value = draw(st.sampled_from([1e4, -1e6, 1e12]))
    which = draw(st.sampled_from(["state", "next_state", "action"]))
    if which == "action":
        arrays["action"][row] = value
    elif which == "state":
        arrays["state"][row, column] = value
        if row % ROWS:
            arrays["next_state"][row - 1, column] = value
    else:
        arrays["next_state"][row, column] = value
        if row % ROWS != ROWS - 1:
            arrays["state"][row + 1, column] = value


def _idle(arrays: Arrays, draw: Any) -> None:
    which = draw(st.sampled_from(["action", "state"]))
    if which == "action":
        arrays["action"][:] = draw(st.sampled_from([0.0, 0.5]))
    else:
        column = draw(st.integers(0, 1))
        arrays["state"][:, column] = arrays["next_state"][:, column] = draw(st.floats(-9, 9))


def _turn(arrays: Arrays, draw: Any) -> None:
    """A turn more from a row on."""
    turn, row = draw(st.sampled_from([2 * np.pi, -360.0])), draw(st.integers(0, SIZE - 1))
    column, rows = draw(st.integers(0, 1)), np.arange(SIZE)
    rest = arrays["episode"] == arrays["episode"][row]
    arrays["next_state"][rest & (rows >= row), column] += turn
    arrays["state"][rest & (rows > row), column] += turn


MUTATIONS = [
    *(
        Mutation(change.__name__, change, "same")
        for change in (
            _columns,
            _episodes,
            _renumbered,
            _stored,
            _flags,
            _small_integers,
            _more,
            _windows,
            _copies,
            _fewer,
            _clocks,
        )
    ),
    *(
        Mutation(change.__name__, change, "refused")
        for change in (
            _no_number,
            _foreign,
            _time,
            _gap,
            _ends,
            _scattered,
            _shapes,
            _kinds,
            _lacks,
            _flag_values,
        )
    ),
    *(Mutation(change.__name__, change, "said") for change in (_spike, _idle, _turn)),
]


def generated(examples: int) -> Any:
    """The same ones at every run."""
    return settings(
        max_examples=examples,
        derandomize=True,
        database=None,
        deadline=None,
        suppress_health_check=[HealthCheck.too_slow],
    )


@pytest.fixture(scope="module")
def path(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("mutated") / "data.npz"


@generated(600)
@given(data=st.data())
def test_arrays(path: Path, data: st.DataObject) -> None:
    """One of them, in one or another kind of numbers."""
    first = data.draw(st.sampled_from(MUTATIONS))
    arrays = {name: np.copy(a) if name != "meta" else a for name, a in BASE.items()}
    stored = data.draw(st.sampled_from([None, _stored, _flags, _small_integers]))
    if stored is not None:
        stored(arrays, data.draw)
    first.change(arrays, data.draw)
    content = _packed(arrays)
    found = _loaded(path, content)
    if found is not None:
        assert first.outcome != "refused", first.name
        assert (found.doubts == []) == (first.outcome == "same"), found.doubts
        if first.outcome == "same":
            assert _right(_weight(found.recorded))
    else:
        assert first.outcome != "same", first.name
        masked = _loaded(path, content, "mask")
        if masked is not None and masked.recorded.valid.sum() >= 8 and not masked.doubts:
            assert masked.masked and _right(_weight(masked.recorded))


VALUES = st.recursive(
    st.none()
    | st.booleans()
    | st.integers()
    | st.sampled_from([2**63, 10**400, -1, 0, 1, 6])
    | st.floats()
    | st.text(max_size=5)
    | st.sampled_from(["state_0", "state_1", "action_0", "s0", "scaled", "physical", "linear"]),
    lambda inner: (
        st.lists(inner, max_size=3)
        | st.dictionaries(
            st.sampled_from(["name", "unit", "scale", "period", "seed", "episodes"]), inner
        )
    ),
    max_leaves=5,
)


def _paths(node: Any, here: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    inner = (
        node.items()
        if isinstance(node, dict)
        else enumerate(node)
        if isinstance(node, list)
        else ()
    )
    return [*([here] if here else []), *(p for k, v in inner for p in _paths(v, (*here, k)))]


@generated(250)
@given(data=st.data())
def test_meta(path: Path, data: st.DataObject) -> None:
    """Any value anywhere: what is accepted has not changed what the numbers mean."""
    meta = json.loads(BASE["meta"])
    meta["seeds"] = [{"seed": 0, "episodes": [0, 3]}, {"seed": 1, "episodes": [3, 6]}]
    for each in (*meta["state"], *meta["action"]):
        each |= {"unit": "1", "scale": 1.0, "period": 0.0}
    *parents, key = data.draw(st.sampled_from(_paths(meta)))
    node = meta
    for parent in parents:
        node = node[parent]
    if data.draw(st.booleans()) and isinstance(node, dict):
        del node[key]
    else:
        node[key] = data.draw(VALUES)
    found = _loaded(path, _packed(BASE | {"meta": json.dumps(meta)}))
    if found is not None:
        assert _right(_weight(found.recorded)) and found.doubts == []
        assert found.recorded.seed.min() >= -1


@generated(150)
@given(data=st.data())
def test_bytes(path: Path, data: st.DataObject) -> None:
    """A few bytes changed, or the file cut short."""
    content = bytearray(_packed(BASE))
    if data.draw(st.booleans()):
        del content[data.draw(st.integers(0, len(content))) :]
    else:
        for place in data.draw(st.lists(st.integers(0, len(content) - 1), min_size=1, max_size=4)):
            content[place] = data.draw(st.integers(0, 255))
    found = _loaded(path, bytes(content))
    if found is not None:
        assert _right(_weight(found.recorded)) and found.doubts == []
