"""Data sets in Minari's and D4RL's layouts become transitions."""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from edtorch.run.files import FileProblem
from edtorch.transitions import (
    FileColumn,
    described_spec,
    load_transitions,
    read,
    save_imported,
)

CART = described_spec(
    "cart", 0.02, [FileColumn("x", "m"), FileColumn("v", "m/s")], [FileColumn("force", "N")]
)
Arrays = dict[str, Any]


def episode(rows: int, terminated: bool, seed: int) -> Arrays:
    """What Minari keeps of one."""
    generator = np.random.default_rng(seed)
    last = np.arange(rows) == rows - 1
    return {
        "observations": generator.normal(size=(rows + 1, 2)).astype(np.float32),
        "actions": generator.normal(size=(rows, 1)).astype(np.float32),
        "rewards": np.zeros(rows),
        "terminations": last & terminated,
        "truncations": last & (not terminated),
    }


def minari(folder: Path, episodes: list[Arrays], **metadata: Any) -> Path:
    """A data set as ``minari.DataCollector`` writes it."""
    (folder / "data").mkdir()
    with h5py.File(folder / "data" / "main_data.hdf5", "w") as file:
        for number, arrays in enumerate(episodes):
            group = file.create_group(f"episode_{number}")
            group.attrs["id"] = number
            for name, array in arrays.items():
                group[name] = array
    told = {"total_episodes": len(episodes), "data_format": "hdf5"} | metadata
    (folder / "data" / "metadata.json").write_text(json.dumps(told))
    return folder


def flat(episodes: list[Arrays], *, follow: bool) -> Arrays:
    """The same in D4RL's layout."""
    arrays = {
        "observations": np.concatenate([each["observations"][:-1] for each in episodes]),
        "actions": np.concatenate([each["actions"] for each in episodes]),
        "terminals": np.concatenate([each["terminations"] for each in episodes]),
        "timeouts": np.concatenate([each["truncations"] for each in episodes]),
    }
    if follow:
        following = np.concatenate([each["observations"][1:] for each in episodes])
        arrays["next_observations"] = following
    return arrays


def write(path: Path, arrays: Arrays) -> Path:
    if path.suffix == ".npz":
        np.savez(path, **arrays)
    else:
        with h5py.File(path, "w") as file:
            for name, array in arrays.items():
                file[name] = array
    return path


# More than ten, whose numbers sort otherwise as text.
EPISODES = [episode(3 + k % 3, k % 2 == 0, k) for k in range(12)]
ROWS = sum(len(each["actions"]) for each in EPISODES)


def test_minari_gives_every_step(tmp_path: Path) -> None:
    found = read(minari(tmp_path, EPISODES), CART)
    own = found.recorded
    assert (len(own), found.rows, found.dropped, found.broken) == (ROWS, ROWS, {}, 0)
    want = np.concatenate([each["observations"][1:] for each in EPISODES])
    np.testing.assert_array_equal(own.next_state, want)
    for name, flags in (("terminated", "terminations"), ("truncated", "truncations")):
        want = np.concatenate([each[flags] for each in EPISODES])
        np.testing.assert_array_equal(getattr(own, name), want)
    assert np.unique(own.episode).tolist() == list(range(12))
    assert set(own.dt) == {0.02}
    save_imported(tmp_path / "out.npz", found, CART)
    loaded = load_transitions(tmp_path / "out.npz", CART)
    np.testing.assert_array_equal(loaded.recorded.state, own.state)


@pytest.mark.parametrize("name", ["data.npz", "data.hdf5"])
def test_d4rl_with_next_observations_gives_what_minari_gives(tmp_path: Path, name: str) -> None:
    found = read(write(tmp_path / name, flat(EPISODES, follow=True)), CART).recorded
    (tmp_path / "minari").mkdir()
    other = read(minari(tmp_path / "minari", EPISODES), CART).recorded
    for field in ("state", "action", "next_state", "dt", "episode", "terminated", "truncated"):
        np.testing.assert_array_equal(getattr(found, field), getattr(other, field))


def test_d4rl_without_them_lacks_the_last_of_each_episode(tmp_path: Path) -> None:
    found = read(write(tmp_path / "data.npz", flat(EPISODES, follow=False)), CART)
    assert found.dropped == {"the end of an episode: no next observation": 12}
    assert len(found.recorded) == ROWS - 12
    want = np.concatenate([each["observations"][1:-1] for each in EPISODES])
    np.testing.assert_array_equal(found.recorded.next_state, want)
    assert not found.recorded.terminated.any()


def test_rows_in_any_order_are_episodes_of_their_own(tmp_path: Path) -> None:
    """A replay buffer: next observations that the next row does not begin with."""
    order = np.random.default_rng(0).permutation(ROWS)
    arrays = {k: v[order] for k, v in flat(EPISODES, follow=True).items()}
    found = read(write(tmp_path / "data.npz", arrays), CART)
    assert found.broken > 0 and len(found.recorded) == ROWS
    save_imported(tmp_path / "out.npz", found, CART)
    assert load_transitions(tmp_path / "out.npz", CART, "mask").recorded.state.shape == (ROWS, 2)


