"""An inverse policy that lives in space: it wishes for accelerations of the hand."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from edtorch.inverse.coordinates import View
from edtorch.inverse.layout import Layout
from sims.kinematics import Chain

_NUDGE = 1e-3
"""Seconds between the poses of which a second difference is taken."""
_POSES = 256
"""Of which the mean is taken."""


class HandCoordinates:
    """y = (position of the chain's end / ``length``, slope of the hand, further joints), less its
    mean over the joints' ranges, those within pi of 0.

    Far from 0 a policy's state and its constant would tell nearly the same, and be learned slowly.

    The slope is the sum of the three joints ``bends`` (default: the second to the fourth), whose
    axes are parallel; the further joints are all but the first and the bends.  With dy = J dq, the
    upper rows of J being the chain's Jacobian, a wish w for ddy is granted by

        ddq = J' (J J' + damping^2 I)^-1 (w - dJ/dt dq),

    the damping being for poses in which J has no inverse.  length: m that count like a radian.

    A stretched arm may bend either way, and only one is within its range: J is taken with the
    second of the bends at least ``bent``, rad, to the side of the middle of its range.
    """

    def __init__(
        self,
        layout: Layout,
        chain: Chain,
        bends: Sequence[str] | None = None,
        *,
        length: float = 0.15,
        damping: float = 0.15,
        bent: float = 0.15,
    ) -> None:
        joints = list(layout.spec.tracked)
        bends = joints[1:4] if bends is None else list(bends)
        if len(bends) != 3 or not set(bends) <= set(joints[1:]):
            raise ValueError(
                f"bends={bends}: expected three of {', '.join(joints[1:])}, so that the hand has as"
                " many coordinates as there are joints"
            )
        for name, value in (("length", length), ("damping", damping), ("bent", bent)):
            if not value > 0:
                raise ValueError(f"{name}={value}: expected a number > 0")
        self.layout, self.chain = layout, chain
        self._length, self._damping = length, damping
        elbow = joints.index(bends[1])
        is_negative = bool(chain.low[elbow] + chain.high[elbow] < 0)
        self._most = torch.full((len(joints),), torch.inf, dtype=torch.float64)
        self._least = -self._most
        if is_negative:
            self._most[elbow] = -bent
        else:
            self._least[elbow] = bent
        rows = torch.zeros(len(joints) - 3, len(joints), dtype=torch.float64)
        rows[0, [joints.index(name) for name in bends]] = 1
        further = [k for k, name in enumerate(joints) if k > 0 and name not in bends]
        for row, k in enumerate(further, 1):
            rows[row, k] = 1
        self._rows = rows
        self._middle = torch.zeros(len(joints), dtype=torch.float64)
        generator = torch.Generator().manual_seed(0)
        share = torch.rand(_POSES, len(joints), generator=generator, dtype=torch.float64)
        low, high = chain.low.clamp(min=-math.pi), chain.high.clamp(max=math.pi)
        self._middle = self.place(low + (high - low) * share).mean(0)

    def place(self, angles: Tensor) -> Tensor:
        """y ``[*batch, n]``; angles ``[*batch, n]``, rad."""
        position = self.chain.forward(angles).position / self._length
        return torch.cat((position, angles @ self._rows.mT), -1) - self._middle

    def jacobian(self, angles: Tensor) -> Tensor:
        """J = dy/dq ``[*batch, n, n]``."""
        linear = self.chain.jacobian(angles)[..., :3, :] / self._length
        return torch.cat((linear, self._rows.expand(*linear.shape[:-2], -1, -1)), -2)

    def view(self, observation: Tensor) -> View:
        """See ``edtorch.inverse.coordinates.Coordinates``."""
        joints, goal = self.layout.split(observation)
        n, half = self.layout.joints, self.layout.size // 2
        q, dq = joints[..., :n], joints[..., half : half + n]
        here, wanted = self.place(torch.stack((q, goal))).unbind(0)
        rate = (self.jacobian(q) @ dq.unsqueeze(-1)).squeeze(-1)
        parts = (here, joints[..., n:half], rate, joints[..., half + n :])
        return View(torch.cat(parts, -1), wanted, joints)

    def joint_acceleration(self, view: View, wish: Tensor) -> Tensor:
        """See ``edtorch.inverse.coordinates.Coordinates``."""
        n, half = self.layout.joints, self.layout.size // 2
        q, dq = view.joints[..., :n], view.joints[..., half : half + n]
        q = torch.minimum(torch.maximum(q, self._least), self._most)
        step = _NUDGE * dq
        back, here, on = self.place(torch.stack((q - step, q, q + step))).unbind(0)
        lacking = wish - (on - 2 * here + back) / _NUDGE**2
        J = self.jacobian(q)
        eye = torch.eye(n, dtype=J.dtype)
        eased = torch.linalg.solve(J @ J.mT + self._damping**2 * eye, lacking)
        return (J.mT @ eased.unsqueeze(-1)).squeeze(-1)
