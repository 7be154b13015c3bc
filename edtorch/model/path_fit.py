r"""Fit of a mechanism's accelerations to readings: regression on features averaged along paths.

What a tick of dt seconds tells of a learned derivative f_l is its mean, y_l = (s'_l - s_l) / dt.
For a model linear in its weights that is the weights times the mean of the features along the
path,

    y_l = sum_k W_lk <phi_k f_derivative(k)> + e,   <x> = (1 / dt) \int_0^dt x(t) dt,

by Simpson's rule.  Features at the start of the tick stand for the mean only where little happens
in a tick; a pole turns by a radian.  The path is not measured:

- pass 1 goes without a model: what is learned is linear between its two readings, what it is the
  rate of is its integral, bent to meet both readings, and f_j is its measured mean;
- each later pass takes the path of the model of the pass before, from the first reading, bent to
  meet the second as well, with f_j shifted to have the measured mean.  What a linear bend adds to
  the rates is what the shift adds to f; half the error of each reading enters, not all of the
  first one's.

Each pass is a linear regression (``edtorch.model.evidence``).  Rows weigh less where they turn far
in a tick (pass 1: the bent path is wrong there) or fit badly (later, Cauchy's weights; Huber &
Ronchetti, "Robust statistics", 2009), or one violent trial breaks the fit.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from edtorch.errors import FitError, NonFiniteError
from edtorch.model.evidence import Evidence, Posterior, ard
from edtorch.model.mechanism import Structure, accelerations, runge_kutta
from edtorch.model.ties import tied
from edtorch.types import Transition

LEAST_ROWS = 3
"""Fewer transitions determine no noise."""
_FIRST_NODES, _NODES = 5, 7
"""Of Simpson's rule, in pass 1 and later."""
_TURN = 0.7
"""rad a tick at which a row weighs half in pass 1."""
_TAIL = 3.0
"""Standard deviations at which a row weighs half later."""
_WILD = 10.0
"""Those at which a reading bends a path by half."""
_FAR = 1e3
"""A path that comes this far from zero, in scaled units, is not used."""


@dataclass(frozen=True)
class _Paths:
    """State ``[nodes, N, n]`` and learned derivatives f ``[nodes, N, L]`` along N ticks."""

    state: Tensor
    f: Tensor


def fit_paths(
    structure: Structure, transition: Transition, passes: int = 4, evidence: Evidence = ard
) -> Posterior:
    """The posterior of the weights, after ``passes`` regressions.

    transition: N rows in any order, scaled units; dt ``[]`` or ``[N]``; rows that are not valid are
    left out.  Posterior.noise is the variance of y, per second squared; fallbacks counts rows whose
    own path was not finite in the last pass, for which that of pass 1 stood.  Raises NonFiniteError
    for readings that are not finite, FitError for fewer than ``LEAST_ROWS``, and where the
    numbers break.
    """
    if passes < 1:
        raise ValueError(f"passes={passes}: expected at least 1")
    data = usable(transition)
    if structure.ties is not None:
        evidence = tied(evidence, structure.ties)
    change = structure.difference(data.next_state, data.state)
    y = change[:, torch.from_numpy(structure.learned)] / data.dt.unsqueeze(-1)
    first = _regressors(structure, _interpolated(structure, data, change, y), data.action)
    share = 1 / (1 + (_turn(structure, data, change) / _TURN).pow(4))
    found = evidence(first, y.mT, share.expand(y.mT.shape), structure.allowed)
    for _ in range(passes - 1):
        paths = _own(structure, found.weight, data, y)
        own = _regressors(structure, paths, data.action)
        inside = (paths.state.abs() < _FAR).all(-1).all(0) & own.isfinite().all(-1)
        X = torch.where(inside.unsqueeze(-1), own, first)
        found = evidence(X, y.mT, _cauchy(y.mT - found.weight @ X.mT, _TAIL), structure.allowed)
        found = replace(found, fallbacks=int((~inside).sum()))
    return found


