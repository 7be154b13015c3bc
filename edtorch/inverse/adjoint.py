"""The value of a bounded linear policy in a loop that is linear but for sines and cosines.

    t = tanh(K s + c)  (or K s + c),   s' = L (s, sin s_A, cos s_A, t) + l,
    V = -sum_tau w_tau |q_tau - g|^2,  tau = 1..T,  q the first n components of s.

A step is two products of matrices, and so is its adjoint, which is written out here: autograd takes
five times as long.
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
    """The value and its derivatives; state ``[B, M, S]``, goal g ``[B, M, n]``, weights w."""
    size, n, m = state.shape[-1], goal.shape[-1], loop.gains.shape[-2]
    count, angles = len(loop.angles), loop.angles
    step_t, gains_t = loop.step.mT.contiguous(), loop.gains.mT.contiguous()
    path: list[Tensor] = []
    s, distance = state, []
    value = state.new_zeros(state.shape[:-1])
    for w in weights:
        drive = torch.baddbmm(loop.offset, s, gains_t)
        t = drive.tanh() if loop.bounded else drive
        angle = s.index_select(-1, angles)
        x = torch.cat((s, angle.sin(), angle.cos(), t), -1)
        path.append(x)
        s = torch.baddbmm(loop.shift, x, step_t)
        away = s[..., :n] - goal
        distance.append(away)
        value = value - w * away.square().sum(-1)

    costate = torch.zeros_like(state)
    drives: list[Tensor] = []
    for w, x, away in zip(reversed(weights), reversed(path), reversed(distance), strict=True):
        costate[..., :n] -= (2 * w) * away
        pulled = costate @ loop.step
        by_state, by_sine, by_cosine, by_t = pulled.split((size, count, count, m), -1)
        sine, cosine, t = x[..., size:].split((count, count, m), -1)
        by_drive = by_t * (1 - t * t) if loop.bounded else by_t
        drives.append(by_drive)
        costate = torch.baddbmm(by_state, by_drive, loop.gains)
        costate.index_add_(-1, angles, by_sine * cosine - by_cosine * sine)

    states = torch.cat([x[..., :size] for x in path], -2)
    by_gains = torch.cat(drives[::-1], -2).mT @ states
    return Adjoint(value, by_gains, torch.stack(drives).sum(0))