def test_components_by_column_and_by_key_of_a_dict(tmp_path: Path) -> None:
    episodes = [dict(each) for each in EPISODES]
    for each in episodes:
        seen = each.pop("observations")
        each["observations/pose"] = np.column_stack([np.zeros(len(seen)), 1000 * seen[:, 0]])
        each["observations/speed"] = seen[:, 1]
    path = minari(tmp_path, episodes)
    found = read(path, CART, state=["x=pose/1[mm]", "v=speed/0"]).recorded
    want = np.concatenate([each["observations"][:-1] for each in EPISODES])
    np.testing.assert_allclose(found.state, want, rtol=1e-6)
    with pytest.raises(FileProblem, match=r"observations: x has no column: expected .* pose/0"):
        read(path, CART)
    with h5py.File(path / "data" / "main_data.hdf5", "r+") as file:
        del file["episode_3/observations/speed"]
        file["episode_3/observations/speed"] = np.zeros(2)
    with pytest.raises(FileProblem, match=r"episode_3/observations: has columns of lengths"):
        read(path, CART, state=["x=pose/1[mm]", "v=speed/0"])


def _without(name: str) -> Callable[[Arrays], Any]:
    return lambda arrays: arrays.pop(name)


def _put(name: str, value: Any) -> Callable[[Arrays], Any]:
    return lambda arrays: arrays.update({name: value})


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_without("terminations"), "episode_1: lacks terminations"),
        (_put("observations", np.zeros((4, 2))), "episode_1/observations: has 4 rows, expected 5"),
        (_put("observations", np.zeros((5, 3))), "episode_1/observations: x has no column"),
        (_put("actions", np.zeros((4, 1, 1))), "episode_1/actions: has shape (4, 1, 1), expected"),
        (_put("actions", np.array(["a"] * 4, "S")), "episode_1/actions: holds |S1, expected numb"),
        (_put("truncations", np.ones(4)), "episode_1/truncations: row 0 is true, expected that"),
        (_put("truncations", np.ones(3)), "episode_1/truncations: has shape (3,), expected (4,)"),
        (_put("terminations", np.full(4, 2)), "episode_1/terminations: row 0 is 2, expected true"),
    ],
)
def test_what_is_wrong_in_minari(
    tmp_path: Path, change: Callable[[Arrays], Any], message: str
) -> None:
    episodes = [dict(each) for each in EPISODES]
    change(episodes[1])
    path = minari(tmp_path, episodes)
    with pytest.raises(FileProblem) as refused:
        read(path, CART)
    assert str(refused.value).startswith(f"{path}/data/main_data.hdf5: {message}")


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (_without("timeouts"), "lacks timeouts"),
        (_put("observations", np.zeros((9, 2))), f"observations has 9 rows, expected {ROWS}"),
        (_put("terminals", np.full(ROWS, 0.5)), "terminals: row 0 is 0.5, expected true and false"),
        (_put("actions", np.full((ROWS, 1), np.nan)), "no transition is left"),
        (_put("actions", np.zeros((ROWS, 0))), "actions: force has no column"),
        (_put("actions", np.zeros(())), "actions: has shape (), expected rows and columns"),
    ],
)
@pytest.mark.parametrize("name", ["data.npz", "data.hdf5"])
def test_what_is_wrong_in_d4rl(
    tmp_path: Path, name: str, change: Callable[[Arrays], Any], message: str
) -> None:
    arrays = flat(EPISODES, follow=False)
    change(arrays)
    path = write(tmp_path / name, arrays)
    with pytest.raises(FileProblem) as refused:
        read(path, CART)
    assert str(refused.value).startswith(f"{path}: {message}")


def test_half_a_data_set(tmp_path: Path) -> None:
    path = minari(tmp_path, EPISODES, total_episodes=20)
    with pytest.raises(FileProblem, match=r"metadata\.json: total_episodes=20: expected 12"):
        read(path, CART)
    main = path / "data" / "main_data.hdf5"
    main.write_bytes(main.read_bytes()[:5000])
    with pytest.raises(FileProblem, match=r"main_data\.hdf5: cannot be read as HDF5"):
        read(path, CART)
    (tmp_path / "data.npz").write_bytes(b"PK\x03\x04 and no more")
    with pytest.raises(FileProblem, match=r"data\.npz: cannot be read as an \.npz file"):
        read(tmp_path / "data.npz", CART)
    (tmp_path / "empty").mkdir()
    with pytest.raises(FileProblem, match=r"empty: expected a folder with main_data\.hdf5"):
        read(tmp_path / "empty", CART)


def test_without_h5py_one_line_says_what_to_install(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = minari(tmp_path, EPISODES)
    monkeypatch.setitem(sys.modules, "h5py", None)
    with pytest.raises(FileProblem, match=r"h5py to read HDF5 with: pip install 'edtorch\[data\]'"):
        read(path, CART)
    with pytest.raises(FileProblem, match="time, episode and gap are of CSV"):
        read(write(tmp_path / "data.npz", flat(EPISODES, follow=True)), CART, time="t")