def usable(transition: Transition) -> Transition:
    """The valid rows, with dt ``[N]``; ValueErrors as for ``fit_paths``."""
    valid = transition.valid
    data = Transition(
        transition.state[valid],
        transition.action[valid],
        transition.next_state[valid],
        transition.dt.expand(valid.shape)[valid],
        valid[valid],
    )
    both = torch.cat([data.state, data.action, data.next_state, data.dt.unsqueeze(-1)], dim=-1)
    broken = torch.nonzero(~both.isfinite())
    if len(broken):
        row, column = broken[0].tolist()
        raise NonFiniteError(
            f"transitions: row {row}, column {column} of (state, action, next state, dt) is"
            f" {float(both[row, column])}, expected finite numbers"
        )
    if len(both) < LEAST_ROWS:
        raise FitError(f"transitions: got {len(both)}, expected at least {LEAST_ROWS} to fit")
    return data


def _turn(structure: Structure, data: Transition, change: Tensor) -> Tensor:
    """``[N]``: how far the fastest angle turns in a tick, rad, beyond half a turn if rates say
    so."""
    farthest = torch.zeros_like(data.dt)
    for i in structure.lift.angle.nonzero()[0]:
        source = int(structure.source[i])
        turned = change[:, i]
        if source >= 0:
            mean = (data.state[:, source] + data.next_state[:, source]) / 2
            turned = data.dt * float(structure.ratio[i]) * mean
        farthest = torch.maximum(farthest, (turned * float(structure.lift.unit[i])).abs())
    return farthest


def _interpolated(structure: Structure, data: Transition, change: Tensor, y: Tensor) -> _Paths:
    """Polynomials in t / dt: linear, and bent integrals of those."""
    coefficients: dict[int, list[Tensor]] = {}

    def of(i: int) -> list[Tensor]:
        """Of component i, lowest power first."""
        if i not in coefficients:
            start, source = data.state[:, i], int(structure.source[i])
            rates = [] if source < 0 else of(source)
            seconds = data.dt * float(structure.ratio[i])
            path = [start, *(seconds * c / (k + 1) for k, c in enumerate(rates))]
            path += [torch.zeros_like(start)] * (2 - len(path))
            path[1] = path[1] + start + change[:, i] - sum(path)
            coefficients[i] = path
        return coefficients[i]

    share = torch.linspace(0, 1, _FIRST_NODES, dtype=y.dtype).unsqueeze(-1)
    states = [
        sum((c * share**k for k, c in enumerate(of(i))), torch.zeros_like(share))
        for i in range(data.state.shape[-1])
    ]
    return _Paths(torch.stack(states, dim=-1), y.expand(_FIRST_NODES, *y.shape))


def _own(structure: Structure, weight: Tensor, data: Transition, y: Tensor) -> _Paths:
    """The model's own paths from the first readings, bent to meet the second, as far as these are
    to be trusted: a wild reading bends nothing."""
    states = [data.state]
    for _ in range(_NODES - 1):
        part = data.dt / (_NODES - 1)
        states.append(runge_kutta(structure, weight, states[-1], data.action, part, steps=1))
    missed = structure.difference(data.next_state, states[-1])
    share = torch.linspace(0, 1, _NODES, dtype=y.dtype)[:, None, None]
    trust = _cauchy(missed.mT, _WILD).amin(0).unsqueeze(-1)
    state = torch.stack(states) + share * trust * missed
    f = accelerations(structure, weight, state, data.action.expand(_NODES, *data.action.shape))
    return _Paths(state, f + y - _mean(f))


def _regressors(structure: Structure, paths: _Paths, action: Tensor) -> Tensor:
    """<phi_k f_derivative(k)>, ``[N, K]``."""
    action = action.expand(len(paths.state), *action.shape)
    phi = structure.terms(structure.lift(paths.state, action))
    factor = torch.cat([torch.ones_like(phi[..., :1]), paths.f], dim=-1)
    return _mean(phi * factor[..., torch.from_numpy(structure.terms.derivative) + 1])


def _mean(nodes: Tensor) -> Tensor:
    """By Simpson's composite rule, over the first axis."""
    weight = torch.full(nodes.shape[:1], 2.0, dtype=nodes.dtype)
    weight[1::2], weight[0], weight[-1] = 4.0, 1.0, 1.0
    return torch.einsum("q,q...->...", weight / weight.sum(), nodes)


def _cauchy(residual: Tensor, tail: float) -> Tensor:
    """Weights ``[p, N]`` from errors, a half at ``tail`` standard deviations, each 1.48 times the
    median of the size, as it is of normal numbers."""
    deviation = 1.48 * residual.abs().nanmedian(dim=-1, keepdim=True).values
    least = math.sqrt(torch.finfo(residual.dtype).tiny)
    return 1 / (1 + (residual / (tail * deviation).clamp(min=least)).square())
