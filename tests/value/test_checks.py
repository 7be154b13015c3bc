"""What the public doors refuse, and that they say why; floors that are reported."""

from __future__ import annotations

import math

import pytest
import torch
from torch import Tensor

from edtorch.errors import (
    AsymmetryError,
    CovarianceFloored,
    IndefiniteError,
    NonFiniteError,
    NonSmoothError,
    ShapeError,
)
from edtorch.model.features import Identity
from edtorch.model.models import DerivativeModel
from edtorch.policy.policies import LinearPolicy
from edtorch.rewards import QuadraticReward, Reward
from edtorch.transform import (
    Cubature,
    FirstOrder,
    MeanOnly,
    PositiveNoise,
    SecondOrder,
    Transform,
    data_belief,
    point_belief,
)
from edtorch.transform.positive import floored
from edtorch.types import Belief, Trajectory
from edtorch.value.checks import check_belief
from edtorch.value.unroll import Generic, Horizon, propagate, unroll
from tests.smooth_systems import random_system
from tests.systems import f64, normal, random_cost

EYE = torch.eye(2).double()


def covariance(rows: list[list[float]]) -> Belief:
    return Belief(torch.zeros(2).double(), f64(rows))


@pytest.mark.parametrize(
    ("belief", "error", "message"),
    [
        (Belief(torch.zeros(3).double(), EYE), ShapeError, r"cov has shape \(2, 2\).*\(3, 3\)"),
        (Belief(torch.zeros(()).double(), EYE), ShapeError, r"mean has shape \(\)"),
        (Belief(f64([0.0, math.nan]), EYE), NonFiniteError, r"mean\[1\] is nan"),
        (covariance([[1.0, 0.0], [0.0, math.inf]]), NonFiniteError, r"cov\[1, 1\] is inf"),
        (covariance([[1.0, 0.5], [0.4, 1.0]]), AsymmetryError, r"\(0, 1\) is 0.5 and.*is 0.4"),
        (covariance([[1.0, 2.0], [2.0, 1.0]]), IndefiniteError, "eigenvalue -1, expected"),
        (covariance([[1e-9, 0.0], [0.0, -1e-12]]), IndefiniteError, "eigenvalue -1e-12"),
    ],
)
def test_refuses_what_is_no_belief(belief: Belief, error: type, message: str) -> None:
    assert issubclass(error, ValueError)
    with pytest.raises(error, match=message):
        check_belief(belief)


def test_names_the_row() -> None:
    cov = EYE.expand(2, 3, 2, 2).clone()
    cov[1, 2, 0, 0] = -0.5
    with pytest.raises(IndefiniteError, match=r"cov\[1, 2\] has the eigenvalue -0.5"):
        check_belief(Belief(torch.zeros(2, 3, 2).double(), cov))


@pytest.mark.parametrize("relative", [1e-9, 1e-12])
def test_rounding_is_not_refused(relative: float) -> None:
    check_belief(covariance([[1.0, relative], [0.0, 1.0]]))
    check_belief(covariance([[1.0, 0.0], [0.0, -relative]]))
    check_belief(point_belief(torch.zeros(4, 2)))


def good(**change: object) -> dict:
    parts: dict = {
        "start": point_belief(f64([1.0, 0.5])),
        "closed_loop": lambda s: 0.9 * s,
        "policy": lambda s: s[..., :1],
        "reward": QuadraticReward(EYE, torch.eye(1).double()),
        "transform": FirstOrder(),
        "noise": lambda s: 0.1 * EYE.expand(*s.shape, 2),
        "horizon": Horizon(3, 1.0, 1.0, 1.0),
    }
    return parts | change


def go(**change: object) -> Trajectory:
    parts = good(**change)
    return unroll(parts.pop("start"), parts.pop("closed_loop"), parts.pop("policy"), **parts)


class Smoothless:
    """-|s|, and it says so."""

    smooth = False

    def __call__(self, state: Tensor, action: Tensor) -> Tensor:
        return -state.norm(dim=-1)


