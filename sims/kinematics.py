"""The one doorway to pytorch-kinematics: a chain of joints from a URDF file, batched.

``forward`` and ``jacobian`` may be differentiated by ``torch.func`` and by autograd, to any order;
``torch.func.vmap`` over them does not work, their own batch axes are for that.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType

import torch
from torch import Tensor

_STARTS = 8
"""Poses that inverse kinematics starts from."""
_POLISH = 3
"""Newton steps after it: each doubles the digits."""


def pytorch_kinematics() -> ModuleType:
    """pytorch-kinematics, or one line that says how to get it."""
    if importlib.util.find_spec("pytorch_kinematics") is None:
        raise ModuleNotFoundError(
            "sims.kinematics needs pytorch-kinematics, which is not installed; expected:"
            " pip install -c constraints.txt -e '.[cardea]'"
        )
    return importlib.import_module("pytorch_kinematics")


@dataclass(frozen=True)
class Pose:
    """Where a link is: position ``[*batch, 3]``, m, and rotation ``[*batch, 3, 3]``, whose columns
    are the link's axes."""

    position: Tensor
    rotation: Tensor


@dataclass(frozen=True)
class Solution:
    """Answers of inverse kinematics: angles ``[*batch, n]``, rad, and whether each of them
    (bool ``[*batch]``) reaches its pose within the joints' ranges; where not, angles are NaN."""

    angles: Tensor
    found: Tensor


