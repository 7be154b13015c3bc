"""Policies improved through time: beside automatic derivatives, and beside Riccati's equation."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from edtorch.model.mechanism import runge_kutta
from edtorch.model.terms import Terms
from edtorch.policy.lifted import LiftedPolicy
from edtorch.policy.squash import Squash
from edtorch.search.imagination import Futures, imagine_policies
from edtorch.search.plan import Cost, ramp
from edtorch.search.policy_descent import PolicyDescent, Weighted, descend, expansion
from edtorch.search.tick_model import TickModel
from tests.planning import (
    HANGING,
    oscillator,
    oscillator_cost,
    swing_up,
    swing_up_cost,
    tick_once,
)


def _policy(model: TickModel, degree: int = 2, seed: int = 0) -> Weighted:
    lift = model.structure.lift
    terms = Terms.of_state(lift, range(lift.states), degree)
    generator = np.random.default_rng(seed)
    return Weighted(terms, 0.3 * generator.standard_normal((lift.actions, terms.count)))


def _starts(count: int) -> np.ndarray:
    return HANGING + 0.3 * np.random.default_rng(1).standard_normal((count, 4))


def _residuals(model: TickModel, cost: Cost, policy: Weighted, start: np.ndarray) -> torch.Tensor:
    """Of one start, as a function of theta in torch: the squares of these are the cost."""
    structure = model.structure
    squash = Squash(torch.from_numpy(model.middle), torch.from_numpy(model.half))
    actor = LiftedPolicy(structure.lift, policy.terms, squash)
    weight, rows = torch.from_numpy(model.weight), torch.from_numpy(cost.rows)

    def residuals(theta: torch.Tensor) -> torch.Tensor:
        state, found = torch.from_numpy(start), []
        for t in range(cost.ticks):
            raw = theta @ actor.features(state)
            action = actor.action({"weight": theta}, state)
            found += [torch.from_numpy(cost.action**0.5) * raw.tanh(), cost.squash**0.5 * raw]
            state = runge_kutta(structure, weight, state, action, model.dt, model.substeps)
            away = rows[t + 1] @ structure.lift(state, torch.zeros_like(action))
            found.append(float(cost.weight[t + 1]) ** 0.5 * away)
        return torch.cat(found)

    theta = torch.from_numpy(policy.weight)
    value = residuals(theta)
    jacobian = torch.autograd.functional.jacobian(residuals, theta).flatten(1)
    return torch.cat([value[:, None], jacobian], dim=1)


def test_the_expansion_is_that_of_the_roll_outs() -> None:
    """Cost, gradient 2 J'r and Hessian 2 J'J of the residuals r that torch differentiates."""
    model, starts = swing_up(), _starts(2)
    cost, policy = replace(swing_up_cost(model, 6), squash=0.02), _policy(model)
    found = [_residuals(model, cost, policy, start) for start in starts]
    value, gradient, hessian = expansion(model, cost, policy, starts)
    rows = torch.cat(found)
    r, jacobian = rows[:, 0], rows[:, 1:]
    assert value == pytest.approx(float(r.square().sum()) / 2, rel=1e-9)
    np.testing.assert_allclose(gradient, (jacobian.mT @ r).numpy(), rtol=1e-6, atol=1e-8)
    np.testing.assert_allclose(hessian, (jacobian.mT @ jacobian).numpy(), rtol=1e-6, atol=1e-8)


def test_on_a_linear_system_it_is_riccatis_gain() -> None:
    """With bounds far off, a linear policy that is best over a long horizon."""
    model = oscillator((1.0, -0.4))
    cost = oscillator_cost(model, 150)
    policy = replace(_policy(model, degree=1), weight=np.array([[-4e-3, -3e-3], [0.0, 0.0]]))
    exact = PolicyDescent(damping=1e-6, tolerance=1e-14)
    starts = np.array([[0.4, -0.2], [0.1, 0.5]])
    found = descend(model, cost, policy, starts, exact)
    _, by = tick_once(model, model.weight, np.zeros(2), np.zeros(2))
    a, b = by[:, :2], by[:, 2:]
    row, ahead, gain = cost.rows[1][:, 1:3], np.zeros((2, 2)), np.zeros((2, 2))
    for _ in range(2000):
        ahead = row.T @ row + a.T @ ahead @ (a + b @ gain)
        effort = b.T @ ahead @ b + np.diag(cost.action / model.half**2)
        gain = -np.linalg.solve(effort, b.T @ ahead @ a)
    np.testing.assert_allclose(model.half[:, None] * found.weight, gain, rtol=1e-4, atol=1e-5)


def test_it_only_goes_down() -> None:
    model, starts = swing_up(), _starts(3)
    cost = replace(swing_up_cost(model, 30), weight=ramp(30, 1.0))
    policy = _policy(model)
    found = descend(model, cost, policy, starts, PolicyDescent(limit=10))
    before, _, _ = expansion(model, cost, policy, starts)
    after, _, _ = expansion(model, cost, found, starts)
    assert found.cost == pytest.approx(after, rel=1e-12) and after < before


def test_what_is_imagined_is_what_the_policy_does() -> None:
    model, policy, cost = swing_up(), _policy(swing_up()), swing_up_cost(swing_up(), 20)
    generator = np.random.default_rng(3)
    futures = Futures(
        weight=model.weight * (1 + 0.1 * generator.standard_normal((3, *model.weight.shape))),
        start=_starts(3),
        noise=0.01 * generator.standard_normal((3, 20, 4)),
    )
    squash = Squash(torch.zeros(1).double(), torch.ones(1).double())
    actor = LiftedPolicy(model.structure.lift, policy.terms, squash)
    theta = {"weight": torch.from_numpy(policy.weight)[None]}
    (imagined,) = imagine_policies(model, cost, actor, theta, futures)
    for p in range(3):
        state = futures.start[p]
        for t in range(20):
            np.testing.assert_allclose(imagined.state[p, t], state, rtol=1e-8, atol=1e-8)
            reading = torch.from_numpy(state + futures.noise[p, t])
            action = actor.action(theta, reading[None])[0].numpy()
            state, _ = tick_once(model, futures.weight[p], state, action)
    still = Futures(np.tile(model.weight, (3, 1, 1)), futures.start, np.zeros((3, 20, 4)))
    mean = imagine_policies(model, cost, actor, theta, still)[0].cost.mean()
    assert expansion(model, cost, policy, futures.start)[0] == pytest.approx(mean, rel=1e-12)


def test_one_that_is_not_finite_is_said() -> None:
    model = swing_up()
    wild = replace(model, weight=np.full_like(model.weight, 1e200))
    cost = swing_up_cost(model, 5)
    assert not np.isfinite(descend(wild, cost, _policy(model), _starts(2)).cost)


def test_weights_that_do_not_fit_are_named() -> None:
    model, policy = swing_up(), _policy(swing_up())
    wrong = replace(policy, weight=policy.weight[:, 1:])
    with pytest.raises(ValueError, match=r"weight: shape \(1, 18\): expected \(1, 19\)"):
        expansion(model, swing_up_cost(model, 5), wrong, _starts(1))
