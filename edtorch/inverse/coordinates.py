"""The coordinates that an inverse policy works in: those of the joints, or of the hand in space."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from torch import Tensor

from edtorch.inverse.layout import Layout


@dataclass(frozen=True)
class View:
    """An observation in coordinates.

    state ``[*batch, 2 (n + p)]`` and goal ``[*batch, n]``: (y, o, dy, do) and the wanted y;
    joints ``[*batch, 2 (n + p)]``: (q, o, dq, do).
    """

    state: Tensor
    goal: Tensor
    joints: Tensor


class Coordinates(Protocol):
    """A way to look at an observation."""

    def view(self, observation: Tensor) -> View:
        """A scaled observation ``[*batch, N]`` in these coordinates."""
        ...

    def joint_acceleration(self, view: View, wish: Tensor) -> Tensor:
        """Accelerations of the joints ``[*batch, n]`` that give y the acceleration ``wish``."""
        ...


@dataclass(frozen=True)
class JointCoordinates:
    """y = q: policy and goal live in the joints, as in the paper."""

    layout: Layout

    def view(self, observation: Tensor) -> View:
        """See ``Coordinates``."""
        state, goal = self.layout.split(observation)
        return View(state, goal, state)

    def joint_acceleration(self, view: View, wish: Tensor) -> Tensor:
        """The wish itself."""
        return wish
