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


@dataclass(frozen=True)
class Walk:
    """The steps tau = 0..T-1 from M states each.

    With x = (s, sin s_A, cos s_A, t) a step is s' = L x + l, and all that is bent in x comes from
    one product with s: h = (s_A, s_A + pi/2, K s + c).

    x ``[T, B, M, S + 2 A + m]``; state ``[T + 1, B, M, S]``: s of tau = 0..T; slope d(bent x)/dh
    ``[T, B, M, 2 A + m]``; bending dh/ds ``[B, 2 A + m, S]``.
    """

    x: Tensor
    state: Tensor
    slope: Tensor
    bending: Tensor


def walk(loop: Loop, state: Tensor, steps: int) -> Walk:
    """``steps`` steps from ``state`` ``[B, M, S]``.

    Here and in ``back`` an operation costs more to call than to compute: what can be is done for
    all steps at once, and the rest goes straight to its place.
    """
    size, count = state.shape[-1], len(loop.angles)
    waves = 2 * count
    taken = state.new_zeros(state.shape[0], waves, size)
    row = torch.arange(count, device=state.device)
    taken[:, row, loop.angles] = 1
    taken[:, count + row, loop.angles] = 1
    turn = state.new_zeros(*state.shape[:-1], waves)
    turn[..., count:] = 0.5 * torch.pi
    bending, offset = torch.cat((taken, loop.gains), -2), torch.cat((turn, loop.offset), -1)
    bending_t, step_t = bending.mT.contiguous(), loop.step.mT.contiguous()

    # Of the last x there is no more than its state.
    path = state.new_empty(steps + 1, *state.shape[:-1], loop.step.shape[-1])
    path[0, ..., :size] = state
    xs, here = path[:-1], path[..., :size].unbind(0)
    places = (xs, xs[..., size : size + waves], xs[..., size + waves :])
    h = torch.empty_like(offset)
    angle, drive = h[..., :waves], h[..., waves:]
    rows = zip(here[:-1], *(place.unbind(0) for place in places), here[1:], strict=True)
    for s, x, wave, t, following in rows:
        torch.baddbmm(offset, s, bending_t, out=h)
        torch.sin(angle, out=wave)
        if loop.bounded:
            torch.tanh(drive, out=t)
        else:
            t.copy_(drive)
        torch.baddbmm(loop.shift, x, step_t, out=following)

    sine, cosine, t = xs[..., size:].split((count, count, loop.gains.shape[-2]), -1)
    slope = torch.cat((cosine, -sine, 1 - t * t if loop.bounded else torch.ones_like(t)), -1)
    return Walk(xs, path[..., :size], slope, bending)


def back(loop: Loop, walked: Walk, pulls: Tensor, kicks: Tensor | None = None) -> Tensor:
    """dV/dh of each step ``[T, B, M, 2 A + m]``.

    pulls ``[T, B, M, S]``: how V depends on s of tau = 1..T for itself; kicks ``[T, B, M, 2 A +
    m]``: how on h of tau = 0..T-1, other than through the next state.
    """
    size = pulls.shape[-1]
    pulled = torch.empty_like(walked.x[0])
    by_state, by_bent = pulled[..., :size], pulled[..., size:]
    by_h = torch.zeros_like(walked.slope) if kicks is None else kicks.clone()
    steps = list(zip(pulls.unbind(0), walked.slope.unbind(0), by_h.unbind(0), strict=True))
    costate = torch.zeros_like(pulls[0])
    for pull, slant, found in reversed(steps):
        costate = costate + pull
        torch.bmm(costate, loop.step, out=pulled)
        found.addcmul_(by_bent, slant)
        costate = torch.baddbmm(by_state, found, walked.bending)
    return by_h


def distance(walked: Walk, goal: Tensor, weights: Sequence[float]) -> tuple[Tensor, Tensor]:
    """-sum_tau w_tau |q_tau - g|^2 ``[B, M]``, and its derivatives ``[T, B, M, S]`` by each s."""
    n = goal.shape[-1]
    w = torch.tensor(weights, dtype=goal.dtype, device=goal.device).reshape(-1, 1, 1, 1)
    away = walked.state[1:, ..., :n] - goal
    rest = walked.state.shape[-1] - n
    return -(w * away.square()).sum((0, -1)), torch.nn.functional.pad(-2 * w * away, (0, rest))


def of_learner(steps: Tensor) -> Tensor:
    """``[T, B, M, k]`` as rows of each learner ``[B, T M, k]``."""
    return steps.movedim(0, 1).flatten(1, 2)


def adjoint(loop: Loop, state: Tensor, goal: Tensor, weights: Sequence[float]) -> Adjoint:
    """The value and its derivatives; state ``[B, M, S]``, goal g ``[B, M, n]``, weights w."""
    walked = walk(loop, state, len(weights))
    value, pulls = distance(walked, goal, weights)
    drives = back(loop, walked, pulls)[..., -loop.gains.shape[-2] :]
    by_gains = of_learner(drives).mT @ of_learner(walked.state[:-1])
    return Adjoint(value, by_gains, drives.sum(0))
