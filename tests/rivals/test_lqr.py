"""The regulator that knows the world: its matrices are the sim's, its gain solves Riccati's."""

from __future__ import annotations

import dataclasses

import pytest
import torch

from edtorch.model.features import Affine
from edtorch.policy.policies import LinearPolicy, SquashedPolicy
from edtorch.rivals.lqr import Lqr, calmest_start, linearised
from edtorch.run.scaled_sim import World
from sims.base import spec_index
from sims.bicycle import Bicycle
from sims.bicycle.lqr import REDUCED
from sims.bicycle.lqr import linearised as linearised_bicycle
from sims.linear import LinearSystem
from tests.rivals.problems import pause, problem, scalar

STATE = [[1.1, 0.3], [-0.2, 0.9]]
ACTION = [[0.0], [0.5]]


def test_matrices_of_a_linear_system() -> None:
    F, G = linearised(World(LinearSystem(STATE, ACTION, noise=0.1)))
    torch.testing.assert_close(F, torch.tensor(STATE, dtype=torch.float64))
    torch.testing.assert_close(G, torch.tensor(ACTION, dtype=torch.float64))


def test_gain_solves_the_riccati_equation() -> None:
    asked = problem(LinearSystem(STATE, ACTION, noise=0.1), [1.0, 2.0], [0.3], [0, 1, 2])
    search = Lqr().begin(asked)
    F, G = (torch.tensor(x, dtype=torch.float64) for x in (STATE, ACTION))
    Q, R = asked.weights.state_cost, asked.weights.action_cost
    P, theta = Q, torch.zeros(1, 2, dtype=torch.float64)
    for _ in range(500):
        theta = -torch.linalg.solve(R + G.T @ P @ G, G.T @ P @ F)
        P = Q + F.T @ P @ (F + G @ theta)
    assert search.done == [False] * 3
    search.advance([True, False, True], pause)
    assert search.done == [True, False, True]
    torch.testing.assert_close(search.parameters["weight"], theta.expand(3, -1, -1))
    assert all((a.seconds, a.episodes, a.failures) == (0.0, 0, 0) for a in search.accounts)


def test_the_bicycle_is_linearised_upright_and_straight() -> None:
    """As by its own regulator, but for the goal, which comes nearer and is not only a heading."""
    world = World(Bicycle())
    start = calmest_start(world)
    assert float(world.observe(start).abs().max()) < 1e-12
    F, G = linearised(world)
    known_F, known_G = linearised_bicycle(Bicycle().physics, Bicycle().integrate, 0.01)
    place = spec_index(world.spec, (*REDUCED[:4], "angle_to_goal"))
    scale = torch.tensor([q.scale for q in world.spec.state], dtype=torch.float64)[place]
    force = torch.tensor([q.scale for q in world.spec.action], dtype=torch.float64)
    sign = torch.tensor([1.0, 1.0, 1.0, 1.0, -1.0], dtype=torch.float64)
    outer = (sign * scale).unsqueeze(-1)
    F, G = F[place][:, place] * outer / outer.T, G[place] * outer / force
    torch.testing.assert_close(F, known_F, atol=1e-4, rtol=0)
    torch.testing.assert_close(G, known_G, atol=1e-4, rtol=0)


def test_refuses() -> None:
    asked = scalar()
    free = type(asked.weights)(asked.weights.state_cost, 0 * asked.weights.action_cost)
    with pytest.raises(ValueError, match=r"reward\.action: expected a cost > 0 of every action"):
        Lqr().begin(dataclasses.replace(asked, reward=free))
    for policy in (LinearPolicy(1, 1, Affine(1)), SquashedPolicy(1, 1, asked.policy.features)):
        with pytest.raises(ValueError, match=r"policy: expected policy=linear"):
            Lqr().begin(dataclasses.replace(asked, policy=policy))
    idle = problem(LinearSystem([[2.0]], [[0.0]]), [1.0], [1.0], [0])
    with pytest.raises(ValueError, match="linear: no stationary regulator"):
        Lqr().begin(idle)
