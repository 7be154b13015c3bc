"""The adjoint written out against torch's differentiation of the unroll as it is written."""

from __future__ import annotations

import pytest
import torch

from edtorch.inverse.generic import GenericInverse
from edtorch.inverse.layout import Layout
from edtorch.inverse.policy import Form, InversePolicy
from edtorch.inverse.unroll import InverseUnroll, regressors
from edtorch.transform import MeanOnly
from edtorch.value.unroll import Horizon
from tests.inverse.arm import Masses

LAYOUT = Layout(Masses().spec)


def _normal(*shape: int, seed: int) -> torch.Tensor:
    generator = torch.Generator().manual_seed(seed)
    return 0.3 * torch.randn(*shape, generator=generator, dtype=torch.float64)


@pytest.mark.parametrize("form", ["error", "goal"])
@pytest.mark.parametrize("limit", [30.0, None])
def test_value_and_gradient_are_those_of_the_generic_unroll(
    form: Form, limit: float | None
) -> None:
    policy = InversePolicy(LAYOUT, 20.0, limit, form)
    horizon = Horizon(25, 0.05, 0.9, 0.05)
    unroll, generic = (
        InverseUnroll(policy, horizon, 1.7),
        GenericInverse(policy, horizon, MeanOnly(), 1.7),
    )
    theta = 0.3 * _normal(3, 5, policy.outputs, seed=0)
    base = _normal(3, 1, regressors(policy), seed=1)
    state, goal = _normal(3, 10, LAYOUT.size, seed=2), _normal(3, 10, 5, seed=3)
    found, expected = unroll(theta, base, state, goal), generic(theta, base, state, goal)
    torch.testing.assert_close(found.value, expected.value, rtol=1e-10, atol=0)
    scale = float(expected.gradient["weight"].abs().max())
    torch.testing.assert_close(found.gradient, expected.gradient, rtol=0, atol=1e-10 * scale)
    assert scale > 1e-3


def test_without_a_policy_and_a_base_everything_drifts_on() -> None:
    """V = -sum d |q_0 + tau d dq - g|^2."""
    policy = InversePolicy(LAYOUT)
    unroll = InverseUnroll(policy, Horizon(4, 0.1, 1.0, 0.1))
    state, goal = _normal(1, 1, LAYOUT.size, seed=2), _normal(1, 1, 5, seed=3)
    zero = torch.zeros(1, 5, policy.outputs, dtype=torch.float64)
    base = torch.zeros(1, 1, regressors(policy), dtype=torch.float64)
    value = unroll(zero, base, state, goal).value
    seconds = 0.1 * torch.arange(1, 5, dtype=torch.float64)[:, None]
    path = state[0, 0, :5] + seconds * state[0, 0, 6:11] - goal[0, 0]
    torch.testing.assert_close(value[0], -0.1 * path.square().sum())


def test_refuses() -> None:
    policy = InversePolicy(LAYOUT)
    with pytest.raises(ValueError, match=r"^reading=definition"):
        InverseUnroll(policy, Horizon(4, 0.1, 1.0, 0.1, "definition"))
    with pytest.raises(ValueError, match=r"^goal=0"):
        InverseUnroll(policy, Horizon(4, 0.1, 1.0, 0.1), 0.0)
    for name, value in (("gain", 0.0), ("limit", -1.0), ("form", "x")):
        with pytest.raises(ValueError, match=f"^{name}="):
            InversePolicy(LAYOUT, **{name: value})  # pyright: ignore[reportArgumentType]