def root_reward(state: Tensor, action: Tensor) -> Tensor:
    """-|s_1|^1.5 at s_1 = 0 has no second derivative."""
    return -((state[..., 0] - 1).abs() ** 1.5)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"policy": lambda s: s}, ShapeError, r"action has shape \(2,\), expected \(1,\)"),
        ({"policy": lambda s: s[..., 0]}, ShapeError, r"action has shape \(\)"),
        ({"policy": lambda s: s[..., :1] / 0}, NonFiniteError, "action.* is inf"),
        ({"closed_loop": lambda s: s[..., :1]}, ShapeError, "next state has shape"),
        ({"closed_loop": lambda s: s * math.nan}, NonFiniteError, "next state.* is nan"),
        ({"noise": lambda s: s}, ShapeError, "noise has shape"),
        ({"noise": lambda s: -EYE}, IndefiniteError, "noise has the eigenvalue -1"),
        ({"noise": lambda s: EYE + f64([[0, 1], [0, 0]])}, AsymmetryError, "noise is not symm"),
        ({"reward": lambda s, a: s}, ShapeError, "reward has shape"),
        ({"reward": lambda s, a: s[..., 0] * math.nan}, NonFiniteError, "reward is nan"),
        ({"reward": root_reward}, NonFiniteError, r"Hessian\[0, 0\] is"),
        ({"reward": Smoothless()}, NonSmoothError, "Smoothless declares smooth=False"),
        ({"start": covariance([[1.0, 2.0], [2.0, 1.0]])}, IndefiniteError, "eigenvalue -1"),
    ],
)
def test_unroll_refuses(change: dict, error: type, message: str) -> None:
    go()
    with pytest.raises(error, match=message):
        go(**change)


def test_the_number_of_actions_can_be_said() -> None:
    go(actions=1)
    with pytest.raises(ShapeError, match=r"action has shape \(1,\), expected \(3,\)"):
        go(actions=3)


@pytest.mark.parametrize("transform", [MeanOnly(), Cubature()])
@pytest.mark.parametrize("reward", [Smoothless(), root_reward])
def test_transforms_without_second_derivatives_take_rough_rewards(
    transform: Transform, reward: Reward
) -> None:
    assert bool(go(reward=reward, transform=transform).value.isfinite())


def test_the_generic_path_refuses_a_rough_reward() -> None:
    model = DerivativeModel(2, 1, Identity(3), torch.zeros(2).double())
    policy, horizon = LinearPolicy(2, 1, Identity(2)), Horizon(3, 0.1, 1.0, 0.1)
    Generic(model, policy, Smoothless(), Cubature(), horizon)
    with pytest.raises(NonSmoothError, match="FirstOrder takes second derivatives"):
        Generic(model, policy, Smoothless(), FirstOrder(), horizon)


def test_unroll_is_propagate() -> None:
    parts = good()
    start, loop, policy = (parts.pop(name) for name in ("start", "closed_loop", "policy"))
    checked, pure = unroll(start, loop, policy, **parts), propagate(start, loop, policy, **parts)
    assert torch.equal(checked.value, pure.value) and int(pure.first_floored) == -1


def dipping(s: Tensor) -> Tensor:
    """nu = 1 / (1 + 50 s^2) > 0, whose parabola at 0 dips below zero beyond s = .2."""
    return (1 / (1 + 50 * s.square())).unsqueeze(-1)


def dip(transform: Transform, spread: float) -> dict:
    return {
        "start": Belief(torch.zeros(1).double(), f64([[spread]])),
        "closed_loop": lambda s: 0.1 * s,
        "policy": torch.zeros_like,
        "reward": lambda s, a: -s.square().sum(-1),
        "transform": transform,
        "noise": dipping,
        "horizon": Horizon(4, 1.0, 1.0, 1.0),
    }


