"""Policies whose targets are curves of a phase: gaits, and other motions that repeat.

The phase is where the motion is within a step, read off the positions: time does not enter, so a
disturbance does not leave the policy behind its clock (Westervelt, Grizzle & Koditschek 2003).
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from functools import cached_property
from typing import Any, final

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from edtorch.law import Arrays, Law
from edtorch.linalg import matvec
from edtorch.model.told import Told
from edtorch.policy.squash import Squash
from edtorch.policy.vector import VectorPolicy
from edtorch.types import Parameters


@dataclass(frozen=True)
class Followed:
    """A sum of positions that follows a curve of the phase.

    of: coefficients of the positions, by name; drives: of the actions, by name, by which the demand
    reaches them; stiffness (per unit), damping (s per unit): demand in parts of half the range of
    an action, as are ``drives``; points: the curve to begin a search from, the control points of a
    Bezier curve (one: a constant); spread: deviation of random points; feedback: gain to begin
    with, in s, of the rate of the phase on the target, None for none; spread_feedback: its
    deviation.
    """

    of: Mapping[str, float]
    drives: Mapping[str, float]
    stiffness: float
    damping: float
    points: Sequence[float]
    spread: float
    feedback: float | None = None
    spread_feedback: float = 0.0


@dataclass(frozen=True)
class PhaseGait:
    """phase: coefficients of the positions in the phase variable, by name; start, width: where on
    it the phase is 0, and how far from there it is 1, to begin a search from; spread: deviation of
    both; joints: what follows a curve, by name: the fields of ``Followed``."""

    phase: Mapping[str, float]
    start: float
    width: float
    spread: float
    joints: Mapping[str, Mapping[str, Any]]

    def __post_init__(self) -> None:
        """Reject invalid settings."""
        if not self.width > 0:
            raise ValueError(f"width={self.width}: expected a number > 0")
        known = [field.name for field in fields(Followed)]
        for name, node in self.joints.items():
            for key in node:
                if key not in known:
                    raise ValueError(f"joints.{name}.{key}: expected one of {', '.join(known)}")
            for key in ("of", "drives", "stiffness", "damping", "points", "spread"):
                if key not in node or node[key] == []:
                    raise ValueError(f"joints.{name}.{key}: no value given")
            if name in ("phase", "feedback"):
                raise ValueError(f"joints.{name}: expected another name; the parameter is taken")

    @cached_property
    def followed(self) -> Mapping[str, Followed]:
        """The joints."""
        return {name: Followed(**node) for name, node in self.joints.items()}

    @property
    def words(self) -> str:
        """See ``Gait``."""
        told = " + ".join(f"{value:g} {name}" for name, value in self.phase.items())
        return f"the gait's phase {told}, its gains and where it begins"

    def policy(self, told: Told, squash: Squash) -> PhasePolicy:
        """See ``Gait``."""
        return PhasePolicy(self, told.names, told.unit, told.rate, told.actions, squash)


@dataclass(frozen=True, eq=False)
class PhaseForm:
    """The numbers of a gait as kernels take them: n positions and rates, J joints, m actions.

    phase ``[2, n]``: the phase variable and its rate; joint, rate ``[J, n]``: of what follows;
    gain ``[J, 2]``: stiffness, damping; binomial ``[J, D]``: those of the curves, 0 beyond; place
    ``[J, 2]``: of the first point, and of the feedback, in the vector of parameters, -1 for none;
    drive ``[m, J]``.
    """

    phase: np.ndarray
    joint: np.ndarray
    rate: np.ndarray
    gain: np.ndarray
    binomial: np.ndarray
    place: np.ndarray
    drive: np.ndarray

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """In this order."""
        return (
            *(self.phase, self.joint, self.rate, self.gain),
            *(self.binomial, self.place, self.drive),
        )


@final
class PhasePolicy(VectorPolicy):
    """z = drive (stiffness (target - joint) - damping rate of the joint), where joints, phase are
    linear in the positions; target = sum_k binomial_k tau^k (1 - tau)^(d - k) point_k + feedback
    times the rate of the phase variable; tau = (phase variable - start) / width, within [0, 1].

    parameters: ``phase`` ``[B, 2]`` (start, width), the points of each joint ``[B, d + 1]`` under
    its name, ``feedback`` ``[B, F]`` of the joints that have it; in the units of ``unit`` ``[n]``,
    by which the states are scaled.

    names: of the components of the state; rate: index of each one's rate, -1 for none; actions:
    names.  Raises ValueError for unknown names.
    """

    kernel = "phase"

    def __init__(
        self,
        gait: PhaseGait,
        names: Sequence[str],
        unit: Sequence[float],
        rate: Sequence[int],
        actions: Sequence[str],
        squash: Squash,
    ) -> None:
        super().__init__(squash)
        self.gait = gait
        place, first = [], 2
        for joint in gait.followed.values():
            place.append([first, -1])
            first += len(joint.points)
        for own, joint in zip(place, gait.followed.values(), strict=True):
            if joint.feedback is not None:
                own[1], first = first, first + 1

        def rows(of: Mapping[str, float], where: str) -> tuple[np.ndarray, np.ndarray]:
            position, speed = np.zeros(len(names)), np.zeros(len(names))
            for name, factor in of.items():
                if name not in names or rate[names.index(name)] < 0:
                    known = ", ".join(n for n, r in zip(names, rate, strict=True) if r >= 0)
                    raise ValueError(
                        f"{where}.{name}: expected positions whose rates are read: {known}"
                    )
                i = names.index(name)
                position[i], speed[rate[i]] = factor * unit[i], factor * unit[rate[i]]
            return position, speed

        joints = gait.followed.items()
        each = [rows(joint.of, f"joints.{name}.of") for name, joint in joints]
        most = max(len(joint.points) for joint in gait.followed.values())
        binomial, drive = np.zeros((len(each), most)), np.zeros((len(actions), len(each)))
        for j, (name, joint) in enumerate(joints):
            d = len(joint.points) - 1
            binomial[j, : d + 1] = [math.comb(d, k) for k in range(d + 1)]
            for action, factor in joint.drives.items():
                if action not in actions:
                    raise ValueError(
                        f"joints.{name}.drives.{action}: expected names of {', '.join(actions)}"
                    )
                drive[actions.index(action), j] = factor
        self.form = PhaseForm(
            phase=np.stack(rows(gait.phase, "phase")),
            joint=np.stack([position for position, _ in each]),
            rate=np.stack([speed for _, speed in each]),
            gain=np.array([[j.stiffness, j.damping] for j in gait.followed.values()]),
            binomial=binomial,
            place=np.array(place, dtype=float),
            drive=drive,
        )

    @property
    def begun(self) -> tuple[Tensor, Tensor]:
        """See ``VectorPolicy``."""
        gait, joints = self.gait, self.gait.followed.values()
        fed = [joint for joint in joints if joint.feedback is not None]
        middle = [gait.start, gait.width, *(p for j in joints for p in j.points)]
        spread = [gait.spread] * 2 + [j.spread for j in joints for _ in j.points]
        middle += [float(j.feedback or 0.0) for j in fed]
        spread += [j.spread_feedback for j in fed]
        return torch.tensor(middle, dtype=torch.float64), torch.tensor(spread, dtype=torch.float64)

    @property
    def arrays(self) -> tuple[np.ndarray, ...]:
        """See ``VectorPolicy``."""
        return self.form.arrays

    @property
    def shapes(self) -> dict[str, tuple[int, ...]]:
        """See ``VectorPolicy``."""
        joints = self.gait.followed
        fed = sum(joint.feedback is not None for joint in joints.values())
        points = {name: (len(joint.points),) for name, joint in joints.items()}
        return {"phase": (2,), **points, **({"feedback": (fed,)} if fed else {})}

    def raw(self, parameters: Parameters, state: Tensor, /) -> Tensor:
        """See ``BoundedPolicy``."""
        form, vector = self._tensors, self.vector(parameters)
        phase, joint, rate, gain, binomial, _, drive = form
        now = matvec(phase, state)
        start, width = vector[..., 0], vector[..., 1]
        tau = ((now[..., 0] - start) / width).clamp(0.0, 1.0)
        targets = []
        for j, (first, fed) in enumerate(self.form.place.astype(int).tolist()):
            count = len(list(self.gait.followed.values())[j].points)
            target = torch.zeros_like(tau)
            for k in range(count):
                factor = binomial[j, k] * tau**k * (1 - tau) ** (count - 1 - k)
                target = target + factor * vector[..., first + k]
            if fed >= 0:
                target = target + vector[..., fed] * now[..., 1]
            targets.append(target)
        away = torch.stack(targets, dim=-1) - matvec(joint, state)
        return matvec(drive, gain[:, 0] * away - gain[:, 1] * matvec(rate, state))

    def raw_law(self, parameters: Arrays) -> Law:
        """See ``BoundedPolicy``."""
        phase, joint, rate, gain, binomial, place, drive = self.form.arrays
        vector = np.concatenate([parameters[name] for name in self.shapes])
        first, fed = place.astype(int).T
        up, counts = np.arange(binomial.shape[1]), (binomial > 0).sum(1, keepdims=True)
        down = np.maximum(counts - 1 - up, 0)
        # Beyond a joint's own points, and without feedback, the factor is zero: any index does.
        points = binomial * vector[np.minimum(first[:, None] + up, self.size - 1)]
        feedback = np.where(fed < 0, 0.0, vector[fed])
        start, width = vector[:2].tolist()

        def raw(state: NDArray[Any]) -> NDArray[Any]:
            now, speed = phase @ state
            tau = min(max((now - start) / width, 0.0), 1.0)
            target = (points * tau**up * (1 - tau) ** down).sum(-1) + feedback * speed
            return drive @ (gain[:, 0] * (target - joint @ state) - gain[:, 1] * (rate @ state))

        return raw

    @cached_property
    def _tensors(self) -> tuple[Tensor, ...]:
        return tuple(map(torch.from_numpy, self.form.arrays))
