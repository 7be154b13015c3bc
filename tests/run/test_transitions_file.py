"""transitions.npz: what is written is read, and everything that is wrong is named."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edtorch.run.files import FileProblem
from edtorch.run.recorder import Recorder
from edtorch.run.transitions_file import (
    Recorded,
    gathered,
    joined,
    load_transitions,
    save_transitions,
)
from sims.bicycle import Bicycle
from tests.recorded import linear_learner, linear_world, lived

WORLD = linear_world()
_, DATA = lived(WORLD, linear_learner(), [7, 9], 20.0)
"""Two learners, three episodes each: of 8, 8 and 4 steps."""


def same(a: Recorded, b: Recorded) -> bool:
    return all(np.array_equal(getattr(a, n), getattr(b, n)) for n in a.__dataclass_fields__)


def test_what_is_written_is_read_to_the_last_digit(tmp_path: Path) -> None:
    path = tmp_path / "transitions.npz"
    save_transitions(path, DATA, WORLD.spec, {"command": "x"})
    found = load_transitions(path, WORLD.spec)
    assert same(found.recorded, DATA) and found.masked == []
    assert np.unique(DATA.episode).tolist() == list(range(6))
    assert DATA.seed.tolist() == [7] * 20 + [9] * 20
    assert np.flatnonzero(DATA.truncated).tolist() == [7, 15, 19, 27, 35, 39]
    assert not DATA.terminated.any()
    with np.load(path) as file:
        meta = json.loads(str(file["meta"]))
    assert meta["seeds"] == [{"seed": 7, "episodes": [0, 3]}, {"seed": 9, "episodes": [3, 6]}]
    assert (meta["format"], meta["units"], meta["command"]) == (1, "physical", "x")
    assert [p.name for p in tmp_path.iterdir()] == [path.name]


def contents(path: Path, data: Recorded = DATA) -> dict[str, Any]:
    """The arrays of a good file, to be spoiled."""
    save_transitions(path, data, WORLD.spec)
    with np.load(path) as file:
        return {name: file[name].copy() for name in file.files}


def test_a_file_of_somebody_else_s(tmp_path: Path) -> None:
    """The least that the format asks for: single precision, scaled, other columns, no seeds."""
    path = tmp_path / "theirs.npz"
    spec = Bicycle().spec
    names = [q.name for q in spec.state][::-1]
    scales = {q.name: q.scale for q in (*spec.state, *spec.action)}
    meta = {
        "format": 1,
        "domain": "bicycle",
        "units": "scaled",
        "state": [{"name": n, "scale": scales[n]} for n in names],
        "action": [{"name": q.name, "scale": q.scale} for q in spec.action],
    }
    states = np.linspace(-0.5, 0.5, 4 * 5, dtype=np.float32).reshape(4, 5)
    np.savez(
        path,
        state=states[:3],
        next_state=states[1:],
        action=np.full((3, 2), 0.5, dtype=np.float32),
        dt=np.full(3, 0.02),
        episode=np.array([4, 4, 4]),
        terminated=np.array([0, 0, 1]),
        truncated=np.zeros(3, dtype=int),
        meta=json.dumps(meta),
    )
    found = load_transitions(path, spec).recorded
    scale = np.array([q.scale for q in spec.state])
    np.testing.assert_allclose(found.state, states[:3, ::-1] * scale, rtol=1e-6)
    np.testing.assert_allclose(found.action, [[1.0, 0.01]] * 3)
    assert found.seed.tolist() == [-1] * 3 and found.terminated.tolist() == [False, False, True]
    meta["state"][0]["scale"] = 1.5
    with np.load(path) as file:
        arrays: dict[str, Any] = {name: file[name] for name in file.files}
    arrays["meta"] = np.array(json.dumps(meta))
    np.savez(path, **arrays)
    with pytest.raises(FileProblem, match=r"angle_to_goal is scaled by 1\.5, expected 3\.14159"):
        load_transitions(path, spec)


def _set(name: str, place: Any, value: Any) -> Callable[[dict[str, Any]], None]:
    def spoil(arrays: dict[str, Any]) -> None:
        arrays[name][place] = value

    return spoil


def _put(name: str, value: Callable[[Any], Any]) -> Callable[[dict[str, Any]], None]:
    def spoil(arrays: dict[str, Any]) -> None:
        arrays[name] = value(arrays[name])

    return spoil


def _meta(**changes: Any) -> Callable[[dict[str, Any]], None]:
    def spoil(arrays: dict[str, Any]) -> None:
        arrays["meta"] = np.array(json.dumps(json.loads(str(arrays["meta"])) | changes))

    return spoil


def _interleave(arrays: dict[str, Any]) -> None:
    """Three rows of the first episode behind the last one."""
    order = [*range(5), *range(8, 40), 5, 6, 7]
    for name in set(arrays) - {"meta"}:
        arrays[name] = arrays[name][order]
    arrays["truncated"][4] = True


# What is spoiled, the row and what the message says, and the rows that are masked.
ROWS = [
    (
        _set("state", (3, 1), np.nan),
        3,
        r"state state_1 is nan, expected a finite number",
        [3],
    ),
    (_set("action", (5, 0), np.inf), 5, r"action action_0 is inf", [5]),
    (_set("next_state", (39, 0), -np.inf), 39, r"next_state state_0 is -inf", [39]),
    (_set("dt", 4, 0.0), 4, r"dt is 0\.0, expected a finite number > 0", [4]),
    (_set("dt", slice(4, 6), -1.0), 4, r"dt is -1\.0.*\(1 more rows are wrong", [4, 5]),
    (_set("dt", 2, np.nan), 2, r"dt is nan", [2]),
    (
        _set("next_state", (2, 0), 77.0),
        2,
        r"next_state state_0 is 77, but the next row of the episode begins with",
        [2, 3],
    ),
    (_set("truncated", 15, False), 15, r"episode 1 has no end at its last row", []),
    (_set("terminated", 12, True), 13, r"episode 1 goes on after its end", [13, 14, 15]),
    (_interleave, 37, r"episode 0 goes on after another one", [37, 38, 39]),
    (_set("succeeded", 6, True), 6, r"episode 0 succeeded here, but is not terminated", []),
]


@pytest.mark.parametrize(("spoil", "row", "wanted", "masked"), ROWS)
def test_wrong_rows_are_refused_or_masked(
    tmp_path: Path,
    spoil: Callable[[dict[str, Any]], None],
    row: int,
    wanted: str,
    masked: list[int],
) -> None:
    path = tmp_path / "bad.npz"
    arrays = contents(path)
    spoil(arrays)
    np.savez(path, **arrays)
    with pytest.raises(FileProblem, match=rf"bad\.npz: row {row}: {wanted}"):
        load_transitions(path, WORLD.spec)
    found = load_transitions(path, WORLD.spec, "mask")
    assert np.flatnonzero(~found.recorded.valid).tolist() == masked
    assert any(f"bad.npz: row {row}: " in line for line in found.masked)
    # An episode that just stops was stopped.
    ends = np.append(np.diff(found.recorded.episode) != 0, True)
    assert bool((found.recorded.terminated | found.recorded.truncated)[ends].all())


def test_actions_must_be_as_applied(tmp_path: Path) -> None:
    """The domain clips; an action beyond its bounds did not act."""
    path, spec = tmp_path / "bad.npz", Bicycle().spec
    n = len(spec.state)
    data = Recorded(
        state=np.zeros((2, n)),
        action=np.array([[2.0, 0.02], [2.5, 0.0]]),
        next_state=np.zeros((2, n)),
        dt=np.full(2, 0.01),
        episode=np.zeros(2, dtype=np.int64),
        terminated=np.array([False, True]),
        truncated=np.zeros(2, dtype=bool),
        succeeded=np.zeros(2, dtype=bool),
        seed=np.zeros(2, dtype=np.int64),
        valid=np.ones(2, dtype=bool),
    )
    save_transitions(path, data, spec)
    with pytest.raises(FileProblem, match=r"row 1: action handlebar_torque is 2\.5, .*-2 to 2"):
        load_transitions(path, spec)
    assert load_transitions(path, spec, "mask").recorded.valid.tolist() == [True, False]


def test_actions_clipped_in_another_precision_are_within_their_bounds(tmp_path: Path) -> None:
    """0.7 in float64 is above 0.7 in float32; what is farther out is printed to differ from it."""
    path, single = tmp_path / "clipped.npz", float(np.float32(0.7))
    spec = WORLD.spec
    bounded = replace(spec.action[0], low=-single, high=single)
    spec = replace(spec, action=(bounded,), clip_action=True)
    data = replace(DATA, action=np.clip(DATA.action, -0.7, 0.7))
    assert data.action.max() > single
    save_transitions(path, data, spec)
    assert same(load_transitions(path, spec).recorded, data)
    beyond = replace(data, action=np.where(data.action < 0.7, data.action, single * (1 + 4e-7)))
    save_transitions(path, beyond, spec)
    with pytest.raises(
        FileProblem, match=r"action_0 is 0\.700000268, expected .* -0\.699999988 to 0\.699999988"
    ):
        load_transitions(path, spec)


def test_angles_may_be_wrapped_between_rows(tmp_path: Path) -> None:
    """An episode may count its angle on, or wrap it: it is the same angle."""
    path, spec = tmp_path / "angle.npz", Bicycle().spec
    state = np.zeros((2, len(spec.state)))
    after = state.copy()
    after[0, -1], state[1, -1] = np.pi + 0.1, 0.1 - np.pi
    data = Recorded(
        state=state,
        action=np.zeros((2, 2)),
        next_state=after,
        dt=np.full(2, 0.01),
        episode=np.zeros(2, dtype=np.int64),
        terminated=np.array([False, True]),
        truncated=np.zeros(2, dtype=bool),
        succeeded=np.zeros(2, dtype=bool),
        seed=np.zeros(2, dtype=np.int64),
        valid=np.ones(2, dtype=bool),
    )
    save_transitions(path, data, spec)
    assert load_transitions(path, spec).masked == []


FILES = [
    (_put("state", lambda a: a[:, :1]), r"state has shape \(40, 1\), expected \(40, 2\)"),
    (_put("action", lambda a: a[:39]), r"action has shape \(39, 1\), expected \(40, 1\)"),
    (_put("dt", lambda a: a[0]), r"dt has shape \(\), expected \(40,\)"),
    (_put("episode", lambda a: a + 0.5), r"episode holds float64, expected integers"),
    (_put("truncated", lambda a: a * 1.0), r"truncated holds float64, expected true and false"),
    (_put("state", lambda a: a.astype(str)), r"state holds <U\d+, expected numbers"),
    (_put("state", lambda a: a[:0]), r"holds no transitions"),
    (lambda arrays: arrays.pop("dt"), r"lacks dt"),
    (_put("meta", lambda a: np.array("{")), r"meta is not JSON"),
    (_put("meta", lambda a: np.array("[1]")), r"meta: expected a JSON object"),
    (_meta(format=2), r"meta\.format=2: expected 1"),
    (_meta(domain="bicycle"), r"meta\.domain=bicycle: expected linear"),
    (_meta(units="furlongs"), r"meta\.units=furlongs: expected physical or scaled"),
    (
        _meta(state=[{"name": "state_0"}, {"name": "x"}]),
        r"'x' is none of the domain's state_0, state_1",
    ),
    (
        _meta(state=[{"name": "state_0"}]),
        r"\['state_0'\], expected each of \['state_0', 'state_1'\] once",
    ),
    (_meta(action=["action_0"]), r"meta\.action: expected a list of objects with a name each"),
    (_meta(action=[{"name": "action_0", "unit": "N"}]), r"action_0 has unit N, expected 1"),
    (
        _meta(state=[{"name": "state_0", "period": 6.28}, {"name": "state_1"}]),
        r"state_0 has period 6\.28, expected 0",
    ),
    (_put("succeeded", lambda a: a + 2), r"row 0: succeeded is 2, expected true and false"),
    (_put("meta", lambda a: np.array([a, a])), r"meta has shape \(2,\), expected one text"),
    (_put("meta", lambda a: np.array("[" * 100_000)), r"meta is not JSON"),
    (_put("meta", lambda a: np.array('{"format": 1, "format": 1}')), r"format is given twice"),
    (_meta(format=True), r"meta\.format=true: expected 1"),
    (_meta(domain=["linear"]), r'meta\.domain=\["linear"\]: expected linear'),
    (_meta(domain="line\nar"), r'meta\.domain="line\\nar": expected linear'),
    (_meta(units=None), r"meta\.units=null: expected physical or scaled"),
    (_meta(state=None), r"meta\.state: expected a list of objects"),
    (
        _meta(action=[{"name": "action_0", "scale": "1"}]),
        r"meta\.action\[0\]\.scale=1: expected a finite number",
    ),
    (
        _meta(action=[{"name": "action_0", "scale": 10**400}]),
        r"meta\.action\[0\]\.scale=1000.*: expected a finite number",
    ),
    (_meta(action=[{"name": "action_0", "unit": 3}]), r"action_0 has unit 3, expected 1"),
    (_meta(seeds=None), r"meta\.seeds=null: expected a list of"),
    (_meta(seeds={"seed": 1}), r"meta\.seeds=\{.*: expected a list of"),
    (_meta(seeds=[3]), r"meta\.seeds\[0\]=3: expected"),
    (_meta(seeds=[{"seed": 1}]), r"meta\.seeds\[0\]\.episodes=null: expected two integers"),
    *(
        (
            _meta(seeds=[{"seed": seed, "episodes": [0, 6]}]),
            r"meta\.seeds\[0\]\.seed=.*: expected an integer from 0",
        )
        for seed in (None, True, 1.5, "1", -1, 2**63)
    ),
    *(
        (
            _meta(seeds=[{"seed": 1, "episodes": span}]),
            r"meta\.seeds\[0\]\.episodes=.*: expected two integers",
        )
        for span in ([0], [0, 6, 7], [6, 0], [0, 2**63], ["0", "6"], {"0": 6})
    ),
    (
        _meta(seeds=[{"seed": 1, "episodes": [2, 6]}, {"seed": 2, "episodes": [0, 3]}]),
        r"meta\.seeds\[0\]\.episodes=\[2, 6\]: expected episodes that seeds\[1\], \[0, 3\], does",
    ),
]


def test_components_by_their_former_names(tmp_path: Path) -> None:
    path = tmp_path / "former.npz"
    arrays = contents(path)
    present = load_transitions(path, WORLD.spec)
    _meta(state=[{"name": "s0"}, {"name": "s1"}], action=[{"name": "a0"}])(arrays)
    np.savez(path, **arrays)
    former = load_transitions(path, WORLD.spec)
    assert former.recorded.state.tolist() == present.recorded.state.tolist()


@pytest.mark.parametrize(("spoil", "wanted"), FILES)
def test_wrong_files_are_refused_either_way(
    tmp_path: Path, spoil: Callable[[dict[str, Any]], None], wanted: str
) -> None:
    path = tmp_path / "bad.npz"
    arrays = contents(path)
    spoil(arrays)
    np.savez(path, **arrays)
    for invalid in ("refuse", "mask"):
        with pytest.raises(FileProblem, match=rf"bad\.npz: .*{wanted}"):
            load_transitions(path, WORLD.spec, invalid)


def test_no_such_file_and_no_npz(tmp_path: Path) -> None:
    path = tmp_path / "x.npz"
    with pytest.raises(FileProblem, match=r"x\.npz: no such file"):
        load_transitions(path, WORLD.spec)
    for content in (b"", b"no zip", b"PK\x03\x04 half of one"):
        path.write_bytes(content)
        with pytest.raises(FileProblem, match=r"x\.npz: cannot be read as an \.npz file"):
            load_transitions(path, WORLD.spec)
    with path.open("wb") as file:
        np.save(file, np.zeros(3))
    with pytest.raises(FileProblem, match=r"x\.npz: expected an \.npz file of several arrays"):
        load_transitions(path, WORLD.spec)
    np.savez(path, state=np.array([object()]))
    with pytest.raises(FileProblem, match=r"x\.npz: "):
        load_transitions(path, WORLD.spec)


def test_joined_files_keep_their_episodes_apart() -> None:
    both = joined([DATA, DATA])
    assert len(both) == 2 * len(DATA)
    assert len(np.unique(both.episode)) == 2 * len(np.unique(DATA.episode))
    assert np.array_equal(both.state[len(DATA) :], DATA.state)


def test_nothing_lived_is_nothing_gathered(tmp_path: Path) -> None:
    """A learner without a transition leaves none, and no number to its episodes."""
    with (tmp_path / "recording").open("w+b") as file:
        recorder = Recorder(WORLD, 2, file)
        nobody = gathered([recorder.lived(0), recorder.lived(1)], [0, 1], 1.0)
    assert len(nobody) == 0
    save_transitions(tmp_path / "nobody.npz", nobody, WORLD.spec)
    with np.load(tmp_path / "nobody.npz") as saved:
        assert saved["state"].shape == (0, 2) and json.loads(str(saved["meta"]))["seeds"] == []
