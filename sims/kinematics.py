"""The one doorway to pytorch-kinematics: a chain of joints from a URDF file, batched.

``sims.urdf`` reads the file and ``sims.inverse_kinematics`` solves the inverse problem: the
library's reader rounds to float32, and its solver fails for a whole batch if one start diverges.

``forward`` and ``jacobian`` may be differentiated by ``torch.func`` and by autograd, to any order;
``torch.func.vmap`` over them does not work: use their batch axes.
"""

from __future__ import annotations

import importlib
import importlib.util
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import torch
from torch import Tensor

from sims.inverse_kinematics import solve
from sims.urdf import Drive, Joint, Robot

_TOLERANCE = 1e-7
"""Largest error of an answer of inverse kinematics, m and rad."""
_ENOUGH = 1e-10
"""The error at which it stops, m and rad."""
_SKEW = 1e-4
"""Largest entry of R R' - I accepted in a rotation matrix R."""
_NEARLY = 0.01
"""A range this much short of a whole turn, rad, still counts as one: +-3.14 for +-pi."""
_FAR = 1e9
"""Farthest target that is tried for a slide without limits, m."""


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
    """Answers of inverse kinematics: joint positions ``[*batch, n]``, rad or m, and whether they
    reach the pose within the joints' ranges (bool ``[*batch]``); where not, they are NaN."""

    angles: Tensor
    found: Tensor


class Chain:
    """The joints from link ``root`` to link ``end`` of the robot in file ``urdf``.

    Everything is in the frame of ``root``, in float64.  ``joints`` names the independent joints; a
    joint that mimics another follows it, even if that one is not on the path.  ``low``, ``high``:
    ranges of the joints, rad or m, for inverse kinematics (default: those of the file; infinite for
    a continuous joint).
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
        """Read the file; ValueError, in one line, if it cannot be used."""
        pk = pytorch_kinematics()
        robot = Robot(urdf)
        path = robot.between(root, end)
        moving = [joint for joint in path if joint.kind != "fixed"]
        drives = [robot.drive(joint.name) for joint in moving]
        if not drives:
            raise ValueError(
                f"root={root!r}, end={end!r}: expected a moving joint between them in {urdf}"
            )
        self.joints: tuple[str, ...] = tuple(dict.fromkeys(drive.source for drive in drives))
        self.low, self.high = _ranges(urdf, drives, {"low": low, "high": high})
        self._gain = torch.zeros(len(drives), len(self.joints), dtype=torch.float64)
        self._offset = torch.tensor([drive.offset for drive in drives], dtype=torch.float64)
        # An upper bound of the distance of ``end`` from ``root``, m.
        self._reach = sum(float(joint.origin[:3, 3].norm()) for joint in path)
        self._turning = self.high - self.low > 2 * math.pi - _NEARLY
        for row, (joint, drive) in enumerate(zip(moving, drives, strict=True)):
            column = self.joints.index(drive.source)
            self._gain[row, column] = drive.gain
            if joint.kind == "prismatic":
                ends = (float(self.low[column]), float(self.high[column])) if drive.gain else (0.0,)
                self._reach += max(abs(drive.gain * end + drive.offset) for end in ends)
            # Through a gear, a whole turn of the joint need not be one of what it moves.
            if joint.kind == "prismatic" or drive.gain % 1 != 0:
                self._turning[column] = False
        self._reach = min(self._reach * (1 + 1e-6) + 1e-6, _FAR)
        # Frame 0 is the root's.
        self._first = 1 + path.index(moving[0])
        try:
            self._chain = _serial(pk, root, path)
        except RecursionError:
            raise ValueError(
                f"root={root!r}, end={end!r}: {len(path)} joints between them in {urdf}; expected"
                " at most about a hundred, the depth that pytorch-kinematics supports"
            ) from None

    def forward(self, angles: Tensor) -> Pose:
        """The pose of ``end``; angles ``[*batch, n]``, rad, and m where a joint slides."""
        pose = self._frames(angles)[-1]
        return Pose(pose[..., :3, 3], pose[..., :3, :3])

    def jacobian(self, angles: Tensor) -> Tensor:
        """How the velocity of ``end``, m/s, and its angular velocity, rad/s, follow from the rates
        of the joints, ``[*batch, 6, n]``; angles ``[*batch, n]``.

        Column k is (z_k x (p - p_k), z_k), with the axis z_k of joint k and a point p_k of it, or
        (z_k, 0) if it slides; the columns of joints that mimic it are added, times their gains.
        """
        return self._jacobian(self._frames(angles))

    def inverse(self, pose: Pose) -> Solution:
        """Joint positions that bring ``end`` to ``pose``, by damped least squares from up to 64
        fixed starts, to 1e-7 m and rad, or to the precision of a ``pose`` in float32.

        Joints that can turn all the way are answered within pi of 0, where their ranges allow.
        A target that is not finite, not a rotation or out of reach is not found.
        """
        batch = torch.broadcast_shapes(pose.position.shape[:-1], pose.rotation.shape[:-2])
        if pose.position.shape[-1:] != (3,) or pose.rotation.shape[-2:] != (3, 3):
            raise ValueError(
                f"pose: shapes {tuple(pose.position.shape)} and {tuple(pose.rotation.shape)},"
                " expected [*batch, 3] and [*batch, 3, 3]"
            )
        targets = torch.eye(4, dtype=torch.float64).repeat(*batch, 1, 1)
        targets[..., :3, 3], targets[..., :3, :3] = pose.position.detach(), pose.rotation.detach()
        targets = targets.reshape(-1, 4, 4)
        places = self._reachable(targets).nonzero()[:, 0]
        targets = targets[places]
        left, _, right = torch.linalg.svd(targets[:, :3, :3])
        targets[:, :3, :3] = left @ right

        def kinematics(joints: Tensor) -> tuple[Tensor, Tensor]:
            frames = self._frames(joints)
            return frames[-1], self._jacobian(frames)

        of_pose = (
            torch.finfo(torch.result_type(t, 1.0)).eps for t in (pose.position, pose.rotation)
        )
        coarse = 10 * max(of_pose)
        enough = max(_ENOUGH, coarse)
        joints, miss = solve(kinematics, targets, self.low, self.high, self._turning, enough)
        reached = miss < max(_TOLERANCE, coarse)
        found = torch.zeros(batch.numel(), dtype=torch.bool)
        angles = torch.full((batch.numel(), len(self.joints)), torch.nan, dtype=torch.float64)
        found[places[reached]] = True
        angles[places[reached]] = joints[reached]
        return Solution(angles.reshape(*batch, len(self.joints)), found.reshape(batch))

    def level(self, position: Tensor) -> Solution:
        """Angles that bring ``end`` to ``position`` ``[*batch, 3]``, m, and hold it level: its z
        along that of ``root``, its x pointing away from the first joint, which turns about z."""
        away = position[..., :2] - self._frames(torch.zeros(len(self.joints)))[self._first, :2, 3]
        yaw = torch.atan2(away[..., 1], away[..., 0])
        zero, one = torch.zeros_like(yaw), torch.ones_like(yaw)
        rows = (yaw.cos(), -yaw.sin(), zero, yaw.sin(), yaw.cos(), zero, zero, zero, one)
        return self.inverse(Pose(position, torch.stack(rows, -1).unflatten(-1, (3, 3))))

    def _frames(self, angles: Tensor) -> Tensor:
        """Of the links on the path, ``[F, *batch, 4, 4]``."""
        n = len(self.joints)
        if angles.shape[-1:] != (n,):
            raise ValueError(f"angles: shape {tuple(angles.shape)}, expected [*batch, {n}]")
        positions = angles.reshape(-1, n).double() @ self._gain.mT + self._offset
        # Its analytical gradient is an autograd function that torch.func refuses.
        frames = self._chain.forward_kinematics_tensor(positions, analytical_grad=False)
        return frames.reshape(len(frames), *angles.shape[:-1], 4, 4)

    def _jacobian(self, frames: Tensor) -> Tensor:
        flat = frames.unsqueeze(1).flatten(1, -3)
        columns = self._chain.jacobian_tensor(None, all_transforms=flat)
        return (columns @ self._gain).reshape(*frames.shape[1:-2], 6, -1)

    def _reachable(self, targets: Tensor) -> Tensor:
        """Which targets ``[N, 4, 4]`` are finite poses, no farther than the chain's length."""
        position, rotation = targets[:, :3, 3], targets[:, :3, :3]
        skew = (rotation @ rotation.mT - torch.eye(3).double()).abs().amax((-2, -1))
        x, y, z = rotation.unbind(-1)
        # Comparisons with NaN are False.
        right_handed = (torch.linalg.cross(x, y) * z).sum(-1) > 0
        return (position.norm(dim=-1) <= self._reach) & (skew < _SKEW) & right_handed


