"""The covariance of an inverse policy's unroll: against torch, differences, and samples."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor
from torch.func import jacrev

from edtorch.inverse.adjoint import Loop, walk
from edtorch.inverse.covariance import jacobians
from edtorch.inverse.generic import GenericInverse
from edtorch.inverse.layout import Layout
from edtorch.inverse.loop import InverseLoop
from edtorch.inverse.policy import Form, InversePolicy
from edtorch.inverse.unroll import InverseUnroll, driven, regressors, step_noise
from edtorch.transform import FirstOrder
from edtorch.value.unroll import Horizon
from tests.inverse.arm import Masses

LAYOUT = Layout(Masses().spec)
HORIZON = Horizon(12, 0.05, 0.9, 0.05)


def _normal(*shape: int, seed: int) -> Tensor:
    generator = torch.Generator().manual_seed(seed)
    return 0.3 * torch.randn(*shape, generator=generator, dtype=torch.float64)


def _case(policy: InversePolicy) -> tuple[Tensor, ...]:
    """theta, base, state, goal and noise of two learners with four states each."""
    half = LAYOUT.size // 2
    root = 3 * _normal(2, half, half, seed=4)
    return (
        0.3 * _normal(2, 5, policy.outputs, seed=0),
        _normal(2, 1, regressors(policy), seed=1),
        _normal(2, 4, LAYOUT.size, seed=2),
        _normal(2, 4, 5, seed=3),
        root @ root.mT,
    )


@pytest.mark.parametrize("form", ["error", "goal"])
@pytest.mark.parametrize("limit", [30.0, None])
def test_value_and_gradient_are_those_of_the_generic_unroll(
    form: Form, limit: float | None
) -> None:
    policy = InversePolicy(LAYOUT, 20.0, limit, form)
    case = _case(policy)
    fast = InverseUnroll(policy, HORIZON, 1.7, True, 0.2)
    found = fast(*case)
    expected = GenericInverse(policy, HORIZON, FirstOrder(), 1.7, 0.2)(*case)
    torch.testing.assert_close(found.value, expected.value, rtol=1e-10, atol=0)
    scale = float(expected.gradient["weight"].abs().max())
    torch.testing.assert_close(found.gradient, expected.gradient, rtol=0, atol=1e-10 * scale)
    without = InverseUnroll(policy, HORIZON, 1.7)(*case)
    assert bool((found.value < without.value).all())
    assert float((found.gradient["weight"] - without.gradient["weight"]).abs().max()) > 0.1 * scale


def test_the_gradient_is_what_differences_say() -> None:
    policy = InversePolicy(LAYOUT)
    unroll = InverseUnroll(policy, HORIZON, 1.0, True, 0.1)
    theta, *rest = _case(policy)
    gradient = unroll(theta, *rest).gradient["weight"]
    step = 1e-5
    for seed in range(3):
        along = _normal(*theta.shape, seed=10 + seed)
        on, back = (unroll(theta + s * step * along, *rest).value for s in (1, -1))
        expected = (gradient * along).sum((-2, -1))
        torch.testing.assert_close((on - back) / (2 * step), expected, rtol=1e-6, atol=1e-8)


def test_without_noise_from_a_known_state_the_covariance_adds_nothing() -> None:
    policy = InversePolicy(LAYOUT)
    theta, base, state, goal, noise = _case(policy)
    found = InverseUnroll(policy, HORIZON, 1.0, True)(theta, base, state, goal, 0 * noise)
    expected = InverseUnroll(policy, HORIZON, 1.0)(theta, base, state, goal)
    torch.testing.assert_close(found.value, expected.value, rtol=1e-13, atol=0)
    torch.testing.assert_close(found.gradient, expected.gradient, rtol=1e-11, atol=1e-13)


def test_jacobians_are_those_of_the_loop() -> None:
    policy = InversePolicy(LAYOUT)
    theta, base, state, goal, _ = _case(policy)
    step, shift = InverseUnroll(policy, HORIZON)._step(base)
    loop = Loop(step, shift, *driven(policy, theta, goal), torch.arange(5), True)
    (J,) = jacobians(loop, walk(loop, state, 1))
    plain = InverseLoop(policy, theta, base, HORIZON.dt)
    x = torch.cat((state, goal), -1)
    own = jacrev(lambda s: plain(s).sum((0, 1)))(x).movedim(0, -2)[..., : LAYOUT.size, :]
    torch.testing.assert_close(J, own[..., : LAYOUT.size].flatten(0, 1), rtol=1e-12, atol=1e-13)


def test_the_value_is_the_mean_over_random_paths_where_the_loop_is_linear() -> None:
    """E[V] of paths pushed by white accelerations, within five standard errors."""
    policy = InversePolicy(LAYOUT, 20.0, None)
    theta, base, state, goal, noise = _case(policy)
    waves = slice(1 + LAYOUT.size - 5, 1 + LAYOUT.size + 5)
    base[..., waves] = 0  # sin q and cos q
    state, goal = state[:, :1], goal[:, :1]
    paths = 20_000
    loop = InverseLoop(policy, theta, base, HORIZON.dt)
    x = torch.cat((state, goal), -1).expand(-1, paths, -1)
    nu = step_noise(policy, noise, HORIZON.dt)
    values, vectors = torch.linalg.eigh(nu)
    root = vectors * values.clamp(min=0).sqrt().unsqueeze(-2)
    generator = torch.Generator().manual_seed(5)
    gained = torch.zeros(2, paths, dtype=torch.float64)
    for w in HORIZON.weights():
        pushed = torch.randn(2, paths, LAYOUT.size, generator=generator, dtype=torch.float64)
        x = loop(x)
        x = torch.cat((x[..., : LAYOUT.size] + pushed @ root.mT, x[..., LAYOUT.size :]), -1)
        gained -= w * (x[..., :5] - x[..., LAYOUT.size :]).square().sum(-1)
    value = InverseUnroll(policy, HORIZON, 1.0, True)(theta, base, state, goal, noise).value
    error = gained.std(-1) / paths**0.5
    assert bool(((gained.mean(-1) - value).abs() < 5 * error).all())
    without = InverseUnroll(policy, HORIZON, 1.0)(theta, base, state, goal).value
    assert bool(((without - value) > 20 * error).all())


def test_noise_of_a_step_is_that_of_a_constant_random_acceleration() -> None:
    """Var(dq) = nu~ d, Var(q) = nu~ d^3 / 4."""
    policy = InversePolicy(LAYOUT)
    half = LAYOUT.size // 2
    nu = step_noise(policy, torch.eye(half, dtype=torch.float64).unsqueeze(0), 0.1)
    torch.testing.assert_close(nu[0, half:, half:], 0.1 * torch.eye(half).double())
    torch.testing.assert_close(nu[0, :half, :half], 0.1**3 / 4 * torch.eye(half).double())
