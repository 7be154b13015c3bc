"""The model of a mechanism: rates told, accelerations learned, integrated over a tick.

ds_i/dt = ratio_i s_source(i) where the derivative is another component, f_l where it is learned,
0 elsewhere.  The learned derivatives f ``[L]`` may depend on each other: with weights W and terms
phi(A(s, u)),

    f_l = sum_k W_lk phi_k f_derivative(k)   (a factor 1 where derivative(k) = -1),

that is (I - N) f = h with h_l the sum over the terms without f, and N_lj that over those with f_j.
W_lk is 0 where derivative(k) = l.  Without terms with f, f = h.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from edtorch.circle import wrapped
from edtorch.flow import flow
from edtorch.model.lift import Lift
from edtorch.model.terms import Terms
from edtorch.model.ties import Ties
from edtorch.model.told import Told

_LEAST_VARIANCE = 1e-30
"""Of an acceleration: the derivative of a root is infinite at zero."""


@dataclass(frozen=True, eq=False)
class Structure:
    """What a model of a mechanism is, apart from its weights.

    learned: int64 ``[L]``, the components whose derivative is learned; source: int64 ``[n]``, the
    component whose value is the derivative of this one, -1 for none; ratio: float64 ``[n]``, the
    scale of the source divided by that of the component, 0 where there is no source.  ties: sums of
    terms that have one weight, None where each term has its own.
    """

    lift: Lift
    terms: Terms
    learned: np.ndarray
    source: np.ndarray
    ratio: np.ndarray
    ties: Ties | None = None

    @classmethod
    def of(cls, told: Told, lift: Lift, terms: Terms, ties: Ties | None = None) -> Structure:
        """The structure that ``told`` describes."""
        source = np.array(told.rate, dtype=np.int64)
        unit = np.array(told.unit, dtype=np.float64)
        return cls(
            lift=lift,
            terms=terms,
            learned=np.array(told.learned, dtype=np.int64),
            source=source,
            ratio=np.where(source >= 0, unit[source] / unit, 0.0),
            ties=ties,
        )

    @property
    def implicit(self) -> bool:
        """Whether some term has a factor f_j."""
        return bool((self.terms.derivative >= 0).any())

    @property
    def allowed(self) -> Tensor:
        """Bool ``[L, K]``: the weights that are not zero by definition."""
        if self.ties is not None:
            return torch.from_numpy((self.ties.allowed @ (self.ties.share != 0)) > 0)
        own = np.arange(len(self.learned))[:, None] == self.terms.derivative
        return torch.from_numpy(~own)

    @property
    def period(self) -> Tensor:
        """``[n]``: that of the components that are angles, 0 elsewhere, in scaled units."""
        return torch.from_numpy(np.where(self.lift.angle, 2 * np.pi / self.lift.unit, 0.0))

    def difference(self, end: Tensor, start: Tensor) -> Tensor:
        """end - start ``[*batch, n]``, the short way round the circle where it is an angle."""
        return wrapped(end - start, self.period)


def accelerations(structure: Structure, weight: Tensor, state: Tensor, action: Tensor) -> Tensor:
    """The learned derivatives f, ``[*batch, L]``, per second.

    weight ``[L, K]`` or ``[*batch, L, K]``, state ``[*batch, n]``, action ``[*batch, m]``, scaled.
    Not finite where I - N is singular.
    """
    phi = structure.terms(structure.lift(state, action))
    h, coupling = _parts(structure, weight, phi.unsqueeze(-1))
    return _solved(h, coupling.squeeze(-1)).squeeze(-1)


def coupled(structure: Structure, weight: Tensor, state: Tensor) -> Tensor:
    """I - N ``[*batch, L, L]``, with the action 0: of a mechanism its inertia, each row divided by
    its diagonal entry.  Arguments as for ``accelerations``."""
    phi = structure.terms(structure.lift.of_state(state))
    _, coupling = _parts(structure, weight, phi.unsqueeze(-1))
    eye = torch.eye(len(structure.learned), dtype=state.dtype)
    return (
        eye.expand(*state.shape[:-1], *eye.shape)
        if not structure.implicit
        else (eye - coupling.squeeze(-1))
    )


def acceleration_cov(
    structure: Structure, weight: Tensor, cov: Tensor, state: Tensor, action: Tensor
) -> Tensor:
    """Covariance ``[*batch, L, L]`` of the learned derivatives, from those of the weights of each
    ``[L, K, K]``, to first order: (I - N) df = dW phi f, and outputs are independent.

    Other arguments as for ``accelerations``.
    """
    phi = structure.terms(structure.lift(state, action))
    h, coupling = _parts(structure, weight, phi.unsqueeze(-1))
    kind = torch.from_numpy(structure.terms.derivative)
    if structure.implicit:
        f = _solved(h, coupling.squeeze(-1)).squeeze(-1)
        held = torch.cat([torch.ones_like(f[..., :1]), f], dim=-1)
        phi = phi * held[..., kind + 1]
    variance = torch.einsum("...k,lkj,...j->...l", phi, cov, phi)
    root = _solved(torch.diag_embed(variance.clamp(min=_LEAST_VARIANCE).sqrt()), coupling[..., 0])
    return root @ root.mT


def state_derivative(structure: Structure, weight: Tensor, state: Tensor, action: Tensor) -> Tensor:
    """ds/dt ``[*batch, n]``, per second; arguments as for ``accelerations``."""
    f = accelerations(structure, weight, state, action)
    return _completed(structure, f.unsqueeze(-1), state.unsqueeze(-1)).squeeze(-1)


def derivative_jacobian(
    structure: Structure, weight: Tensor, state: Tensor, action: Tensor
) -> Tensor:
    """d (ds/dt) / d (s, u), ``[*batch, n, n + m]``: (I - N) df = dh + dN f.

    Arguments as for ``accelerations``.
    """
    lifted = structure.lift(state, action)
    slope = structure.terms.jacobian(lifted, structure.lift.jacobian(state, action))
    h, coupling = _parts(structure, weight, structure.terms(lifted).unsqueeze(-1))
    f = _solved(h, coupling.squeeze(-1))
    dh, moved = _parts(structure, weight, slope)
    if structure.implicit:
        dh = dh + (moved * f.unsqueeze(-3)).sum(-2)
    eye = torch.eye(state.shape[-1], slope.shape[-1], dtype=state.dtype)
    return _completed(structure, _solved(dh, coupling.squeeze(-1)), eye)


def runge_kutta(
    structure: Structure,
    weight: Tensor,
    state: Tensor,
    action: Tensor,
    seconds: Tensor | float,
    steps: int = 2,
) -> Tensor:
    """The state ``[*batch, n]`` after ``seconds`` (a number or ``[*batch]``) under a constant
    action, in ``steps`` equal steps of Runge and Kutta's method of fourth order."""
    return flow(lambda s: state_derivative(structure, weight, s, action), state, seconds, steps)


