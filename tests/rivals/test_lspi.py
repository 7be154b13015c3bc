"""Against Riccati's gain, and against the optimal values of a walk that is known by heart."""

from __future__ import annotations

import math
from typing import Any

import pytest
import torch
from torch import Tensor

from edtorch.rivals.lspi import Lspi, LspiSearch, lstdq, monomials
from edtorch.run.scaled_sim import World
from sims.bicycle import Bicycle
from tests.rivals.chain import ACTIONS, PLACES, Chain, optimal_values
from tests.rivals.problems import problem
from tests.systems import f64, normal


def _quadratic(state: Tensor, action: Tensor) -> Tensor:
    joint = torch.cat((state, action), -1)
    first, second = torch.triu_indices(joint.shape[-1], joint.shape[-1])
    return joint[..., first] * joint[..., second]


def test_lstdq_and_greedy_steps_find_the_gain_of_riccati() -> None:
    """A discounted regulator with its exact basis: from any transitions, in a few iterations."""
    F, G, discount = f64([[0.9, 0.1], [0.1, 0.8]]), f64([[0.0], [0.1]]), 0.95
    P = torch.eye(2, dtype=torch.float64)
    for _ in range(5000):
        cross = discount * F.T @ P @ G
        P = (
            torch.eye(2)
            + discount * F.T @ P @ F
            - cross @ ((0.1 + discount * G.T @ P @ G).inverse() @ cross.T)
        )
    optimal = (0.1 + discount * G.T @ P @ G).inverse() @ (discount * G.T @ P @ F)

    generator = torch.Generator().manual_seed(0)
    state, action = normal(generator, 400, 2), normal(generator, 400, 1)
    after = state @ F.T + action @ G.T
    reward = -(state.square().sum(-1) + 0.1 * action.square().sum(-1))
    gain = torch.zeros(1, 2, dtype=torch.float64)
    for _ in range(12):
        following = _quadratic(after, -after @ gain.T)
        w = lstdq(_quadratic(state, action), following, reward, discount, 1e-13)
        # w: s0^2, s0 s1, s0 a, s1^2, s1 a, a^2; the best action where the derivative is zero.
        gain = torch.stack((w[2], w[4]))[None] / (2 * w[5])
    assert torch.allclose(gain, optimal, rtol=1e-6)


def _search(world: World, seeds: list[int], settings: Lspi) -> LspiSearch:
    spec = world.spec
    asked = problem(world.sim, [0.0] * len(spec.state), [0.0] * len(spec.action), seeds)
    search = settings.begin(asked)
    while not all(search.done):
        search.advance([not over for over in search.done], lambda: None)
    return search


CHAIN = Lspi(
    actions=[[-1.0], [1.0]],
    steps=10,
    discount=0.9,
    reward_square={"place": -1.0},
    episodes=[20, 60],
    ridge=1e-13,
)


def test_it_finds_the_optimal_values_of_the_chain() -> None:
    """Three places, and polynomials of degree two: the basis is as good as a table."""
    world = World(Chain())
    search = _search(world, [4, 5], CHAIN)
    place = torch.arange(PLACES, dtype=torch.float64)[:, None]
    for weight, solution in zip(search.parameters["weight"], search.solutions, strict=True):
        assert solution is not None and solution.settled
        found = search.actor.basis(place) @ weight.T
        assert torch.allclose(found, optimal_values(0.9), atol=1e-8)
        acts = search.actor.action({"weight": weight.expand(PLACES, -1, -1)}, place)
        assert acts.equal(ACTIONS[1].expand(PLACES, 1))


def test_a_seed_does_the_same_in_any_population() -> None:
    both, alone = (_search(World(Chain()), seeds, CHAIN) for seeds in ([4, 5], [5]))
    assert both.parameters["weight"][1].equal(alone.parameters["weight"][0])
    assert both.accounts[1] == alone.accounts[0]
    assert both.accounts[0].episodes == 60


def test_products_of_components_and_opposites() -> None:
    world = World(Bicycle())
    basis = [[], ["lean", "lean", "handlebar"], ["~angle_to_goal"]]
    phi = monomials(basis, world.spec, world.period)
    x = f64([[0.5, 9.0, 3.0, 9.0, 0.25], [2.0, 9.0, 1.0, 9.0, -0.25]])
    # pi is the angle's unit: the opposite of a quarter of it is three quarters.
    assert torch.allclose(phi(x), f64([[1, 0.75, 0.75], [1, 4.0, -0.75]]))
    assert monomials([], world.spec, world.period).outputs == 21


@pytest.mark.parametrize(
    ("settings", "wanted"),
    [
        ({"episodes": [5, 4]}, r"episodes=\[5, 4\]: expected rising"),
        ({"episodes": []}, r"episodes=\[\]: expected rising"),
        ({"iterations": 0}, r"iterations=0: expected an integer >= 1"),
        ({"ridge": 0.0}, r"ridge=0\.0: expected a number > 0"),
        ({"basis": [["a", "b"], ["b", "a"]]}, r"basis=.*: expected different products"),
    ],
    ids=str,
)
def test_refuses_impossible_settings(settings: dict[str, Any], wanted: str) -> None:
    with pytest.raises(ValueError, match=wanted):
        Lspi(**settings)


def test_refuses_names_that_the_domain_has_not() -> None:
    for name in ("lena", "~lean"):
        with pytest.raises(ValueError, match=r"basis\[0\]=.*: expected names of lean"):
            monomials([[name]], World(Bicycle()).spec, World(Bicycle()).period)
    nothing = Lspi(reward_square={"lean": 0.0})
    with pytest.raises(ValueError, match=r"reward_failure=0\.0: expected another number"):
        _search(World(Bicycle()), [0], nothing)


def test_terminal_states_are_worth_nothing() -> None:
    """One transition that ends, with discount: its value is its reward."""
    one = torch.ones(1, 1, dtype=torch.float64)
    w = lstdq(one, torch.zeros_like(one), f64([3.0]), 0.5, 1e-13)
    assert math.isclose(float(w[0]), 3.0, rel_tol=1e-9)