class Chain:
    """The joints from link ``root`` to link ``end`` of the robot in file ``urdf``.

    Everything is in the frame of ``root``, in float64.  ``low``, ``high``: ranges of the joints for
    inverse kinematics (default: those of the file).
    """

    def __init__(
        self,
        urdf: Path | str,
        root: str,
        end: str,
        *,
        low: Sequence[float] | None = None,
        high: Sequence[float] | None = None,
    ) -> None:
        """Read the file."""
        self._pk = pk = pytorch_kinematics()
        text = Path(urdf).read_text(encoding="utf-8")
        try:
            chain = pk.build_serial_chain_from_urdf(text, end_link_name=end, root_link_name=root)
        except (KeyError, ValueError) as error:
            raise ValueError(f"root={root!r}, end={end!r}: expected links of {urdf}") from error
        self._chain = chain.to(dtype=torch.float64)
        self.joints: tuple[str, ...] = tuple(chain.get_joint_parameter_names())
        limits = torch.tensor(chain.get_joint_limits(), dtype=torch.float64)
        self.low, self.high = limits
        for name, given in (("low", low), ("high", high)):
            if given is not None:
                if len(given) != len(self.joints):
                    raise ValueError(f"{name}={list(given)}: expected {len(self.joints)} angles")
                setattr(self, name, torch.tensor(given, dtype=torch.float64))
        self._moving, axes = [], []
        frames = chain.frame_to_idx
        for link in sorted(frames, key=frames.__getitem__):
            joint = self._chain.find_frame(link).joint
            if joint.joint_type == "fixed":
                continue
            if joint.joint_type != "revolute":
                raise ValueError(f"joint {joint.name}: expected revolute, not {joint.joint_type}")
            self._moving.append(frames[link])
            axes.append(joint.axis)
        self._axes = torch.stack(axes)
        self._end: int = frames[end]

    def forward(self, angles: Tensor) -> Pose:
        """The pose of ``end``; angles ``[*batch, n]``, rad."""
        pose = self._frames(angles)[self._end]
        return Pose(pose[..., :3, 3], pose[..., :3, :3])

    def jacobian(self, angles: Tensor) -> Tensor:
        """How the velocity of ``end``, m/s, and its angular velocity, rad/s, follow from the rates
        of the joints, ``[*batch, 6, n]``; angles ``[*batch, n]``.

        Column k is (z_k x (p - p_k), z_k), with the axis z_k of joint k and a point p_k of it.
        """
        frames = self._frames(angles)
        at = frames[self._moving]
        axes = torch.einsum("k...ij,kj->k...i", at[..., :3, :3], self._axes.to(angles))
        arms = frames[self._end][..., :3, 3] - at[..., :3, 3]
        columns = torch.cat((torch.linalg.cross(axes, arms), axes), -1)
        return columns.movedim(0, -1)

    def inverse(self, pose: Pose) -> Solution:
        """Angles that bring ``end`` to ``pose``: pytorch-kinematics' damped least squares from 8
        fixed poses, then Newton steps to 1e-9 m and rad."""
        batch = pose.position.shape[:-1]
        target = torch.zeros(*batch, 4, 4, dtype=torch.float64)
        target[..., :3, :3], target[..., :3, 3], target[..., 3, 3] = pose.rotation, pose.position, 1
        goal = self._pk.Transform3d(matrix=target.reshape(-1, 4, 4))
        generator = torch.Generator().manual_seed(0)
        share = torch.rand(_STARTS, len(self.joints), generator=generator, dtype=torch.float64)
        solver = self._pk.PseudoInverseIK(
            self._chain,
            retry_configs=self.low + (self.high - self.low) * share,
            joint_limits=torch.stack((self.low, self.high), -1),
            max_iterations=60,
            lr=0.4,
        )
        found = solver.solve(goal).solutions.detach()
        wanted = target.reshape(-1, 1, 4, 4)
        for _ in range(_POLISH):
            error = self._error(found, wanted)
            # The joints may be fewer than six, and their columns nearly dependent.
            found = (
                found + torch.linalg.lstsq(self.jacobian(found), error[..., None]).solution[..., 0]
            )
        miss = self._error(found, wanted).abs().amax(-1)
        inside = ((found >= self.low - 1e-9) & (found <= self.high + 1e-9)).all(-1)
        miss = torch.where(inside & miss.isfinite(), miss, torch.inf)
        best = miss.argmin(-1, keepdim=True)
        angles = found.gather(1, best[..., None].expand(-1, 1, found.shape[-1]))[:, 0]
        right = (miss.gather(1, best) < 1e-7)[:, 0]
        angles = torch.where(right[:, None], angles, torch.nan)
        return Solution(angles.reshape(*batch, -1), right.reshape(batch))

    def level(self, position: Tensor) -> Solution:
        """Angles that bring ``end`` to ``position`` ``[*batch, 3]``, m, and hold it level: its z
        along that of ``root``, its x pointing away from the first joint, which turns about z."""
        away = (
            position - self._frames(torch.zeros(len(self.joints)).double())[self._moving[0], :3, 3]
        )
        yaw = torch.atan2(away[..., 1], away[..., 0])
        zero, one = torch.zeros_like(yaw), torch.ones_like(yaw)
        rows = (yaw.cos(), -yaw.sin(), zero, yaw.sin(), yaw.cos(), zero, zero, zero, one)
        return self.inverse(Pose(position, torch.stack(rows, -1).unflatten(-1, (3, 3))))

    def _frames(self, angles: Tensor) -> Tensor:
        """Of all links, ``[F, *batch, 4, 4]``."""
        n = len(self.joints)
        if angles.shape[-1] != n:
            raise ValueError(f"angles: shape {tuple(angles.shape)}, expected [*batch, {n}]")
        # Its analytical gradient is an autograd function that torch.func refuses.
        frames = self._chain.forward_kinematics_tensor(angles.reshape(-1, n), analytical_grad=False)
        return frames.reshape(len(frames), *angles.shape[:-1], 4, 4)

    def _error(self, angles: Tensor, wanted: Tensor) -> Tensor:
        """What is lacking, position and small rotation ``[*batch, 6]``."""
        pose = self.forward(angles)
        turn = wanted[..., :3, :3] @ pose.rotation.mT
        vector = torch.stack(
            (
                turn[..., 2, 1] - turn[..., 1, 2],
                turn[..., 0, 2] - turn[..., 2, 0],
                turn[..., 1, 0] - turn[..., 0, 1],
            ),
            -1,
        )
        # Half the vector is the sine of the angle: the trace tells small ones from those near pi.
        away = (3 - turn.diagonal(dim1=-2, dim2=-1).sum(-1, keepdim=True)).clamp(min=0)
        far = torch.where(away > 2, torch.inf, 0.5 * vector)
        return torch.cat((wanted[..., :3, 3] - pose.position, far), -1)
