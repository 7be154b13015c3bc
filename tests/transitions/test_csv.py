"""CSV logs become transitions: units by name, time stamps, episodes, what is dropped and why."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edtorch.model.fit import Fit, RecursiveLeastSquares
from edtorch.model.fit_ridge import Ridge
from edtorch.policy.steps import PlainStep
from edtorch.run.episodes import Budget
from edtorch.run.files import FileProblem
from edtorch.run.offline import Lessons, Offline
from edtorch.run.scaled_sim import World
from edtorch.transitions import (
    FileColumn,
    described_spec,
    load_transitions,
    read,
    save_imported,
)
from sims.base import Spec
from sims.linear import LinearSystem
from tests.recorded import F, G, derivative_learner

PENDULUM = described_spec(
    "pendulum",
    0.01,
    [FileColumn("angle", "rad"), FileColumn("rate", "rad/s")],
    [FileColumn("torque", "N m")],
)
COLUMNS: dict[str, Any] = {
    "state": ["angle=theta[deg]", "rate=omega[deg/s]"],
    "action": ["torque=u[mN m]"],
    "time": "t[ms]",
}


def log(path: Path, *lines: str, header: str = "t,theta,omega,u") -> Path:
    path.write_text("\n".join((header, *lines)) + "\n")
    return path


def test_units_are_converted_and_the_next_line_is_the_next_state(tmp_path: Path) -> None:
    path = log(tmp_path / "log.csv", "0,180,90,1", "10,90,45,2", "25,0,0,3")
    found = read(path, PENDULUM, **COLUMNS)
    own = found.recorded
    np.testing.assert_allclose(own.state, np.pi * np.array([[1, 0.5], [0.5, 0.25]]), rtol=1e-15)
    np.testing.assert_allclose(own.next_state, np.pi * np.array([[0.5, 0.25], [0, 0]]), rtol=1e-15)
    np.testing.assert_allclose(own.action, [[1e-3], [2e-3]], rtol=1e-15)
    np.testing.assert_allclose(own.dt, [0.01, 0.015], rtol=1e-12)
    assert own.truncated.tolist() == [False, True]
    assert (found.rows, list(found.dropped.values())) == (3, [1])


def test_rows_are_dropped_for_a_reason_and_what_is_written_is_read(tmp_path: Path) -> None:
    """A missing cell takes both transitions that it is in; a gap one; each episode its last line.
    What is left of an episode on either side is an episode of its own."""
    lines = [f"{10 * t},1,{t},0,a" for t in range(10)] + [f"{10 * t},1,{t},0,b" for t in range(3)]
    lines[4] = "40,,4,0,a"
    lines[7:10] = [f"{10 * t + 500},1,{t},0,a" for t in range(7, 10)]
    path = log(tmp_path / "log.csv", *lines, header="t,theta,omega,u,run")
    found = read(path, PENDULUM, **COLUMNS, episode="run")
    assert sorted(found.dropped.values()) == [1, 2, 2]
    assert len(found.recorded) == 8
    assert found.recorded.episode.tolist() == [0, 0, 0, 1, 2, 2, 3, 3]
    save_imported(tmp_path / "transitions.npz", found, PENDULUM)
    loaded = load_transitions(tmp_path / "transitions.npz", PENDULUM).recorded
    np.testing.assert_array_equal(loaded.next_state, found.recorded.next_state)
    with pytest.raises(FileProblem, match=r"transitions\.npz: exists already"):
        save_imported(tmp_path / "transitions.npz", found, PENDULUM)


@pytest.mark.parametrize(
    ("lines", "changes", "message"),
    [
        (["0,1,1,1", "0,1,1,1"], {}, "line 3: time t is 0, expected more than 0"),
        (["0,1,1,1", ",1,1,1"], {}, "line 3: time t is nan, expected"),
        (["0,1,1,1", "1,x,1,1"], {}, "line 3: theta is 'x', expected a number"),
        (["0,1,1,1", "1,1,1"], {}, "line 3: 3 cells, expected 4"),
        ([], {}, "expected a header and at least one line"),
        (["0,1,1,1"], {}, "no transition is left of 1 rows"),
        (["0,1,1,1"], {"action": ["torque=tau"]}, "column 'tau' is not in the header"),
        (["0,1,1,1"], {"state": ["angle=u", "rate=u"]}, "state: rate: column 'u' is another comp"),
        (["0,1,1,1"], {"action": ["force=u"]}, "action: 'force' is no component of the domain"),
        (["0,1,1,1"], {"action": ["torque=u[furlong]"]}, "action: torque: unknown unit 'furlong'"),
        (["0,1,1,1"], {"action": ["torque=u[N]"]}, "action: torque: cannot convert 'N' to 'N m'"),
        (["0,1,1,1"], {"time": "t[m]"}, "time t: cannot convert 'm' to 's'"),
        (["0,1,1,1", "9,1_0,1,1"], {}, "line 3: theta is '1_0', expected a number"),
        (["0,1,1,1", "9,1,1,1"], {"time": "t"}, "time: the median step is 9 s, expected less than"),
        (["0,1,1,1", "9,1,1,1"], {"gap": -1.0}, "gap=-1.0: expected a number of seconds > 0"),
        (["0,1,1,1", "1,1,1,2", "2,1,1,1"], {"episode": "u"}, "line 4: episode '1' goes on"),
    ],
)
def test_what_is_wrong_is_said_with_file_and_line(
    tmp_path: Path, lines: list[str], changes: dict[str, Any], message: str
) -> None:
    path = log(tmp_path / "log.csv", *lines)
    with pytest.raises(FileProblem) as refused:
        read(path, PENDULUM, **(COLUMNS | changes))
    assert str(refused.value).startswith(f"{path}: {message}")


def linear_log(path: Path, spec: Spec, size: int = 300) -> tuple[np.ndarray, ...]:
    """One long episode by a jittering clock in ms, sensors in steps of 1e-3; stamps, state, action
    as written."""
    generator = np.random.default_rng(0)
    W = np.array([[0.0, 1.0, 0.0], [-2.0, -0.5, 3.0]])
    stamp = np.cumsum(generator.uniform(5, 20, size)).round(3)
    action = generator.normal(size=(size, 1)).round(3)
    state = np.zeros((size, 2))
    for row in range(size - 1):
        both = np.concatenate([state[row], action[row]])
        state[row + 1] = state[row] + (stamp[row + 1] - stamp[row]) * 1e-3 * (W @ both)
    state = state.round(3)
    rows = np.column_stack([stamp, state, action])
    log(path, *(",".join(map(str, row)) for row in rows.tolist()), header="t,x,v,u")
    return stamp, state, action


@pytest.mark.parametrize("fit", [RecursiveLeastSquares(100.0), Ridge(0.01, every=1, later=1)])
def test_a_log_teaches_the_weights_of_ridge_in_closed_form(tmp_path: Path, fit: Fit) -> None:
    """W = (sum phi phi' + I / prior)^-1 sum phi y', y = (s' - s) / dt, as written."""
    sim, prior = LinearSystem(F, G, dt=0.01), 100.0
    stamp, state, action = linear_log(tmp_path / "log.csv", sim.spec)
    found = read(
        tmp_path / "log.csv",
        sim.spec,
        ["state_0=x", "state_1=v"],
        ["action_0=u"],
        time="t[ms]",
    )
    learner = derivative_learner(fit, None, PlainStep(0.1))
    offline = Offline(learner, World(sim), found.recorded, [0], Lessons("all"), Budget(seconds=1e9))
    for _ in offline.learn(0, 64):
        pass
    phi = np.column_stack([state, action])[:-1]
    y = np.diff(state, axis=0) / (np.diff(stamp) * 1e-3)[:, None]
    exact = np.linalg.solve(phi.T @ phi + np.eye(3) / prior, phi.T @ y).T
    np.testing.assert_allclose(offline.learners.model["weight"][0].numpy(), exact, atol=1e-6)
