"""Gymnasium environments are brought back to where they were, or their episodes are dropped."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from gymnasium import spaces
from torch import Tensor

from edtorch.run.episodes import Budget
from edtorch.run.scaled_sim import World
from edtorch.run.training import Training
from sims.base import Outcome, Remembering
from sims.from_gymnasium import GymnasiumSim
from sims.linear import LinearSystem
from sims.sensing import Sensed
from tests.api_envs import Cart
from tests.systems import bicycle_learner

NOTHING = torch.zeros(3, 0).double()
SEEDS = torch.tensor([[0.1], [0.5], [0.9]], dtype=torch.float64)
DROPPED = "the environment does not repeat itself under its seed"


class Windy(Cart):
    """With noise of its own generator; writes into its action."""

    def __init__(self, **arguments: Any) -> None:
        super().__init__(**arguments)
        self.action_space = spaces.Box(-2.0, 2.0, (1,), np.float64)

    def step(self, action: Any) -> Any:
        assert action.dtype == np.float64
        action += self.np_random.normal()
        return super().step(action.astype(np.float32))


class Foreign(Cart):
    """With noise that no seed repeats, in about half of the episodes."""

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> Any:
        found = super().reset(seed=seed, options=options)
        self._still = seed is not None and seed < 2**30
        return found

    def step(self, action: Any) -> Any:
        shift = 0.0 if self._still else np.random.normal()
        return super().step(action + np.float32(shift))


MAKERS: dict[str, Callable[[], GymnasiumSim]] = {
    "pendulum": lambda: GymnasiumSim("Pendulum-v1"),
    "pendulum with an angle": lambda: GymnasiumSim(
        "Pendulum-v1", angles={"theta": ("state_0", "state_1")}
    ),
    "windy": lambda: GymnasiumSim(env=Windy, dt=0.1),
}


def actions(count: int) -> Tensor:
    generator = torch.Generator().manual_seed(5)
    return 4 * torch.rand(count, 3, 1, generator=generator, dtype=torch.float64) - 2


def moved(sim: Any, state: Tensor, taken: Tensor) -> list[Tensor]:
    """Three rows, the second one restarted on the way; all states."""
    states = [state]
    for k, action in enumerate(taken):
        states.append(sim.step(states[-1], action, NOTHING[:, : sim.spec.disturbance_dim]))
        if k == 7:
            mask = torch.tensor([False, True, False])
            states.append(sim.restart(states[-1], mask, SEEDS.flip(0)))
    return states


@pytest.mark.parametrize("name", MAKERS)
@pytest.mark.parametrize("steps", [0, 30])
def test_what_follows_is_the_same_bit_for_bit(name: str, steps: int) -> None:
    sim, other = MAKERS[name](), MAKERS[name]()
    taken = actions(steps + 60)
    state = moved(sim, sim.initial(SEEDS), taken[:steps])[-1]
    memory = sim.memory()
    wanted = moved(sim, state, taken[steps:])
    # It has lived through something else before.
    moved(other, other.initial(SEEDS / 2), taken[:5])
    again = other.recall(state, memory)
    assert torch.equal(again, state)
    found = moved(other, again, taken[steps:])
    assert all(torch.equal(a, b) for a, b in zip(found, wanted, strict=True))
    assert other.notes == sim.notes
    for key, tensor in sim.memory().items():
        assert torch.equal(other.memory()[key], tensor), key


def test_episodes_that_are_not_repeated_are_lost(caplog: pytest.LogCaptureFixture) -> None:
    def make() -> GymnasiumSim:
        return GymnasiumSim(env=Foreign, dt=0.1)

    sim, other = make(), make()
    state = moved(sim, sim.initial(SEEDS), actions(6))[-1]
    again = other.recall(state, sim.memory())
    assert other.lost(again).tolist() == [False, True, True]
    (line,) = caplog.messages
    assert line.startswith(f"Foreign: 2 of 3 episodes are dropped: {DROPPED} (")
    assert torch.equal(other.observe(again), sim.observe(state))
    assert other.outcome(again).tolist() == [Outcome.RUNNING, Outcome.FAILED, Outcome.FAILED]
    (push,) = actions(1)
    after = other.step(again, push, NOTHING)
    assert torch.equal(after[0], sim.step(state, push, NOTHING)[0])
    assert torch.equal(after[1:], again[1:]) and not bool(other.stepped(after)[1:].any())
    fresh = other.restart(after, other.lost(after), SEEDS)
    assert not bool(other.lost(other.step(fresh, push, NOTHING)).any())


def test_an_environment_that_fails_meanwhile_loses_its_episode(
    caplog: pytest.LogCaptureFixture,
) -> None:
    sim = GymnasiumSim(env=Cart, dt=0.1)
    state = moved(sim, sim.initial(SEEDS), actions(6))[-1]
    other = GymnasiumSim(env=lambda: Cart(trouble="raise"), dt=0.1)
    again = other.recall(state, sim.memory())
    assert bool(other.lost(again).all())
    assert "3 of 3" in caplog.text and "RuntimeError: the cable broke" in caplog.text


def test_what_has_ended_stays_so() -> None:
    """Nothing is repeated for it."""

    def make() -> GymnasiumSim:
        return GymnasiumSim(env=lambda: Windy(steps=4), dt=0.1)

    sim, other = make(), make()
    state = moved(sim, sim.initial(SEEDS), actions(6))[-1]
    assert sim.memory()["steps"].tolist() == [0, 0, 0]
    again = other.recall(state, sim.memory())
    assert torch.equal(again, state) and not bool(other.lost(again).any())
    (push,) = actions(1)
    assert torch.equal(other.step(again, push, NOTHING), state)
    starts = [s.restart(state, torch.ones(3, dtype=torch.bool), SEEDS) for s in (sim, other)]
    assert torch.equal(*starts)


def test_a_fault_is_said_once(caplog: pytest.LogCaptureFixture) -> None:
    """Whether it came before or after."""

    def make() -> GymnasiumSim:
        return GymnasiumSim(env=lambda: Cart(trouble="raise"), dt=0.1)

    sim, other = make(), make()
    state = moved(sim, sim.initial(SEEDS), actions(6))[-1]
    assert bool(sim.lost(state).all()) and len(caplog.messages) == 1
    again = other.recall(state, sim.memory())
    assert torch.equal(again, state)
    fresh = other.restart(again, other.lost(again), SEEDS)
    assert bool(other.lost(moved(other, fresh, actions(6))[-1]).all())
    assert len(caplog.messages) == 1


def test_a_line_about_angles_is_said_once() -> None:
    """With the observation by which it is decided, in either half."""
    sim, late, early = (MAKERS["pendulum"]() for _ in range(3))
    taken = actions(90)
    state = moved(sim, sim.initial(SEEDS), taken[:30])[-1]
    early.recall(state, sim.memory())
    assert sim.notes == early.notes == []
    moved(early, state, taken[30:])
    state = moved(sim, state, taken[30:])[-1]
    assert len(sim.notes) == 1 and early.notes == sim.notes
    late.recall(state, sim.memory())
    assert late.notes == sim.notes
    moved(late, state, taken)
    assert late.notes == sim.notes


def test_the_one_environment_that_was_given() -> None:
    sim, other = (GymnasiumSim(env=Windy(), dt=0.1) for _ in range(2))
    assert sim.most_rows == 1
    state = sim.initial(SEEDS[:1])
    for action in actions(20):
        state = sim.step(state, action[:1], NOTHING[:1])
    again = other.recall(state, sim.memory())
    for action in actions(5):
        state, again = (
            s.step(x, action[:1], NOTHING[:1]) for s, x in ((sim, state), (other, again))
        )
        assert torch.equal(state, again)


def test_before_it_was_started_there_is_nothing_to_recall() -> None:
    with pytest.raises(ValueError, match="memory: Pendulum-v1 has not been started"):
        MAKERS["pendulum"]().memory()


def test_sensors_pass_it_on() -> None:
    def make(env: Callable[[], Cart]) -> Any:
        return Sensed(GymnasiumSim(env=env, dt=0.1), {"state_0": 0.1}, 2)

    assert not isinstance(Sensed(LinearSystem([[1.0]], [[1.0]])), Remembering)
    numbers = torch.rand(3, 3, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    for env, lost in ((Windy, [False] * 3), (Foreign, [False, True, True])):
        sim, other = make(env), make(env)
        assert isinstance(make(env), Remembering)
        state = sim.initial(torch.cat((SEEDS, numbers[:, :2]), -1))
        for action in actions(10):
            state = sim.step(state, action, numbers[:, :2])
        again = other.recall(state, sim.memory())
        assert other.lost(again).tolist() == lost
        assert torch.equal(other.observe(again), sim.observe(state))
        (push,) = actions(1)
        kept = ~torch.tensor(lost)
        wanted, found = (s.step(x, push, numbers[:, :2]) for s, x in ((sim, state), (other, again)))
        assert torch.equal(found[kept], wanted[kept])


def learning(env: Callable[[], Cart]) -> Training:
    world = World(GymnasiumSim(env=env, dt=0.1))
    return Training(bicycle_learner(world, horizon=5), world, [0, 1, 2], Budget(seconds=30.0))


def halves(env: Callable[[], Cart], ticks: int) -> Training:
    """Interrupted after so many ticks, up to where the other half has begun."""
    first, second = learning(env), learning(env)
    first.advance(ticks)
    second.restore(first.state(), first.episodes)
    return second


def test_learning_goes_on_bit_for_bit() -> None:
    whole, second = learning(Windy), halves(Windy, 77)
    whole.advance(300)
    second.advance(300 - 77)
    assert torch.equal(second.worlds.world, whole.worlds.world)
    for name, weight in whole.learners.policy.items():
        assert torch.equal(second.learners.policy[name], weight)
    assert len(whole.episodes) > 20 and second.lost_episodes == [0, 0, 0]


def test_learning_goes_on_without_what_is_lost() -> None:
    """The episode ends with the next tick, of which nothing is learned."""
    training = halves(Foreign, 77)
    lost = training.world.lost(training.worlds.world).tolist()
    assert any(lost)
    before, failures = training.learners.fit, training.worlds.failures.tolist()
    training.advance(1)
    assert training.lost_episodes == [int(each) for each in lost]
    for row, gone in enumerate(lost):
        if gone:
            assert all(
                torch.equal(training.learners.fit[k][row], t[row]) for k, t in before.items()
            )
            assert int(training.worlds.failures[row]) == failures[row]
            assert int(training.worlds.begun[row]) == 78
    training.advance(222)
    assert training.done and sum(training.lost_episodes) == sum(lost)
