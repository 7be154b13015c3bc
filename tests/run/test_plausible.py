"""Recorded data that contradict themselves or their domain are found, and no others."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edtorch.run.files import FileProblem
from edtorch.run.recorded import Recorded
from edtorch.run.scaled_sim import World
from edtorch.run.transitions_file import load_transitions, save_transitions
from sims.base import Spec
from sims.bicycle import Bicycle
from sims.linear import LinearSystem
from tests.recorded import linear_arrays, lived
from tests.systems import bicycle_learner

SPEC = LinearSystem([[1, 0.02], [0, 1]], [[0], [0.06]], dt=0.01, time_limit=1.0).spec


@pytest.fixture(scope="module")
def falls() -> tuple[Spec, Recorded]:
    """Bicycles under random controllers, 24 s in all."""
    world = World(Bicycle())
    learner = replace(bicycle_learner(world), exploration=1.0)
    _, data = lived(world, learner, list(range(8)), 3.0)
    return world.spec, data


def _refused(path: Path, arrays: dict[str, Any], spec: Spec = SPEC) -> tuple[str, list[int]]:
    """The one line, and the rows that are masked instead."""
    np.savez(path, **arrays)
    with pytest.raises(FileProblem) as refused:
        load_transitions(path, spec)
    recorded = load_transitions(path, spec, "mask").recorded
    return str(refused.value), np.flatnonzero(~recorded.valid).tolist()


def _doubts(path: Path, arrays: dict[str, Any], spec: Spec = SPEC) -> list[str]:
    np.savez(path, **arrays)
    found = load_transitions(path, spec)
    assert found.recorded.valid.all()
    return found.doubts


def _shifted(arrays: dict[str, Any]) -> dict[str, Any]:
    """As flat arrays of observations give it: next_state is the next row's state, come what may."""
    return arrays | {"next_state": np.roll(arrays["state"], -1, axis=0)}


@pytest.mark.parametrize("noise", [0.0, 0.01])
def test_a_last_state_of_the_next_episode_is_found(tmp_path: Path, noise: float) -> None:
    arrays = linear_arrays()
    generator = np.random.default_rng(1)
    arrays["state"] = arrays["state"] + noise * generator.normal(size=(40, 2))
    line, masked = _refused(tmp_path / "d4rl.npz", _shifted(arrays))
    assert masked == list(range(3, 40, 4))
    assert "row 3: the last next_state of episode 0 is the first state of another episode" in line
    assert "(9 more rows are wrong" in line


def test_it_is_found_under_noise_in_every_episode(tmp_path: Path) -> None:
    """Half of the jumps are no larger than what the noise does."""
    generator = np.random.default_rng(3)
    arrays = linear_arrays(60, 20)
    noisy = arrays["state"] + 0.3 * generator.normal(size=(1200, 2))
    arrays["state"] = noisy
    _, masked = _refused(tmp_path / "noisy.npz", _shifted(arrays))
    assert masked == list(range(19, 1200, 20))


def test_it_is_found_in_a_part_of_the_file_and_on_a_nonlinear_system(
    tmp_path: Path, falls: tuple[Spec, Recorded]
) -> None:
    arrays = linear_arrays(20, 10)
    wrong = np.arange(9, 60, 10)
    arrays["next_state"][wrong] = arrays["state"][wrong + 1]
    assert _refused(tmp_path / "part.npz", arrays)[1] == wrong.tolist()

    spec, data = falls
    ends = np.append(np.diff(data.episode) != 0, True)
    assert ends.sum() > 20
    path = tmp_path / "falls.npz"
    save_transitions(path, replace(data, next_state=np.roll(data.state, -1, axis=0)), spec)
    masked = ~load_transitions(path, spec, "mask").recorded.valid
    assert not (masked & ~ends).any() and masked.sum() > 0.9 * ends.sum()
    with pytest.raises(FileProblem, match="the last next_state of episode"):
        load_transitions(path, spec)


@pytest.mark.parametrize("noise", [0.0, 1e-3])
@pytest.mark.parametrize("kind", ["normal", "impacts"])
def test_a_continuous_log_cut_into_windows_is_well(tmp_path: Path, noise: float, kind: str) -> None:
    """Each last next_state is the next window's first state, as it has to be; heavy tails too."""
    arrays = linear_arrays(1, 2000)
    generator = np.random.default_rng(2)
    disturbed = noise * generator.normal(size=(2000, 2))
    if kind == "impacts":
        disturbed[::97, 1] += 0.5
    states = np.cumsum(np.concatenate([np.zeros((1, 2)), disturbed]), axis=0)
    arrays["state"] = arrays["state"] + states[:-1]
    arrays["next_state"] = np.concatenate(
        [arrays["state"][1:], arrays["next_state"][-1:] + states[-1:]]
    )
    arrays["episode"] = np.arange(2000) // 20
    arrays["truncated"] = np.arange(2000) % 20 == 19
    np.savez(tmp_path / "windows.npz", **arrays)
    found = load_transitions(tmp_path / "windows.npz", SPEC)
    assert found.recorded.valid.all()