def runge_kutta_jacobian(
    structure: Structure,
    weight: Tensor,
    state: Tensor,
    action: Tensor,
    seconds: Tensor | float,
    steps: int = 2,
) -> Tensor:
    """Derivative of ``runge_kutta`` by (s, u), ``[*batch, n, n + m]``: the chain rule."""
    h = torch.as_tensor(seconds, dtype=state.dtype).unsqueeze(-1) / steps
    n, m = state.shape[-1], action.shape[-1]
    start = torch.eye(n, n + m, dtype=state.dtype).expand(*state.shape[:-1], n, n + m)
    for _ in range(steps):
        slope, turn = torch.zeros_like(state), torch.zeros_like(start)
        change, turned = slope, turn
        for part, share in ((0.0, 1 / 6), (0.5, 1 / 3), (0.5, 1 / 3), (1.0, 1 / 6)):
            at, moved = state + part * h * slope, start + part * h.unsqueeze(-1) * turn
            jacobian = derivative_jacobian(structure, weight, at, action)
            own = torch.cat([torch.zeros_like(jacobian[..., :n]), jacobian[..., n:]], dim=-1)
            turn = jacobian[..., :n] @ moved + own
            slope = state_derivative(structure, weight, at, action)
            change, turned = change + share * slope, turned + share * turn
        state, start = state + h * change, start + h.unsqueeze(-1) * turned
    return start


def _completed(structure: Structure, learned: Tensor, state: Tensor) -> Tensor:
    """ds/dt ``[*batch, n, p]`` from f ``[*batch, L, p]`` and s ``[*batch, n, p]``, or their
    derivatives: told rates are components of s times ``ratio``."""
    n = state.shape[-2]
    pick = torch.zeros(n, len(structure.learned), dtype=state.dtype)
    pick[torch.from_numpy(structure.learned), torch.arange(len(structure.learned))] = 1.0
    has = torch.from_numpy(np.flatnonzero(structure.source >= 0))
    told = torch.zeros(n, n, dtype=state.dtype)
    told[has, torch.from_numpy(structure.source)[has]] = torch.from_numpy(structure.ratio)[has]
    return pick @ learned + told @ state


def _parts(structure: Structure, weight: Tensor, phi: Tensor) -> tuple[Tensor, Tensor]:
    """Sums W phi over the terms of each kind, phi ``[*batch, K, p]``: without f ``[*batch, L, p]``,
    with f_j ``[*batch, L, J, p]`` (J = L, or 0 where no term has one)."""
    kind = torch.from_numpy(structure.terms.derivative)
    kinds = len(structure.learned) if structure.implicit else 0
    of_kind = kind == torch.arange(-1, kinds).unsqueeze(-1)
    split = (weight.unsqueeze(-2) * of_kind).flatten(-3, -2)
    # In this order one product of matrices, where the weights are the same for all rows.
    sums = (phi.mT @ split.mT).mT.unflatten(-2, (len(structure.learned), 1 + kinds))
    return sums[..., 0, :], sums[..., 1:, :]


def _solved(h: Tensor, coupling: Tensor) -> Tensor:
    """(I - N)^-1 h, h ``[*batch, L, p]``, N ``[*batch, L, J]``."""
    if coupling.shape[-1] == 0:
        return h
    matrix = torch.eye(h.shape[-2], dtype=h.dtype) - coupling
    return torch.linalg.solve_ex(matrix, h).result
