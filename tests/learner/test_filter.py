"""State and model estimated together, against what is known in closed form."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from edtorch.learner.filter import JointFilter
from edtorch.model.features import Affine, Identity, Pairwise
from edtorch.model.fit import RecursiveLeastSquares
from edtorch.model.models import DerivativeModel, NextStateModel
from edtorch.types import Belief
from tests.systems import f64, normal

DT = torch.tensor(0.1, dtype=torch.float64)


def derivative_model(n: int, m: int, period: list[float] | None = None) -> DerivativeModel:
    return DerivativeModel(n, m, Identity(n + m), f64(period or [0.0] * n))


def random_belief(g: torch.Generator, batch: int, n: int, size: float) -> Belief:
    root = size * normal(g, batch, n, n)
    return Belief(normal(g, batch, n), root @ root.mT)


def test_with_a_known_model_it_is_the_conditional_expectation_of_everything_read() -> None:
    """A Gaussian of all states and readings at once, conditioned on the readings."""
    g = torch.Generator().manual_seed(0)
    n, m, steps = 2, 1, 6
    model, noise = derivative_model(n, m), f64([0.3, 0.7])
    rule = JointFilter(model, noise, disturbance=0.4)
    weight = normal(g, 1, n, n + m)
    F = torch.eye(n, dtype=torch.float64) + DT * weight[0, :, :n]
    G = DT * weight[0, :, n:]
    Q, R = 0.4**2 * DT * torch.eye(n, dtype=torch.float64), torch.diag(noise.square())
    actions, readings = normal(g, steps, 1, m), normal(g, steps + 1, 1, n)
    belief = rule.first(readings[0])
    # The belief of the first reading is the prior: mean y_0, covariance R.
    means, covs = [readings[0][0]], {(0, 0): R}
    for t in range(steps):
        belief = rule.follow(weight, belief, None, actions[t], readings[t + 1], DT)
        means.append(F @ means[-1] + G @ actions[t, 0])
        covs[t + 1, t + 1] = F @ covs[t, t] @ F.T + Q
        for s in range(t + 1):
            covs[t + 1, s] = F @ covs[t, s]
            covs[s, t + 1] = covs[t + 1, s].T
    order = range(1, steps + 1)
    states = torch.cat([torch.cat([covs[s, t] for t in order], 1) for s in order])
    of_readings = states + torch.block_diag(*[R] * steps)
    last = torch.cat([covs[steps, t] for t in order], 1)
    surprise = (readings[1:, 0] - torch.stack(means[1:])).flatten()
    wanted = means[-1] + last @ torch.linalg.solve(of_readings, surprise)
    wanted_cov = covs[steps, steps] - last @ torch.linalg.solve(of_readings, last.T)
    torch.testing.assert_close(belief.mean[0], wanted, rtol=1e-10, atol=0)
    torch.testing.assert_close(belief.cov[0], wanted_cov, rtol=1e-10, atol=0)


def test_its_covariance_settles_where_riccatis_equation_stands_still() -> None:
    g = torch.Generator().manual_seed(1)
    n = 3
    model, noise = derivative_model(n, 1), f64([0.1, 0.5, 0.2])
    rule = JointFilter(model, noise, disturbance=0.3)
    weight, nothing = normal(g, 1, n, n + 1), torch.zeros(1, n, dtype=torch.float64)
    belief = rule.first(nothing)
    for _ in range(2000):
        belief = rule.follow(weight, belief, None, nothing[:, :1], nothing, DT)
    F = torch.eye(n, dtype=torch.float64) + DT * weight[:, :, :n]
    Q, R = 0.3**2 * DT * torch.eye(n, dtype=torch.float64), torch.diag(noise.square())
    ahead = F @ belief.cov @ F.mT + Q
    again = torch.linalg.inv(torch.linalg.inv(ahead) + torch.linalg.inv(R))
    torch.testing.assert_close(belief.cov, again, rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("kind", [DerivativeModel, NextStateModel])
def test_without_errors_it_is_recursive_least_squares(
    kind: type[DerivativeModel | NextStateModel],
) -> None:
    g = torch.Generator().manual_seed(2)
    n, m, disturbance, prior = 2, 1, 0.2, 3.0
    model = kind(n, m, Affine(n + m), torch.zeros(n, dtype=torch.float64))
    rule = JointFilter(model, torch.zeros(n, dtype=torch.float64), prior, disturbance)
    unit = model.time_unit(DT)
    # RLS counts the prior in units of the variance of its targets' noise.
    squares = RecursiveLeastSquares(float(prior * unit / disturbance**2))
    weight = torch.zeros(1, n, 1 + n + m, dtype=torch.float64)
    memory, state = rule.initial(weight), normal(g, 1, n)
    belief = rule.first(state)
    plain, known = weight, squares.initial(weight)
    for _ in range(30):
        action, following = normal(g, 1, m), normal(g, 1, n)
        found = rule.update(weight, memory, belief, None, action, following, DT)
        phi = model.features(torch.cat([state, action], -1))
        target = (following - state) / DT if kind is DerivativeModel else following
        fitted = squares.update(plain, known, phi, target, unit)
        torch.testing.assert_close(found.residual, fitted.residual, rtol=1e-9, atol=1e-12)
        weight, memory, belief = found.weight, found.memory, found.belief
        plain, known, state = fitted.weight, fitted.memory, following
    torch.testing.assert_close(weight, plain, rtol=1e-8, atol=1e-12)
    torch.testing.assert_close(belief.mean, state)


def test_with_weights_that_are_certain_it_follows_the_state_alone() -> None:
    g = torch.Generator().manual_seed(3)
    model = derivative_model(3, 2)
    rule = JointFilter(model, f64([0.1, 0.2, 0.3]))
    weight, belief = normal(g, 4, 3, 5), random_belief(g, 4, 3, 0.2)
    memory = {k: torch.zeros_like(p) for k, p in rule.initial(weight).items()}
    limit = f64([math.inf, 0.3, math.inf]).expand(4, 3)
    action, reading = normal(g, 4, 2), normal(g, 4, 3)
    found = rule.update(weight, memory, belief, limit, action, reading, DT)
    alone = rule.follow(weight, belief, limit, action, reading, DT)
    assert torch.equal(found.weight, weight)
    torch.testing.assert_close(found.belief.mean, alone.mean, rtol=1e-12, atol=1e-14)
    torch.testing.assert_close(found.belief.cov, alone.cov, rtol=1e-12, atol=1e-14)


@pytest.mark.oracle
def test_the_prediction_has_the_moments_of_a_product_of_two_unknowns() -> None:
    """Monte Carlo of s' = s + dt W (s, a) for jointly normal s and W, a reading that tells
    nothing."""
    g = torch.Generator().manual_seed(4)
    n, m, samples = 2, 1, 400_000
    k = n + m
    model = derivative_model(n, m)
    rule = JointFilter(model, f64([1e6, 1e6]), disturbance=1e-6)
    N = n + n * k
    root = 0.6 * normal(g, N, N)
    joint = root @ root.T
    mean, weight, action = normal(g, 1, n), normal(g, 1, n, k), normal(g, 1, m)
    memory = {"cross": joint[None, :n, n:], "cov": joint[None, n:, n:]}
    belief = Belief(mean, joint[None, :n, :n])
    found = rule.update(weight, memory, belief, None, action, mean, DT)
    drawn = normal(g, samples, N) @ root.T + torch.cat([mean[0], weight.flatten()])
    s, W = drawn[:, :n], drawn[:, n:].reshape(samples, n, k)
    z = torch.cat([s, action.expand(samples, m)], -1)
    following = s + DT * (W @ z.unsqueeze(-1)).squeeze(-1)
    spread = torch.cov(torch.cat([following, W.flatten(1)], -1).T)
    scale = spread.diagonal().sqrt()
    error = 6 / math.sqrt(samples)
    assert bool(((found.belief.mean[0] - following.mean(0)).abs() < error * scale[:n]).all())
    allowed = 3 * error * scale.unsqueeze(-1) * scale
    assert bool(((found.belief.cov[0] - spread[:n, :n]).abs() < allowed[:n, :n]).all())
    assert bool(((found.memory["cross"][0] - spread[:n, n:]).abs() < allowed[:n, n:]).all())
    torch.testing.assert_close(found.memory["cov"], memory["cov"], rtol=1e-6, atol=1e-9)


def noisy_ride(deviation: float, steps: int) -> tuple[Tensor, Tensor, Tensor]:
    """A pendulum that is pushed about, through sensors: weights, actions and readings."""
    g = torch.Generator().manual_seed(5)
    weight = f64([[[0.0, 1.0, 0.0], [-2.0, -0.3, 1.5]]])
    states, actions = [torch.zeros(1, 2, dtype=torch.float64)], 2 * normal(g, steps, 1, 1)
    for action in actions:
        z = torch.cat([states[-1], action], -1)
        moved = states[-1] + DT * (weight @ z.unsqueeze(-1)).squeeze(-1)
        states.append(moved + 0.05 * DT.sqrt() * normal(g, 1, 2))
    readings = torch.stack(states) + deviation * normal(g, steps + 1, 1, 2)
    return weight, actions, readings


@pytest.mark.oracle
def test_finds_the_model_that_least_squares_of_the_readings_never_does() -> None:
    deviation, steps = 0.3, 6000
    true, actions, readings = noisy_ride(deviation, steps)
    model = derivative_model(2, 1)
    rule = JointFilter(model, f64([deviation, deviation]), disturbance=0.05)
    squares = RecursiveLeastSquares()
    weight = plain = torch.zeros_like(true)
    memory, known, belief = rule.initial(weight), squares.initial(plain), rule.first(readings[0])
    for t in range(steps):
        now, following = readings[t], readings[t + 1]
        found = rule.update(weight, memory, belief, None, actions[t], following, DT)
        weight, memory, belief = found.weight, found.memory, found.belief
        phi, target = torch.cat([now, actions[t]], -1), (following - now) / DT
        fitted = squares.update(plain, known, phi, target, DT)
        plain, known = fitted.weight, fitted.memory
    assert float((plain - true).abs().max()) > 0.4
    assert float((weight - true).abs().max()) < 0.1
    # It knows how well it knows.
    deviations = memory["cov"].diagonal(dim1=-2, dim2=-1).sqrt().view_as(weight)
    assert bool(((weight - true).abs() < 4 * deviations).all())


def test_a_reading_on_the_other_side_of_the_circle_is_near() -> None:
    model = derivative_model(1, 1, [2.0])
    rule = JointFilter(model, f64([0.1]), disturbance=0.1)
    weight, action = torch.zeros(1, 1, 2, dtype=torch.float64), f64([[0.0]])
    belief = Belief(f64([[0.98]]), f64([[[0.01]]]))
    found = rule.follow(weight, belief, None, action, f64([[-0.98]]), DT)
    assert -1.02 < float(found.mean) < -0.98


def test_a_new_episode_is_another_state_under_the_same_laws() -> None:
    rule = JointFilter(derivative_model(1, 1), f64([0.1]))
    weight = torch.zeros(1, 1, 2, dtype=torch.float64)
    memory = rule.initial(weight) | {"cross": f64([[[1.0, 2.0]]])}
    begun = rule.begun(memory)
    assert float(begun["cross"].abs().max()) == 0.0
    assert torch.equal(begun["cov"], memory["cov"])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"prior": 0.0}, "prior=0.0: expected a number > 0"),
        ({"disturbance": 0.0}, "disturbance=0.0: expected a number > 0"),
    ],
)
def test_refuses_what_it_cannot_start_from(arguments: dict[str, float], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        JointFilter(derivative_model(1, 1), f64([0.1]), **arguments)


def test_refuses_models_that_are_not_linear() -> None:
    model = DerivativeModel(1, 1, Pairwise(2), f64([0.0]))
    with pytest.raises(
        ValueError, match=r"expected model\.features=identity or affine, not Pairwise"
    ):
        JointFilter(model, f64([0.1]))