@pytest.mark.parametrize("factor", [1000.0, 10.0, 0.1, 1e-7])
def test_a_time_step_in_another_unit_is_refused(tmp_path: Path, factor: float) -> None:
    line, masked = _refused(tmp_path / "ms.npz", linear_arrays(dt=0.01 * factor))
    assert masked == list(range(40))
    assert f"row 0: dt is {0.01 * factor:g}, expected less than 10 times" in line
    one = np.where(np.arange(40) == 7, 0.01 * factor, 0.01)
    assert _refused(tmp_path / "one.npz", linear_arrays(dt=one))[1] == [7]
    np.savez(tmp_path / "near.npz", **linear_arrays(dt=np.linspace(0.0011, 0.099, 40)))
    assert load_transitions(tmp_path / "near.npz", SPEC).recorded.valid.all()


def test_degrees_for_radians_are_refused(tmp_path: Path, falls: tuple[Spec, Recorded]) -> None:
    """Falls of the bicycle, whose episodes end at 12 degrees of lean."""
    spec, data = falls
    path = tmp_path / "falls.npz"
    save_transitions(path, data, spec)
    found = load_transitions(path, spec)
    assert found.recorded.valid.all() and found.doubts == []
    turned = replace(data, state=np.rad2deg(data.state), next_state=np.rad2deg(data.next_state))
    save_transitions(path, turned, spec)
    with pytest.raises(FileProblem) as refused:
        load_transitions(path, spec)
    assert "state lean goes from" in str(refused.value)
    assert f"of {len(data)} rows: expected the domain's units and limits" in str(refused.value)
    masked = ~load_transitions(path, spec, "mask").recorded.valid
    limit = spec.state[0].limit
    assert (masked >= (np.abs(turned.state[:, 0]) > limit * 1.01)).all()


def test_a_few_states_beyond_the_limits_are_told(
    tmp_path: Path, falls: tuple[Spec, Recorded]
) -> None:
    spec, data = falls
    path = tmp_path / "falls.npz"
    state, next_state = data.state.copy(), data.next_state.copy()
    row = int(np.flatnonzero(data.episode == 1)[3])
    state[row, 0] = next_state[row - 1, 0] = 0.3
    save_transitions(path, replace(data, state=state, next_state=next_state), spec)
    found = load_transitions(path, spec)
    assert found.recorded.valid.all()
    assert any("lean is beyond the domain's limits in 2 rows" in line for line in found.doubts)


def _spike(arrays: dict[str, Any]) -> None:
    arrays["state"][50, 1] = arrays["next_state"][49, 1] = 40.0


def _turn(arrays: dict[str, Any]) -> None:
    for name, rows in (("state", slice(51, 100)), ("next_state", slice(50, 100))):
        arrays[name][rows, 0] -= 2 * np.pi


def _constant(arrays: dict[str, Any]) -> None:
    arrays["state"][:, 0] = arrays["next_state"][:, 0] = 3.0


def _idle(arrays: dict[str, Any]) -> None:
    arrays["action"][:] = 0.0


DOUBTS = [
    (_spike, r"state state_1 has 1 spike, the first in row 50: 40, where the others are from"),
    (
        _turn,
        r"state state_0 jumps by a whole turn \(2 pi\) in 1 row, the first row 50: from .*wraps",
    ),
    (_constant, r"state state_0 is 3 in all of 200 rows"),
    (_idle, r"every action is 0 in all of 200 rows: nothing can be learned of what actions do"),
]


@pytest.mark.parametrize(("spoil", "wanted"), DOUBTS)
def test_oddities_are_told_with_numbers(
    tmp_path: Path, spoil: Callable[[dict[str, Any]], None], wanted: str
) -> None:
    arrays = linear_arrays(2, 100)
    assert _doubts(tmp_path / "well.npz", arrays) == []
    spoil(arrays)
    (line,) = _doubts(tmp_path / "odd.npz", arrays)
    assert re.search(rf"odd\.npz: {wanted}", line), line


def test_quantised_sensors_are_well(tmp_path: Path) -> None:
    """Steps of a counter, there and back, are no spikes."""
    arrays = linear_arrays(2, 100)
    for name in ("state", "next_state"):
        arrays[name] = np.round(arrays[name], 1)
    assert _doubts(tmp_path / "steps.npz", arrays) == []
