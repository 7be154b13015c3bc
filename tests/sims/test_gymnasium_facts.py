"""What a Gymnasium environment states, what it is given, and what is refused."""

from __future__ import annotations

from typing import Any, Literal

import numpy as np
import pytest
from gymnasium import spaces

from sims.from_gymnasium import GymnasiumSim
from tests.api_envs import Cart


@pytest.mark.parametrize(
    ("limit", "seconds", "threshold", "note"),
    [
        (None, 999.0, 90.0, None),
        (999.0, 999.0, 90.0, None),
        (500.0, 500.0, None, "time_limit=500 s is below the 999 s of MountainCarContinuous-v0"),
        (2000.0, 999.0, 90.0, "time_limit=2000 s is above the 999 s after which MountainCar"),
    ],
)
def test_time_limits_beside_that_of_the_environment(
    limit: float | None, seconds: float, threshold: float | None, note: str | None
) -> None:
    sim = GymnasiumSim("MountainCarContinuous-v0", dt=1.0, time_limit=limit)
    assert (sim.spec.time_limit, sim.spec.success_return) == (seconds, threshold)
    assert len(sim.notes) == (note is not None)
    assert note is None or sim.notes[0].startswith(note)


def test_without_a_limit_of_steps_there_are_1000() -> None:
    sim = GymnasiumSim(env=Cart, dt=0.1)
    assert sim.spec.time_limit == 100
    (note,) = sim.notes
    assert note.startswith("Cart states no limit of steps: an episode ends after 1000 of them")


@pytest.mark.parametrize(
    ("termination", "survival"), [(None, None), ("failure", True), ("success", False)]
)
def test_a_declared_termination_decides_what_lasting_means(
    termination: Literal["failure", "success"] | None, survival: bool | None
) -> None:
    assert GymnasiumSim(env=Cart, dt=0.1, termination=termination).spec.survival is survival


class Boxes(Cart):
    """With other spaces."""

    def __init__(self, **spaces_: spaces.Space[Any]) -> None:
        super().__init__()
        vars(self).update(spaces_)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"action_space": spaces.Box(-2, 2, (1,), np.int64)}, "discrete actions are not supported"),
        ({"action_space": spaces.MultiBinary(2)}, "gymnasium.wrappers.TransformAction"),
        ({"action_space": spaces.Box(-1, 1, (2, 2))}, "supported is a one-dimensional Box; map"),
        ({"action_space": spaces.Box(1, 1, (1,))}, "bounds that leave it a range"),
        ({"action_space": spaces.Box(0, 1, (0,))}, "expected at least one action"),
        ({"observation_space": spaces.Box(-1, 1, (0,))}, "supported are vectors"),
        ({"observation_space": spaces.Box(0, 255, (8, 8), np.uint8)}, "images are not supported"),
        ({"observation_space": spaces.Discrete(4)}, "discrete observations are not supported"),
        ({"observation_space": spaces.Tuple([spaces.Box(-1, 1, (2,))])}, "FlattenObservation"),
    ],
)
def test_spaces_that_are_refused(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        GymnasiumSim(env=lambda: Boxes(**changes), dt=0.1)


@pytest.mark.parametrize(
    ("name", "arguments", "message"),
    [
        (
            "CartPole-v1",
            {"dt": 0.02},
            "env_id=CartPole-v1: action space Discrete(2): discrete actions are not supported",
        ),
        ("NoSuchThing-v3", {"dt": 0.02}, "env_id=NoSuchThing-v3: expected a Gymnasium"),
        ("MountainCarContinuous-v0", {}, "dt=None: expected"),
        ("MountainCarContinuous-v0", {"dt": -1.0}, "dt=-1.0: expected"),
        ("Pendulum-v1", {"time_limit": 0.0}, "time_limit=0.0: expected"),
        ("Pendulum-v1", {"state_scale": [1.0]}, "state_scale=[1.0]: expected 3"),
        ("Pendulum-v1", {"action_scale": [0.0]}, "action_scale.action_0=0.0: expected a finite"),
        ("Pendulum-v1", {"time_limit": float("inf")}, "time_limit=inf: expected a finite"),
        ("Pendulum-v1", {"action_names": ["state_1"]}, "action_names: 'state_1' is a component"),
        ("Pendulum-v1", {"state_names": ["a", "a", "b"]}, "expected 3 different ones"),
        ("Pendulum-v1", {"headline": "angle"}, "headline='angle': expected one of state_0"),
        ("Pendulum-v1", {"termination": "end"}, "termination='end': expected"),
        ("Pendulum-v1", {"angles": ["theta"]}, "angles.theta: 'theta' is not one of state_0"),
        ("Pendulum-v1", {"rates": {"w": "state_0"}}, "rates.w=state_0: 'w' is not one of state_0"),
    ],
)
def test_refuses_what_is_no_sim(name: str, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as refusal:
        GymnasiumSim(name, **arguments)
    assert message in str(refusal.value)
