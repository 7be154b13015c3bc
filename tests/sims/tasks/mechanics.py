"""Mechanisms of rods by Lagrange's equations, derived by automatic differentiation."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor
from torch.func import grad, hessian, jacrev, jvp, vmap

from sims.rows import TORCH
from sims.tasks.held_tip import HeldTip
from sims.tasks.integrate import runge_kutta_over

GRAVITY = 9.82


@dataclass(frozen=True)
class Rods:
    """Uniform rods end to end, the first on a cart or (no cart) at the origin: masses, kg; lengths,
    m; cart: its mass.  q: the position of the cart, if there is one, and each rod's angle from
    upright, anticlockwise.  ``force(dq, u)``: the generalized forces of action and friction."""

    masses: tuple[float, ...]
    lengths: tuple[float, ...]
    force: Callable[[Tensor, Tensor], Tensor]
    cart: float | None = None

    def _centres(self, q: Tensor) -> Tensor:
        """Of the rods, ``[rods, 2]``, m."""
        joint, angles = torch.zeros(2).to(q), q
        if self.cart is not None:
            joint, angles = torch.stack([q[0], torch.zeros(()).to(q)]), q[1:]
        centres = []
        for angle, length in zip(angles, self.lengths, strict=True):
            rod = length * torch.stack([-angle.sin(), angle.cos()])
            centres.append(joint + rod / 2)
            joint = joint + rod
        return torch.stack(centres)

    def lagrangian(self, q: Tensor, dq: Tensor) -> Tensor:
        """Kinetic minus potential energy, J."""
        return self.energies(q, dq)[0] - self.energies(q, dq)[1]

    def energies(self, q: Tensor, dq: Tensor) -> tuple[Tensor, Tensor]:
        """Kinetic and potential energy, J."""
        centres, speeds = jvp(self._centres, (q,), (dq,))[:2]
        masses, lengths = q.new_tensor(self.masses), q.new_tensor(self.lengths)
        turning = masses * lengths**2 / 12 * dq[-len(self.masses) :] ** 2
        kinetic = 0.5 * ((masses * (speeds**2).sum(-1)).sum() + turning.sum())
        if self.cart is not None:
            kinetic = kinetic + 0.5 * self.cart * dq[0] ** 2
        return kinetic, GRAVITY * (masses * centres[:, 1]).sum()

    def energy(self, q: Tensor, dq: Tensor) -> Tensor:
        """Kinetic plus potential energy, J."""
        return sum(self.energies(q, dq), torch.zeros(()).to(q))

    def accelerations(self, q: Tensor, dq: Tensor, u: Tensor) -> Tensor:
        """d^2 q / dt^2 by d/dt dL/d(dq) - dL/dq = force."""
        mass = hessian(self.lagrangian, 1)(q, dq)
        mixed = jacrev(grad(self.lagrangian, 1), 0)(q, dq)
        rest = self.force(dq, u) + grad(self.lagrangian, 0)(q, dq) - mixed @ dq
        return torch.linalg.solve(mass, rest)


def draws(sim: HeldTip, count: int = 20) -> tuple[Tensor, Tensor]:
    """States ``[count, n]`` (all angles, high speeds) and actions ``[count, m]``."""
    generator = torch.Generator().manual_seed(0)
    n, m = len(sim.spec.state), len(sim.spec.action)
    state = 3 * torch.randn(count, n, generator=generator, dtype=torch.float64)
    return state, 3 * torch.randn(count, m, generator=generator, dtype=torch.float64)


def _derivative(sim: HeldTip, state: Tensor, action: Tensor) -> Tensor:
    return torch.stack(sim.derivative(TORCH)(state.unbind(-1), action.unbind(-1)), -1)


def check_equations(sim: HeldTip, rods: Rods) -> None:
    """The derivative is that of Lagrange's equations; energy changes by the power of the forces."""
    state, action = draws(sim)
    q, dq = state[:, 0::2], state[:, 1::2]
    found = _derivative(sim, state, action)
    torch.testing.assert_close(found[:, 0::2], dq, rtol=0, atol=0)
    expected = vmap(rods.accelerations)(q, dq, action)
    torch.testing.assert_close(found[:, 1::2], expected, rtol=1e-9, atol=1e-9)
    change = jvp(vmap(rods.energy), (q, dq), (found[:, 0::2], found[:, 1::2]))[1]
    power = (vmap(rods.force)(dq, action) * dq).sum(-1)
    torch.testing.assert_close(change, power, rtol=1e-9, atol=1e-9)


def check_conservation(sim: HeldTip, rods: Rods, idle: Callable[[Tensor], Tensor]) -> None:
    """Energy is constant over a trial from about the horizontal under actions ``idle(state)`` that
    cancel friction, to 1e-6 of what lifts the mechanism from hanging to upright."""
    n, dt = len(sim.spec.state), sim.spec.dt

    def free(state: tuple[Tensor, ...], nothing: None) -> tuple[Tensor, ...]:
        return _derivative(sim, torch.stack(state, -1), idle(torch.stack(state, -1))).unbind(-1)

    move = runge_kutta_over(TORCH, free, n, sim.substeps)
    state = torch.tensor([[1.5] * n, [-1.0, 1.0] * (n // 2), [2.0, -3.0] * (n // 2)]).double()
    before = vmap(rods.energy)(state[:, 0::2], state[:, 1::2])
    rows = state.unbind(-1)
    for _ in range(round(sim.spec.time_limit / dt)):
        rows = move(rows, None, dt)
    state = torch.stack(rows, -1)
    after = vmap(rods.energy)(state[:, 0::2], state[:, 1::2])
    upright = torch.zeros(n // 2).double()
    hanging = torch.tensor(sim.mean[0::2], dtype=torch.float64)
    lift = float(rods.energy(upright, upright) - rods.energy(hanging, upright))
    torch.testing.assert_close(after, before, rtol=0, atol=1e-6 * lift)


def check_equilibria(sim: HeldTip) -> None:
    """At rest, upright and hanging, without action, nothing moves; a rod that leans falls."""
    action = torch.zeros(len(sim.spec.action)).double()
    upright = torch.zeros(len(sim.spec.state)).double()
    hanging = torch.tensor(sim.mean, dtype=torch.float64)
    for state in (upright, hanging):
        torch.testing.assert_close(
            _derivative(sim, state, action), torch.zeros_like(state), rtol=0, atol=1e-13
        )
    assert float(sim.distance(upright)) == 0.0
    lean = torch.where(hanging != 0, 0.1, 0.0)
    rate = int(hanging.nonzero()[0]) + 1
    assert float(_derivative(sim, lean, action)[rate]) > 0
