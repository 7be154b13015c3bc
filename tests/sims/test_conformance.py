"""Every sim keeps to the protocol, and the check notices those that do not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import pytest
import torch
from torch import Tensor

from sims.base import Measure, Sim, Spec
from sims.bicycle import Bicycle, Physics, explicit_euler
from sims.bicycle.slalom import Slalom
from sims.conformance import check
from sims.from_gymnasium import GymnasiumSim
from sims.linear import LinearSystem
from sims.sensing import Sensed
from sims.tasks.cart_pole import CartPole
from sims.tasks.quadrotor import Quadrotor

ALL_AT_ONCE: dict[str, Any] = {
    "spread": 0.3,
    "gust": 10.0,
    "gust_seconds": 0.03,
    "gust_every": 0.05,
    "change_at": 0.05,
    "change": {"v": 5.0},
    "start_lean": 0.1,
}

SIMS: dict[str, Callable[[], Sim]] = {
    "bicycle": Bicycle,
    "bicycle, six components": lambda: Bicycle(lean_acceleration=True, integrate=explicit_euler),
    "bicycle, not clipped": lambda: Bicycle(clip_action=False, goal_radius=2.0, noise=0.0),
    "bicycle, drawn": lambda: Bicycle(spread=0.3),
    "bicycle, windy": lambda: Bicycle(gust=10.0, gust_seconds=0.03, gust_every=0.05),
    "bicycle, changing": lambda: Bicycle(change_at=0.05, change={"M_p": 90.0, "v": 5.0}),
    "bicycle, off balance": lambda: Bicycle(start_lean=0.1, start_handlebar=0.35),
    "bicycle, true precession": lambda: Bicycle(physics=Physics(true_precession=True)),
    "bicycle, all at once": lambda: Bicycle(**ALL_AT_ONCE),
    "slalom": Slalom,
    "slalom, all at once": lambda: Slalom(**ALL_AT_ONCE),
    "bicycle, sensed": lambda: Sensed(Bicycle(), {"lean": 0.1, "angle_to_goal": 0.1}, 1),
    "slalom, all at once, sensed": lambda: Sensed(Slalom(**ALL_AT_ONCE), {"lean_rate": 0.1}, 3),
    "linear, sensed": lambda: Sensed(LinearSystem([[1.0]], [[1.0]]), {"state_0": 0.1}, 2),
    "linear": lambda: LinearSystem([[1.0, 0.1], [0.0, 0.9]], [[0.0], [0.5]]),
    "cart-pole": lambda: CartPole(push=2.0),
    "quadrotor": Quadrotor,
    "pendulum": lambda: GymnasiumSim("Pendulum-v1"),
    "mountain car": lambda: GymnasiumSim(
        "MountainCarContinuous-v0", dt=0.02, termination="success"
    ),
}


@pytest.mark.parametrize("name", SIMS)
def test_every_sim_conforms(name: str) -> None:
    # Compiled: test_rows.
    check(SIMS[name], compiled=False)


def test_one_object_conforms_too() -> None:
    check(Bicycle(), compiled=False)
    check(GymnasiumSim("Pendulum-v1"), batches=((1,), (5,)))


class InPlace(Bicycle):
    """Writes into its argument."""

    def step(self, state: Tensor, action: Tensor, uniforms: Tensor) -> Tensor:
        return state.copy_(super().step(state, action, uniforms))


class Forgetful(Bicycle):
    """Draws numbers of its own."""

    def step(self, state: Tensor, action: Tensor, uniforms: Tensor) -> Tensor:
        return super().step(state, action, torch.rand_like(uniforms))


class Coupled(Bicycle):
    """Its rows depend on one another, in the last digits."""

    def observe(self, state: Tensor) -> Tensor:
        seen = super().observe(state)
        return seen + 1e-12 * seen[..., :1].sum()


class RestartsAll(Bicycle):
    """Restarts what it should not."""

    def restart(self, state: Tensor, mask: Tensor, uniforms: Tensor) -> Tensor:
        return self.initial(uniforms)


class RestartsNone(Bicycle):
    """Restarts nothing."""

    def restart(self, state: Tensor, mask: Tensor, uniforms: Tensor) -> Tensor:
        return state


@dataclass(frozen=True)
class Reborn(Bicycle):
    """Draws anew what should last."""

    spread: float = 0.3

    def restart(self, state: Tensor, mask: Tensor, uniforms: Tensor) -> Tensor:
        return torch.where(mask[..., None], self.initial(uniforms), state)


@dataclass(frozen=True)
class Reminiscent(Bicycle):
    """Its starts depend on the ride before, beyond what lasts."""

    spread: float = 0.3

    def restart(self, state: Tensor, mask: Tensor, uniforms: Tensor) -> Tensor:
        new = super().restart(state, mask, uniforms).clone()
        new[..., 5] = torch.where(mask, state[..., 5], new[..., 5])
        return new


class Unwrapped(Bicycle):
    """Its angle leaves its period."""

    def observe(self, state: Tensor) -> Tensor:
        return super().observe(state) + 4


class Diverging(Bicycle):
    """Runs out of numbers."""

    def step(self, state: Tensor, action: Tensor, uniforms: Tensor) -> Tensor:
        return super().step(state, action, uniforms) / 0


class Undecided(Bicycle):
    """Reports an outcome that there is not."""

    def outcome(self, state: Tensor) -> Tensor:
        return super().outcome(state) + 7


class Floating(Bicycle):
    """Reports outcomes as floats."""

    def outcome(self, state: Tensor) -> Tensor:
        return super().outcome(state).double()


class Mismeasured(Bicycle):
    """One figure for the whole batch."""

    def measures(self, start: Tensor, final: Tensor, seconds: Tensor) -> dict[str, Tensor]:
        return {"seconds": seconds.sum()}


class Undeclared(Bicycle):
    """Declares a measure that it does not give."""

    @property
    def spec(self) -> Spec:
        return replace(super().spec, measures=(Measure("style", "style"),))


class Stingy(Bicycle):
    """One reward for the whole batch."""

    def total_reward(self, state: Tensor) -> Tensor:
        return state.sum()


class Wavering(Bicycle):
    """Half a success."""

    def succeeded(self, state: Tensor) -> Tensor:
        return torch.full(state.shape[:-1], 0.5)


class Lossy(Bicycle):
    """Counts what it should decide."""

    def lost(self, state: Tensor) -> Tensor:
        return torch.zeros(state.shape[:-1], dtype=torch.int64)


class Amnesiac(Bicycle):
    """Says that it recalls where it was, and starts anew."""

    def memory(self) -> dict[str, Tensor]:
        return {}

    def recall(self, state: Tensor, memory: dict[str, Tensor]) -> Tensor:
        return self.initial(torch.zeros(*state.shape[:-1], self.spec.reset_dim).double())


@dataclass(frozen=True)
class Misnamed(Bicycle):
    """Shows a component that it has not."""

    @property
    def spec(self) -> Spec:
        return replace(super().spec, headline="speed")


class Short(Bicycle):
    """Hides a component."""

    def observe(self, state: Tensor) -> Tensor:
        return super().observe(state)[..., :4]


@dataclass(frozen=True)
class MovingGoal(Bicycle):
    """What it calls a goal changes as it rides."""

    @property
    def spec(self) -> Spec:
        return replace(super().spec, goal=("angle_to_goal",), tracked=("lean",))


@dataclass(frozen=True)
class Goalless(Bicycle):
    """Follows nothing."""

    @property
    def spec(self) -> Spec:
        return replace(super().spec, tracked=("lean",))


@pytest.mark.parametrize(
    ("broken", "message"),
    [
        (InPlace, "step: changes its argument state"),
        (Forgetful, "other digits from the same uniforms"),
        (Coupled, "observation of row"),
        (RestartsAll, "outside the mask"),
        (RestartsNone, "no new start"),
        (Reborn, "restart: changed what lasts"),
        (Reminiscent, "no new start"),
        (Unwrapped, "beyond its period"),
        (Diverging, "not finite"),
        (Undecided, "not an Outcome"),
        (Floating, "outcome is torch.float64"),
        (Mismeasured, "measures.seconds"),
        (Undeclared, "spec.measures: {'style'} not among"),
        (Stingy, "total_reward"),
        (Wavering, "of torch.float32, expected"),
        (Lossy, "of torch.int64, expected"),
        (Amnesiac, "recall: other digits, 0 steps after"),
        (Misnamed, "headline"),
        (Short, "observation of shape"),
        (MovingGoal, "the goal has moved"),
        (Goalless, "spec.goal, spec.tracked"),
    ],
)
def test_a_broken_sim_is_named(broken: type[Bicycle], message: str) -> None:
    with pytest.raises(AssertionError, match="bicycle: ") as complaint:
        check(broken)
    assert message in str(complaint.value)
