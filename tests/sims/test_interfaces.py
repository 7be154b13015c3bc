"""Actions, names and environments that do not keep to an interface are refused in one line."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch

from edtorch.run.files import FileProblem
from edtorch.run.transitions_meta import read_meta
from sims.base import Sim, SimulatorFailed
from sims.bicycle import Bicycle
from sims.cardea import Cardea
from sims.from_gymnasium import GymnasiumSim
from sims.linear import LinearSystem
from sims.tasks.cart_pole import CartPole
from sims.tasks.quadrotor import Quadrotor
from tests.api_envs import Cart

SIMS: list[Callable[[], Sim]] = [
    Bicycle,
    Cardea,
    lambda: LinearSystem([[1, 0.02], [0, 1]], [[0], [0.06]], dt=0.01, time_limit=1),
    CartPole,
    Quadrotor,
    lambda: GymnasiumSim(env=Cart, dt=0.1),
]


@pytest.mark.parametrize("make", SIMS)
def test_sims_refuse_actions_that_would_broadcast(make: Callable[[], Sim]) -> None:
    sim = make()
    state = sim.initial(torch.full((3, sim.spec.reset_dim), 0.4, dtype=torch.float64))
    uniforms = torch.full((3, sim.spec.disturbance_dim), 0.4, dtype=torch.float64)
    m = len(sim.spec.action)
    for shape in ((), (m,), (1, m), (3, m + 1), (3,), (2, 3, m)):
        with pytest.raises(ValueError, match=r"^action: has shape .*, expected \(3, "):
            sim.step(state, torch.zeros(shape, dtype=torch.float64), uniforms)
    assert sim.step(state, torch.zeros(3, m, dtype=torch.float64), uniforms).shape == state.shape


@pytest.mark.parametrize("action", [0.0, [0.0], [[0.0, 0.0]], [0.0, 0.0, 0.0]])
def test_environments_refuse_actions_that_would_broadcast(action: Any) -> None:
    env = gymnasium.make("edtorch/Bicycle-v0", disable_env_checker=True)
    env.reset(seed=0)
    with pytest.raises(ValueError, match=r"has shape .*, expected \(2,\)"):
        env.step(np.array(action))


@pytest.mark.parametrize("names", [["a", "a"], ["a.b", "c"], ["", "b"], ["a"]])
def test_names_twice_or_with_dots_are_refused(names: list[str]) -> None:
    with pytest.raises(ValueError, match=r"state_names=.*: expected 2 different ones without dots"):
        GymnasiumSim(env=Cart, dt=0.1, state_names=names)


class Foreign(Cart):
    """With another interface."""

    def step(self, action: Any) -> Any:
        observation, reward, terminated, truncated, _ = super().step(action)
        return observation, reward, terminated or truncated, {}


class Unseeded(Cart):
    """Without a seed."""

    def reset(self) -> Any:  # pyright: ignore[reportIncompatibleMethodOverride]
        return super().reset()


class Bare(Cart):
    """Without info in reset."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        return super().reset(seed=seed)[0]


@pytest.mark.parametrize("wrapped", [False, True])
@pytest.mark.parametrize(
    ("env", "message"),
    [
        (Foreign, "^Foreign: step gave four values, as Gym did before 0.26; expected"),
        (Unseeded, "^Unseeded: reset failed: it takes no seed, expected reset"),
        (Bare, "^Bare: reset failed: ValueError: it gave ndarray, expected .observation, info"),
        (
            lambda: Cart(trouble="shape", first=1),
            "^Cart: none of its first 10 steps succeeded: ValueError: an observation of shape"
            " .3,., expected .2,.",
        ),
    ],
)
def test_environments_with_another_interface_are_refused(
    env: Callable[[], gymnasium.Env[Any, Any]], message: str, wrapped: bool
) -> None:
    def make() -> gymnasium.Env[Any, Any]:
        return gymnasium.wrappers.TimeLimit(env(), 20) if wrapped else env()

    sim = GymnasiumSim(env=make, dt=0.1)
    nothing, push = torch.zeros(10, 0).double(), torch.ones(10, 1).double()
    with pytest.raises(SimulatorFailed, match=message):
        sim.step(sim.initial(torch.rand(10, 1).double()), push, nothing)


def test_a_reward_may_be_an_array_of_one_number() -> None:
    class Array(Cart):
        def step(self, action: Any) -> Any:
            observation, reward, *ends = super().step(action)
            return observation, np.array([reward]), *ends

    found = []
    for env in (Cart, Array):
        sim = GymnasiumSim(env=env, dt=0.1)
        state = sim.initial(torch.tensor([[0.5]]).double())
        state = sim.step(state, torch.ones(1, 1).double(), torch.zeros(1, 0).double())
        assert bool(sim.stepped(state))
        found.append(float(sim.total_reward(state)))
    assert found[0] == found[1]


def test_the_module_to_import_is_no_part_of_the_name() -> None:
    assert GymnasiumSim("sims:edtorch/Bicycle-v0").spec.name == "edtorch/Bicycle-v0"


def test_a_file_with_the_module_in_the_name_of_its_domain_is_of_that_domain() -> None:
    spec = LinearSystem([[1, 0.02], [0, 1]], [[0], [0.06]], dt=0.01, time_limit=1).spec
    content = {
        "format": 1,
        "domain": f"my.module:{spec.name}",
        "units": "physical",
        "state": [{"name": q.name, "unit": q.unit} for q in spec.state],
        "action": [{"name": q.name, "unit": q.unit} for q in spec.action],
        "seeds": [{"seed": 0, "episodes": [0, 1]}],
    }
    layout = read_meta(Path("transitions.npz"), np.array(json.dumps(content)), spec)
    assert layout.state == [0, 1]
    content["domain"] = "another"
    with pytest.raises(FileProblem, match=r"meta\.domain="):
        read_meta(Path("transitions.npz"), np.array(json.dumps(content)), spec)
