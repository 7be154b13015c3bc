"""The value of a bounded linear policy in a loop that is linear but for sines and cosines.

    t = tanh(K s + c)  (or K s + c),   s' = L (s, sin s_A, cos s_A, t) + l,
    V = -sum_tau w_tau |q_tau - g|^2,  tau = 1..T,  q the first n components of s.

A step is two products of matrices, and so is its adjoint, which is written out here: autograd takes
many times as long.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor


@dataclass(frozen=True)
class Loop:
    """The closed loops of B learners, each from M states.

    step L ``[B, S, S + 2 A + m]``, shift l ``[B, 1, S]``, gains K ``[B, m, S]``, offset c
    ``[B, M, m]``; angles ``[A]`` int64: which components have sines; bounded: whether there is a
    tanh.
    """

    step: Tensor
    shift: Tensor
    gains: Tensor
    offset: Tensor
    angles: Tensor
    bounded: bool


@dataclass(frozen=True)
class Adjoint:
    """value ``[B, M]``; with y = K s + c: sum_tau dV/dy_tau s_tau' ``[B, m, S]``, summed over the M
    states, and sum_tau dV/dy_tau ``[B, M, m]``, from which dV/dTheta follows."""

    value: Tensor
    by_gains: Tensor
    by_offset: Tensor


def adjoint(loop: Loop, state: Tensor, goal: Tensor, weights: Sequence[float]) -> Adjoint:
    """The value and its derivatives; state ``[B, M, S]``, goal g ``[B, M, n]``, weights w.

    With x = (s, sin s_A, cos s_A, t) a step is s' = L x + l, and all that is bent in x comes from
    one product with s: h = (s_A, s_A + pi/2, K s + c).  Each operation costs more to call than to
    compute, so what can be is done for all steps at once, and the rest goes straight to its place.
    """
    size, n, m = state.shape[-1], goal.shape[-1], loop.gains.shape[-2]
    count = len(loop.angles)
    waves = 2 * count
    taken = state.new_zeros(state.shape[0], waves, size)
    row = torch.arange(count, device=state.device)
    taken[:, row, loop.angles] = 1
    taken[:, count + row, loop.angles] = 1
    turn = state.new_zeros(*state.shape[:-1], waves)
    turn[..., count:] = 0.5 * torch.pi
    bending, offset = torch.cat((taken, loop.gains), -2), torch.cat((turn, loop.offset), -1)
    bending_t, step_t = bending.mT.contiguous(), loop.step.mT.contiguous()

    # x of tau = 0..T; of the last there is no more than its state.
    path = state.new_empty(len(weights) + 1, *state.shape[:-1], loop.step.shape[-1])
    path[0, ..., :size] = state
    xs, here = path[:-1], path[..., :size].unbind(0)
    places = (xs, xs[..., size : size + waves], xs[..., size + waves :])
    h = torch.empty_like(offset)
    angle, drive = h[..., :waves], h[..., waves:]
    walk = zip(here[:-1], *(place.unbind(0) for place in places), here[1:], strict=True)
    for s, x, wave, t, following in walk:
        torch.baddbmm(offset, s, bending_t, out=h)
        torch.sin(angle, out=wave)
        if loop.bounded:
            torch.tanh(drive, out=t)
        else:
            t.copy_(drive)
        torch.baddbmm(loop.shift, x, step_t, out=following)

    w = torch.tensor(weights, dtype=state.dtype, device=state.device).reshape(-1, 1, 1, 1)
    away = path[1:, ..., :n] - goal
    value = -(w * away.square()).sum((0, -1))
    sine, cosine, t = xs[..., size:].split((count, count, m), -1)
    slope = torch.cat((cosine, -sine, 1 - t * t if loop.bounded else torch.ones_like(t)), -1)
    pulls = torch.nn.functional.pad(-2 * w * away, (0, size - n)).unbind(0)

    by_h = torch.empty_like(slope)
    costate = pulls[-1]
    pulled = torch.empty_like(path[0])
    by_state, by_bent = pulled[..., :size], pulled[..., size:]
    nothing = torch.zeros_like(pulls[0])
    back = zip((nothing, *pulls[:-1]), slope.unbind(0), by_h.unbind(0), strict=True)
    for pull, slant, found in reversed(list(back)):
        torch.bmm(costate, loop.step, out=pulled)
        torch.mul(by_bent, slant, out=found)
        costate = torch.baddbmm(pull + by_state, found, bending)

    drives, states = (part.movedim(0, 1).flatten(1, 2) for part in (by_h[..., waves:], xs))
    by_gains = drives.mT @ states[..., :size]
    return Adjoint(value, by_gains, by_h[..., waves:].sum(0))
