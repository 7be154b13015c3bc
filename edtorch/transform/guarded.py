r"""A tick that may cross a guard: a flow as far as the event, a reset, and the flow after it.

    s' = phi_+(T - tau, g(phi_-(tau, s))),   h(phi_-(tau, s)) = 0,

with h > 0 before the event.  The time tau of the event depends on s, so that the derivative of a
tick with an event is not that of its parts, Phi_+ Dg Phi_-, but Phi_+ S Phi_-, with the saltation
matrix

    S = Dg + (f_+ - Dg f_-) grad h' / (grad h . f_-)

on the guard: f_- and f_+ are ds/dt before and after.  Source: N. J. Kong, J. J. Payne, J. Zhu and
A. M. Johnson, "Saltation Matrices: The Essential Tool for Linearizing Hybrid Dynamical Systems",
Proceedings of the IEEE 112 (2024) 585-608, eq. 2.

A ``Guarded`` tick is a closed loop as every ``Transform`` takes it: to first order by its
``jacobian``, over points by itself.  ``HeldLoop`` gives it actions.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from edtorch.derivatives import StateFunction, loop_jacobian, rowwise_jacobian
from edtorch.flow import flow
from edtorch.linalg import matvec
from edtorch.shapes import Rows, Squares, States
from edtorch.types import Belief

_HALVINGS = 12
"""Of the interval that holds tau, before Newton's steps from its end."""


@dataclass(frozen=True)
class Event:
    """What happens where ``guard`` h ``[*batch, n] -> [*batch]`` falls to 0.

    reset g, and ds/dt ``before`` and ``after`` it, all ``[*batch, n] -> [*batch, n]``, finite
    everywhere: they are also computed, and not used, where nothing happens.  Of several guards, h
    is the least, and g finds out which one it is.
    """

    guard: StateFunction
    reset: StateFunction
    before: StateFunction
    after: StateFunction

    def normal(self, state: States) -> States:
        """grad h."""
        return rowwise_jacobian(lambda s: self.guard(s).unsqueeze(-1), state).squeeze(-2)

    def closing(self, state: States) -> Rows:
        """dh/dt = grad h . f_-; -inf where it is not negative: there h does not fall to 0."""
        rate = (self.normal(state) * self.before(state)).sum(-1)
        return torch.where(rate < 0, rate, -torch.inf)


def saltation(event: Event, state: States) -> Squares:
    """S ``[*batch, n, n]`` at states on the guard; Dg where h does not fall there: the event's time
    then has no derivative."""
    reset = rowwise_jacobian(event.reset, state)
    jump = event.after(event.reset(state)) - matvec(reset, event.before(state))
    share = event.normal(state) / event.closing(state).unsqueeze(-1)
    return reset + jump.unsqueeze(-1) * share.unsqueeze(-2)


@dataclass(frozen=True)
class Guarded:
    """s' after ``seconds`` T with one event at most, ``[*batch, n] -> [*batch, n]``, each flow in
    ``steps`` of Runge and Kutta's method.

    An event happens where h <= 0 after T seconds without it: a guard that is crossed and left
    again within a tick is not seen.  Where h <= 0 from the beginning (a state at rest on a stop, a
    point of a belief beyond it) it happens at once.  Derivatives are right up to the second order,
    so that those of ``jacobian`` exist.
    """

    event: Event
    seconds: float
    steps: int = 2

    def __call__(self, state: States) -> States:
        """s'."""
        tau = self.until(state)
        reached = self._before(state, tau)
        after = self._after(self.event.reset(reached), self.seconds - tau)
        return torch.where(self.crosses(state).unsqueeze(-1), after, reached)

    def jacobian(self, state: States) -> Squares:
        """Phi_+ S Phi_- where there is an event, else Phi_-; ``rowwise_jacobian`` of the tick is
        the reference."""
        tau = self.until(state)
        reached = self._before(state, tau)
        start = self.event.reset(reached)
        into = rowwise_jacobian(lambda s: self._before(s, tau), state)
        out = rowwise_jacobian(lambda s: self._after(s, self.seconds - tau), start)
        # What begins beyond the guard is reset at once, whatever its distance: tau is 0.
        reset, salt = rowwise_jacobian(self.event.reset, reached), saltation(self.event, reached)
        across = torch.where(self._falls(state)[..., None, None], salt, reset)
        return torch.where(self.crosses(state)[..., None, None], out @ across @ into, into)

    def crosses(self, state: States) -> Tensor:
        """Whether there is an event, bool ``[*batch]``: its average over particles is its
        probability."""
        return self.event.guard(self._before(state, self.seconds)) <= 0

    def until(self, state: Tensor) -> Tensor:
        """tau ``[*batch]``, seconds; T where there is no event."""
        with torch.no_grad():
            low = torch.zeros_like(state[..., 0])
            high = low + self.seconds
            for _ in range(_HALVINGS):
                middle = (low + high) / 2
                open_ = self.event.guard(self._before(state, middle)) > 0
                low, high = torch.where(open_, middle, low), torch.where(open_, high, middle)
            tau = self._newton(state, high)
        # A step from the root has the derivative of tau, and two have its second one, too.
        tau = self._newton(state, self._newton(state, tau))
        tau = torch.where(self._falls(state), tau, 0.0)
        return torch.where(self.crosses(state), tau, self.seconds)

    def _falls(self, state: Tensor) -> Tensor:
        return self.event.guard(state) > 0

    def _before(self, state: Tensor, seconds: Tensor | float) -> Tensor:
        return flow(self.event.before, state, seconds, self.steps)

    def _after(self, state: Tensor, seconds: Tensor | float) -> Tensor:
        return flow(self.event.after, state, seconds, self.steps)

    def _newton(self, state: Tensor, tau: Tensor) -> Tensor:
        reached = self._before(state, tau)
        return tau - self.event.guard(reached) / self.event.closing(reached)


@dataclass(frozen=True)
class HeldLoop:
    """mu_pi(s) ``[*batch, n]`` of a tick under an action that is held: ``policy``
    ``[*batch, n] -> [*batch, m]``.

    tick: of (s, u), ``[*batch, n + m] -> [*batch, n + m]``, such as a ``Guarded`` one whose slopes
    of u are 0; the blocks of its derivative by s and u are those that a Riccati pass takes.
    """

    tick: StateFunction
    policy: StateFunction

    def __call__(self, state: States) -> States:
        """The state one tick later."""
        return self.tick(self._both(state))[..., : state.shape[-1]]

    def jacobian(self, state: States) -> Squares:
        """d s' / ds + d s' / du dpi / ds."""
        n = state.shape[-1]
        by = loop_jacobian(self.tick, self._both(state))[..., :n, :]
        return by[..., :n] + by[..., n:] @ rowwise_jacobian(self.policy, state)

    def _both(self, state: Tensor) -> Tensor:
        return torch.cat([state, self.policy(state)], dim=-1)


def crossing_probability(belief: Belief, event: Event) -> Rows:
    """P(h <= 0) ``[*batch]`` of a belief over where a tick without the event would have ended, h to
    first order: Phi(-h / sqrt(grad h' Sigma grad h)) at its mean."""
    gap, normal = event.guard(belief.mean), event.normal(belief.mean)
    deviation = (normal * matvec(belief.cov, normal)).sum(-1).sqrt()
    known = (gap <= 0).to(gap.dtype)
    return torch.where(deviation > 0, torch.special.ndtr(-gap / deviation), known)
