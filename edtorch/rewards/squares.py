r"""Rewards as squares of what is linear in the lift, which planners take.

r_t(s, a) = -|R_t A(s)|^2 - sum_j w_j a_j^2,  A(s) = [1 | sin and cos of angles, else s_i | a]
"""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from edtorch.model.lift import Lift
from edtorch.rewards.base import Reward, quadratic_form_of
from edtorch.rewards.form import QuadraticForm


def squares_of(reward: Reward, lift: Lift, ticks: int) -> tuple[Tensor, Tensor]:
    """R ``[ticks + 1, r, A]`` and w ``[m]`` of a reward of scaled states and actions.

    A reward says them itself (``lifted_squares``, as ``edtorch.rewards.LiftedReward``), or has a
    quadratic form.  Squares of the deviation of an angle from its target then become those of the
    chord between them, which is the same to second order and has no seam.  Raises ValueError for
    any other reward.
    """
    offered = getattr(reward, "lifted_squares", None)
    if offered is not None:
        rows, action = offered(ticks)
        if rows.shape[-1] != lift.size:
            raise ValueError(
                f"{rows.shape[-1]} entries of the lift, expected {lift.size}; tell the reward the"
                " same angles (reward.angles) as the model (told.angles)"
            )
        return rows, action
    form = quadratic_form_of(reward)
    if form is None:
        raise ValueError(
            f"{type(reward).__name__}: expected a quadratic reward (state, action, target), or"
            " edtorch.rewards.LiftedReward, to plan with"
        )
    rows, action = _of_form(form, lift)
    return rows.expand(ticks + 1, *rows.shape), action


def _of_form(form: QuadraticForm, lift: Lift) -> tuple[Tensor, Tensor]:
    for name in ("cross", "action_linear"):
        if bool((getattr(form, name) != 0).any()):
            raise ValueError(f"{name}: expected none to plan with")
    action = torch.diagonal(form.action)
    if not torch.equal(torch.diag(action), form.action):
        raise ValueError("action: expected weights of squares alone to plan with")
    Q = form.state
    target = -torch.linalg.pinv(Q, hermitian=True) @ form.state_linear
    if not torch.allclose(Q @ target, -form.state_linear, atol=1e-9):
        raise ValueError("linear: expected weights of squares about a target to plan with")
    rows = []
    angle = torch.from_numpy(np.ascontiguousarray(lift.angle))
    for i in angle.nonzero().flatten().tolist():
        if bool((Q[i, torch.arange(len(Q)) != i] != 0).any()):
            raise ValueError("cross: expected none of an angle to plan with")
        if Q[i, i] == 0:
            continue
        unit, at = float(lift.unit[i]), int(lift.at[i])
        radians = target[i] * unit
        # |(sin, cos) - (sin, cos)*|^2 = (angle difference in rad)^2 to second order.
        weight = float(Q[i, i]) ** 0.5 / unit
        for entry, wanted in ((at, radians.sin()), (at + 1, radians.cos())):
            row = torch.zeros(lift.size, dtype=torch.float64)
            row[entry], row[0] = weight, -weight * wanted
            rows.append(row)
    plain = (~angle).nonzero().flatten()
    values, vectors = torch.linalg.eigh(Q[plain][:, plain])
    for value, vector in zip(values, vectors.mT, strict=True):
        if value <= 1e-12 * values.abs().max():
            continue
        row = torch.zeros(lift.size, dtype=torch.float64)
        row[torch.from_numpy(lift.at)[plain]] = value.sqrt() * vector
        row[0] = -value.sqrt() * (vector @ target[plain])
        rows.append(row)
    if not rows:
        raise ValueError("state: expected a weight > 0 to plan with")
    return torch.stack(rows), action.clone()