def _ranges(
    urdf: Path | str, drives: Sequence[Drive], given: Mapping[str, Sequence[float] | None]
) -> tuple[Tensor, Tensor]:
    """``low`` and ``high``: those given, or else the file's."""
    sources = list(dict.fromkeys(drive.source for drive in drives))
    bounds: dict[str, list[float]] = {}
    for end, narrower in (("low", max), ("high", min)):
        numbers = given[end]
        if numbers is None:
            numbers = []
            for source in sources:
                all_of = [getattr(drive, end) for drive in drives if drive.source == source]
                if None in all_of:
                    raise ValueError(
                        f"{urdf}: joint {source!r}: expected <limit lower=... upper=...>, or type"
                        " continuous, or low and high to be given"
                    )
                numbers.append(narrower(all_of))
        elif len(numbers) != len(sources):
            raise ValueError(f"{end}={list(numbers)}: expected {len(sources)} numbers")
        bounds[end] = list(numbers)
    low, high = (torch.tensor(bounds[end], dtype=torch.float64) for end in ("low", "high"))
    for source, least, most in zip(sources, low.tolist(), high.tolist(), strict=True):
        if not least <= most:
            raise ValueError(
                f"{urdf}: joint {source!r}: range from {least} to {most}: expected low <= high"
            )
    return low, high


def _serial(pk: ModuleType, root: str, path: Sequence[Joint]) -> Any:
    """The library's chain, built in float64."""
    above = base = pk.frame.Frame(root, link=pk.frame.Link(root))
    for joint in path:
        offset = pk.Transform3d(matrix=joint.origin[None], dtype=torch.float64)
        frame = pk.frame.Frame(
            joint.child,
            link=pk.frame.Link(joint.child),
            joint=pk.frame.Joint(joint.name, offset, joint.kind, joint.axis, dtype=torch.float64),
        )
        above.add_child(frame)
        above = frame
    tree = pk.chain.Chain(base, dtype=torch.float64)
    return pk.chain.SerialChain(tree, above.name, dtype=torch.float64)
