"""One tick of learning: Figure 1 followed by hand, and what happens when numbers break."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from edtorch.learner.annealing import Annealed
from edtorch.learner.learner import Check, Learner
from edtorch.learner.limit import Ramp
from edtorch.model.features import Identity
from edtorch.model.fit import BayesianLeastSquares, Fit, RecursiveLeastSquares, SquaredError
from edtorch.model.models import DerivativeModel
from edtorch.model.noise import BayesianNoise, LinearNoise, Noise, ResidualNoise
from edtorch.policy.policies import LinearPolicy
from edtorch.policy.steps import PlainStep, SaturatedStep
from edtorch.rewards import QuadraticReward
from edtorch.run.episodes import Budget
from edtorch.run.scaled_sim import World
from edtorch.run.training import Training
from edtorch.transform import FirstOrder, MeanOnly
from edtorch.types import LearnerState, Transition
from edtorch.value.choose import Method, choose_path
from edtorch.value.unroll import Horizon
from sims.bicycle import Bicycle
from sims.linear import LinearSystem
from tests.systems import bicycle_learner, f64, next_state_model

ONE = torch.tensor(1.0, dtype=torch.float64)


def figure1_learner(
    rate: float, noise_rate: float, alpha: float, horizon: Horizon, method: Method
) -> Learner:
    model = next_state_model(1, 1)
    policy = LinearPolicy(1, 1, Identity(1))
    reward = QuadraticReward(f64([[1.0]]), f64([[0.0]]))
    noise = ResidualNoise(noise_rate)
    path = choose_path(method, model, policy, reward, FirstOrder(), horizon, noise=noise).path
    return Learner(
        model=model,
        policy=policy,
        fit=SquaredError(rate),
        noise=noise,
        value=path,
        step_rule=PlainStep(alpha),
        exploration=0.0,
    )


def transition(s: float, a: float, following: float) -> Transition:
    return Transition(f64([[s]]), f64([[a]]), f64([[following]]), ONE, torch.tensor([True]))


def figure1_value(
    theta: float, w: tuple[float, float], nu: float, s: float, n: int, gamma: float
) -> float:
    """Steps 3 to 6 of Figure 1 in plain numbers, for mu~ = w_s s + w_a a and r(s) = -s^2."""
    mean, variance, value = s, 0.0, 0.0
    for tau in range(1, n + 1):
        slope = w[0] + w[1] * theta
        mean, variance = w[0] * mean + w[1] * theta * mean, nu + slope**2 * variance
        reward = 0.5 * -2.0 * variance - mean**2
        value += gamma ** (tau - 1) * reward
    return value


@pytest.mark.parametrize("method", ["generic", "closed_form"])
def test_figure_1_by_hand_in_one_dimension(method: Method) -> None:
    rate, noise_rate, alpha, n, gamma = 0.2, 0.3, 0.05, 4, 0.9
    learner = figure1_learner(rate, noise_rate, alpha, Horizon(n, 1.0, gamma, 1.0), method)
    state = learner.initial([0])
    ws, wa, nu, theta = 0.0, 0.0, 0.0, 0.0
    generator = torch.Generator().manual_seed(0)
    s = 1.0
    for _ in range(40):
        a, disturbance = (0.5 * torch.randn(2, generator=generator)).tolist()
        following = 0.8 * s + 0.5 * a + 0.1 * disturbance
        state, metrics = learner.step(state, transition(s, a, following))

        # 1: mu~(s, a) <- s', by the gradient of the squared error.
        residual = following - (ws * s + wa * a)
        ws, wa = ws + rate * residual * s, wa + rate * residual * a
        # 2: nu~(s, a) <- (s' - mu~)^2.
        nu += noise_rate * (residual**2 - nu)
        # 3 to 6, and the gradient by central differences.
        value = figure1_value(theta, (ws, wa), nu, following, n, gamma)
        h = 1e-5
        up = figure1_value(theta + h, (ws, wa), nu, following, n, gamma)
        down = figure1_value(theta - h, (ws, wa), nu, following, n, gamma)
        # 7: up the gradient.
        theta += alpha * (up - down) / (2 * h)

        assert state.model["weight"][0, 0].tolist() == pytest.approx([ws, wa], rel=1e-9, abs=1e-12)
        assert float(state.noise["nu"]) == pytest.approx(nu, rel=1e-9, abs=1e-12)
        assert metrics.value is not None
        assert float(metrics.value) == pytest.approx(value, rel=1e-8, abs=1e-12)
        assert float(state.policy["weight"]) == pytest.approx(theta, rel=1e-6, abs=1e-9)
        s = following
    assert theta < -0.1


@pytest.mark.oracle
def test_figure_1_learns_the_system_its_noise_and_to_regulate() -> None:
    world = World(LinearSystem([[1.0]], [[0.5]], noise=0.1, start=1.0, time_limit=20.0))
    learner = figure1_learner(0.1, 0.02, 0.2, Horizon(3, 1.0, 0.9, 1.0), "auto")
    training = Training(
        replace(learner, exploration=1.0), world, [0, 1, 2, 3], Budget(seconds=500.0)
    )
    while not training.done:
        training.advance(500)
    learned = training.learners
    weight = learned.model["weight"][:, 0]
    assert torch.allclose(weight, f64([[1.0, 0.5]] * 4), atol=0.1)
    # The variance of the system's noise, and a little of what the fit keeps forgetting.
    assert bool(((learned.noise["nu"] > 0.005) & (learned.noise["nu"] < 0.025)).all())
    # s' = (1 + .5 theta) s: regulation wants theta = -2, and .5 theta between -2 and 0 is stable.
    assert bool(((learned.policy["weight"].flatten() + 2).abs() < 0.5).all())


def bicycle_transition(learner: Learner, seeds: list[int]) -> tuple[LearnerState, Transition]:
    state = learner.initial(seeds)
    g = torch.Generator().manual_seed(0)
    s, a = torch.randn(len(seeds), 5, generator=g), torch.randn(len(seeds), 2, generator=g)
    after = s + 0.01 * torch.randn(len(seeds), 5, generator=g)
    valid = torch.ones(len(seeds), dtype=torch.bool)
    dt = torch.tensor(0.01, dtype=torch.float64)
    return state, Transition(s.double(), a.double(), after.double(), dt, valid)


def unchanged(a: LearnerState, b: LearnerState, row: int) -> bool:
    pairs = [
        (a.model["weight"], b.model["weight"]),
        (a.policy["weight"], b.policy["weight"]),
        *((a.fit[name], b.fit[name]) for name in a.fit),
        *((a.noise[name], b.noise[name]) for name in a.noise),
    ]
    return all(torch.equal(x[row], y[row]) for x, y in pairs)


@pytest.mark.parametrize(
    ("fit", "noise"),
    [
        (SquaredError(10.0), None),
        (RecursiveLeastSquares(), BayesianNoise(1.0)),
        (BayesianLeastSquares(), LinearNoise(1.0)),
    ],
)
def test_a_broken_transition_is_skipped_and_named(fit: Fit, noise: Noise | None) -> None:
    learner = replace(bicycle_learner(World(Bicycle()), fit=fit), noise=noise)
    state, good = bicycle_transition(learner, [0, 1, 2])
    state, metrics = learner.step(state, good)
    assert bool(metrics.finite.all())
    broken = good.next_state.clone()
    broken[1, 2] = float("nan")
    after, metrics = learner.step(state, replace(good, next_state=broken))
    assert metrics.finite[Check.TRANSITION].tolist() == [True, False, True]
    assert unchanged(after, state, 1) and not unchanged(after, state, 0)
    again, metrics = learner.step(after, good)
    assert bool(metrics.finite.all()) and not unchanged(again, after, 1)
    assert again.tick.tolist() == [3, 3, 3]
    assert again.sound_ticks.tolist() == [3, 1, 3]


def test_an_exploding_fit_is_skipped_and_named() -> None:
    learner = bicycle_learner(World(Bicycle()), fit=SquaredError(1e200))
    state, good = bicycle_transition(learner, [0])
    for _ in range(8):
        before = state
        state, metrics = learner.step(state, good)
        if not bool(metrics.finite[Check.FIT]):
            break
    else:
        raise AssertionError("the fit never broke")
    assert torch.equal(state.model["weight"], before.model["weight"])
    assert bool(state.policy["weight"].isfinite().all())


def test_an_exploding_unroll_is_skipped_and_named() -> None:
    learner = bicycle_learner(World(Bicycle()))
    state, good = bicycle_transition(learner, [0])
    state = replace(state, model={"weight": torch.full((1, 5, 7), 1e30).double()})
    after, metrics = learner.step(state, good)
    assert metrics.finite[:, 0].tolist() == [True, True, False]
    assert torch.equal(after.policy["weight"], state.policy["weight"])


def test_learners_that_are_not_valid_are_left_alone() -> None:
    learner = bicycle_learner(World(Bicycle()))
    state, good = bicycle_transition(learner, [0, 1])
    after, _ = learner.step(state, replace(good, valid=torch.tensor([True, False])))
    assert unchanged(after, state, 1) and not unchanged(after, state, 0)
    assert after.tick.tolist() == [1, 0]


def test_rates_are_per_second_in_the_derivative_form() -> None:
    """Half the tick, half the step: changing the tick changes nothing else."""
    model = DerivativeModel(1, 1, Identity(2), torch.zeros(1).double())
    policy = LinearPolicy(1, 1, Identity(1))
    reward = QuadraticReward(f64([[1.0]]), f64([[0.0]]))
    path = choose_path("auto", model, policy, reward, MeanOnly(), Horizon(9, 0.05, 1, 0.05)).path
    learner = Learner(model, policy, SquaredError(3.0), None, path, SaturatedStep(2.0, 1.0), 0.0)
    moves = []
    for dt in (0.01, 0.005):
        state = learner.initial([0])
        start = f64([[[0.7, 0.2]]])
        state = replace(state, model={"weight": start})
        one = transition(1.0, 0.5, 1.0 + 0.4 * dt)
        after, _ = learner.step(state, replace(one, dt=dt * ONE))
        moves.append((after.model["weight"] - start, after.policy["weight"]))
    assert torch.allclose(moves[0][0], 2 * moves[1][0], rtol=1e-9)
    assert torch.allclose(moves[0][1], 2 * moves[1][1], rtol=0.05)


def test_a_policy_rests_between_its_improvements() -> None:
    learner = bicycle_learner(World(Bicycle()), fit=RecursiveLeastSquares())
    state, transition = bicycle_transition(learner, [1, 2])
    resting, metrics = learner.step(state, transition, improve=False)
    climbing, _ = learner.step(state, transition)
    assert metrics.value is None and metrics.gradient is None and bool(metrics.finite.all())
    assert torch.equal(resting.policy["weight"], state.policy["weight"])
    assert not torch.equal(climbing.policy["weight"], state.policy["weight"])
    assert torch.equal(resting.model["weight"], climbing.model["weight"])
    assert torch.equal(resting.tick, climbing.tick)
    assert torch.equal(resting.sound_ticks, climbing.sound_ticks)


def test_model_and_policy_see_a_state_within_its_bounds() -> None:
    # The same learner, handed the bounded state and as long a step from there.
    world = World(Bicycle())
    free = bicycle_learner(world)
    ramp = Ramp(4, 5, Annealed(0.3, 0.3, 1.0), torch.float64)
    learner = replace(free, command=ramp)
    state, transition = bicycle_transition(learner, [1, 2, 3])
    far = transition.state.clone()
    far[:, 4] = f64([0.9, -0.8, 0.1])
    moved = far + (transition.next_state - transition.state)
    near = far.clone()
    near[:, 4] = f64([0.3, -0.3, 0.1])
    found, _ = learner.step(state, replace(transition, state=far, next_state=moved))
    shifted = near + (moved - far)
    unbounded = replace(state, limit={})
    wanted, _ = free.step(unbounded, replace(transition, state=near, next_state=shifted))
    assert torch.allclose(found.model["weight"], wanted.model["weight"], rtol=1e-12)
    assert torch.allclose(found.policy["weight"], wanted.policy["weight"], rtol=1e-9)
    normal = torch.zeros(3, 2, dtype=torch.float64)
    assert torch.equal(learner.act(found, far, normal), free.act(found, near, normal))
    acting = learner.acting(found)
    assert torch.equal(learner.policy.action(acting, far), free.policy.action(found.policy, near))


def test_exploration_fades() -> None:
    learner = replace(bicycle_learner(World(Bicycle())), exploration=Annealed(1.0, 0.1, 50.0))
    state = learner.initial([1, 2])
    state = replace(state, tick=torch.tensor([0, 10**6]))
    observation = torch.zeros(2, 5, dtype=torch.float64)
    action = learner.act(state, observation, torch.ones(2, 2, dtype=torch.float64))
    assert action.tolist() == [[1.0, 1.0], [0.1, 0.1]]