def test_a_floor_is_named_with_the_step_at_which_it_began() -> None:
    with pytest.warns(CovarianceFloored, match=r"indefinite at step 1 of 4 \(1 of 1 rows\)"):
        path = go(**dip(SecondOrder(), 1.0))
    assert int(path.first_floored) == 1 and bool((path.cov >= 0).all())
    # From a point the first step has no curvature to add, the second has.
    with pytest.warns(CovarianceFloored, match="indefinite at step 2"):
        path = go(**dip(SecondOrder(), 0.0))
    assert float(path.cov[1]) == 1 and float(path.cov[2]) == 0


def test_a_noise_that_is_vouched_for_is_not_watched() -> None:
    def negative(s: Tensor) -> Tensor:
        return -dipping(s)

    watched = dip(FirstOrder(), 0.0)
    watched["noise"] = negative
    trusted = dip(FirstOrder(), 0.0)
    trusted["noise"] = PositiveNoise(negative)
    paths = []
    for parts in (watched, trusted):
        start, loop, policy = (parts.pop(name) for name in ("start", "closed_loop", "policy"))
        paths.append(propagate(start, loop, policy, **parts))
    assert [int(path.first_floored) for path in paths] == [1, -1]
    assert float(paths[0].cov[1]) == 0 and float(paths[1].cov[1]) == -1


@pytest.mark.parametrize("transform", [FirstOrder(), Cubature()])
def test_no_floor_where_the_noise_is_averaged_as_it_is(transform: Transform) -> None:
    path = go(**dip(transform, 1.0))
    assert int(path.first_floored) == -1 and bool((path.cov[1:] > 0).all())


def test_the_floor_row_by_row() -> None:
    g = torch.Generator().manual_seed(0)
    fine = random_cost(g, 3)
    vectors = torch.linalg.qr(normal(g, 3, 3))[0]
    broken = (vectors * f64([2.0, 1.0, -0.5])) @ vectors.T
    rows = floored(torch.stack([fine, broken, torch.full((3, 3), torch.nan).double()]))
    assert rows.began.tolist() == [False, True, False]
    assert torch.equal(rows.cov[0], fine) and bool(rows.cov[2].isnan().all())
    nearest = (vectors * f64([2.0, 1.0, 0.0])) @ vectors.T
    assert torch.allclose(rows.cov[1], nearest, atol=1e-14)
    slope = torch.func.grad(lambda c: floored(c).cov.square().sum())(torch.zeros(3, 3).double())
    assert bool(slope.isfinite().all())


def test_floors_under_vmap_and_where_arithmetic_breaks() -> None:
    def first(spread: Tensor) -> Tensor:
        parts = dip(SecondOrder(), 0.0)
        parts["start"] = Belief(torch.zeros(1).double(), spread.reshape(1, 1))
        start, loop, policy = (parts.pop(name) for name in ("start", "closed_loop", "policy"))
        return propagate(start, loop, policy, **parts).first_floored

    assert torch.func.vmap(first)(f64([1.0, 0.0])).tolist() == [1, 2]
    system = random_system(2, 0)
    for transform in (FirstOrder(), SecondOrder(), Cubature()):
        path = propagate(
            point_belief(system.start),
            lambda s: s * 1e200,
            system.policy,
            reward=system.reward,
            transform=transform,
            noise=system.noise,
            horizon=Horizon(4, 1.0, 1.0, 1.0),
        )
        assert not bool(path.value.isfinite())


def test_data_belief_is_mean_and_covariance_of_the_data() -> None:
    states = normal(torch.Generator().manual_seed(1), 4, 50, 3)
    belief = data_belief(states)
    assert torch.allclose(belief.mean, states.mean(1))
    assert torch.allclose(belief.cov[2], torch.cov(states[2].T, correction=0), rtol=1e-12)
    check_belief(belief)
    point = data_belief(states[:, :1])
    assert torch.equal(point.mean, states[:, 0]) and not bool(point.cov.any())


def test_data_belief_refuses_what_is_no_data() -> None:
    with pytest.raises(ShapeError, match=r"states have shape \(0, 3\)"):
        data_belief(torch.zeros(0, 3))
    with pytest.raises(NonFiniteError, match=r"states\[1, 0\] is nan"):
        data_belief(f64([[1.0], [math.nan]]))
