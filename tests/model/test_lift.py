"""The lift of states and actions."""

from __future__ import annotations

import math

import pytest
import torch
from torch.func import jacrev, vmap

from edtorch.model.lift import Lift
from edtorch.model.told import Told
from sims.base import Quantity, Spec

TOLD = Told(
    names=("p", "x", "q", "v"),
    unit=(0.5, 1.0, 2.0, 3.0),
    angle=(True, False, True, False),
    rate_of=(-1, -1, -1, 1),
    actions=("a", "b"),
)


def _rows(count: int = 6) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    both = torch.randn(count, 6, generator=generator, dtype=torch.float64)
    return both[:, :4], both[:, 4:]


def test_entries() -> None:
    lift = Lift.of(TOLD)
    assert lift.names == ("1", "sin p", "cos p", "x", "sin q", "cos q", "v", "a", "b")
    assert lift.at.tolist() == [1, 3, 4, 6] and lift.action_at == 7 and lift.size == 9
    (p, x, q, v), u = (part := _rows())[0].unbind(-1), part[1]
    expected = [
        torch.ones_like(p), (p / 2).sin(), (p / 2).cos(), x, (2 * q).sin(), (2 * q).cos(), v, *u.mT
    ]  # fmt: skip
    torch.testing.assert_close(lift(*part), torch.stack(expected, -1), rtol=0, atol=0)
    assert lift.entry("cos q") == 5
    with pytest.raises(ValueError, match=r"entry='w': expected one of 1, sin p"):
        lift.entry("w")


def test_a_turn_changes_nothing() -> None:
    lift, (state, action) = Lift.of(TOLD), _rows()
    turned = state + torch.tensor([2 * math.pi / 0.5, 0, 2 * math.pi / 2.0, 0], dtype=state.dtype)
    torch.testing.assert_close(lift(turned, action), lift(state, action), rtol=0, atol=1e-14)


def test_jacobian_is_that_of_automatic_differentiation() -> None:
    lift, (state, action) = Lift.of(TOLD), _rows()
    by_state, by_action = vmap(jacrev(lift, argnums=(0, 1)))(state, action)
    expected = torch.cat([by_state, by_action], dim=-1)
    torch.testing.assert_close(lift.jacobian(state, action), expected, rtol=0, atol=1e-15)
    shaped = lift.jacobian(state.reshape(2, 3, 4), action.reshape(2, 3, 2))
    assert torch.equal(shaped.flatten(0, 1), lift.jacobian(state, action))


def test_without_angles_and_actions() -> None:
    spec = Spec("free", (Quantity("x", "m"),), (), 0.1, 1.0, 0, 0, False, "x")
    lift = Lift.of(Told.of(spec))
    state = torch.tensor([[2.0]], dtype=torch.float64)
    assert lift(state, state[:, :0]).tolist() == [[1.0, 2.0]]


def test_it_has_derivatives_after_it_was_used_without() -> None:
    """What it looks up once does not belong to the mode in which that happened."""
    lift, (state, action) = Lift.of(TOLD), _rows()
    with torch.inference_mode():
        wanted = lift(state, action)
    found = lift(state.requires_grad_(), action)
    found.sum().backward()
    assert found.equal(wanted) and state.grad is not None
