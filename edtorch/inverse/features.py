"""Features of an inverse model: products of subsets of the sines and cosines of all angles, the
other positions, all velocities, the desired accelerations and 1 (paper, section 5).

Each map takes a state s = (q, o, dq, do) of a ``Layout``, ``[*batch, 2 (n + p)]``, physical units,
and accelerations of the joints ``[*batch, n]``.  Velocities enter divided by their scales, and
accelerations by ``ACCELERATION``, so that all features are of order one, as a ridge wants it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Protocol

import torch
from torch import Tensor

from edtorch.inverse.layout import Layout

ACCELERATION = 10.0
"""What desired accelerations are divided by, rad/s^2."""


class InverseFeatures(Protocol):
    """phi(s, a): ``[*batch, 2 (n + p)], [*batch, n] -> [*batch, outputs]``."""

    @property
    def outputs(self) -> int:
        """How many there are."""
        ...

    def __call__(self, state: Tensor, acceleration: Tensor) -> Tensor:
        """The features."""
        ...


class Linear:
    """1, sines and cosines of all angles, the other positions, velocities, accelerations."""

    def __init__(self, layout: Layout) -> None:
        positions = layout.size // 2
        self._positions = positions
        self._angles = torch.tensor(layout.angles)
        plain = [k for k in range(positions) if k not in layout.angles]
        self._rest = torch.tensor([*plain, *range(positions, layout.size)])
        self._scale = layout.scale[self._rest]
        self.outputs = 1 + 2 * len(self._angles) + len(self._rest) + layout.joints

    def __call__(self, state: Tensor, acceleration: Tensor) -> Tensor:
        """See ``InverseFeatures``."""
        angle = state.index_select(-1, self._angles)
        parts = (
            torch.ones_like(state[..., :1]),
            angle.sin(),
            angle.cos(),
            state.index_select(-1, self._rest) / self._scale.to(state),
            acceleration / ACCELERATION,
        )
        return torch.cat(parts, -1)


class PairwiseProducts:
    """All products of two of ``Linear``'s features."""

    def __init__(self, layout: Layout) -> None:
        self._linear = Linear(layout)
        self._first, self._second = torch.triu_indices(self._linear.outputs, self._linear.outputs)
        self.outputs = len(self._first)

    def __call__(self, state: Tensor, acceleration: Tensor) -> Tensor:
        """See ``InverseFeatures``."""
        phi = self._linear(state, acceleration)
        return phi.index_select(-1, self._first) * phi.index_select(-1, self._second)


class Structured:
    """The products that equations of motion of a chain are made of.

    ``bends``: names of joints with parallel axes, in order (default: all but the first and the
    last); ``turn``: that of the joint that turns them all (default: the first).  With the angles
    theta_i of the links, the sums of the first i bends, whose sines and cosines e are sums of
    products of those of the joints:

    * inertia: {1, e e'} times {1, cos^2, sin cos of the turn} times the accelerations: where the
      base gives way, it does so along its own axes;
    * gravity and the base: {1, sin, cos of the turn} times {1, e} times {1, o, do};
    * velocities in pairs, times {1, e e'}; velocities; and ``Linear``'s features.
    """

    def __init__(
        self, layout: Layout, bends: Sequence[str] | None = None, turn: str | None = None
    ) -> None:
        joints = list(layout.spec.tracked)
        bends = joints[1:-1] if bends is None else list(bends)
        turn = joints[0] if turn is None else turn
        for argument, names in (("bends", bends), ("turn", [turn])):
            for name in names:
                if name not in joints or joints.index(name) not in layout.angles:
                    raise ValueError(
                        f"{argument}={name!r}: expected angles among {', '.join(joints)}"
                    )
        if not bends:
            raise ValueError("bends=[]: expected at least one joint")
        self._joints, self._size = layout.joints, layout.size
        self._positions = layout.size // 2
        self._scale = layout.scale
        self._bends = torch.tensor([joints.index(name) for name in bends])
        self._turn = joints.index(turn)
        self._linear = Linear(layout)
        links = 2 * len(bends)
        first, second = torch.triu_indices(links, links)
        # Of the squares cosines alone: with 1 among the features, the sines' follow from them.
        kept = ~((first == second) & (first >= len(bends)))
        self._first, self._second = first[kept], second[kept]
        self._rate_first, self._rate_second = torch.triu_indices(self._joints, self._joints)
        products, pairs = 1 + len(self._first), len(self._rate_first)
        base = 1 + 2 * layout.others
        self.outputs = (
            3 * products * self._joints
            + 3 * (1 + links) * base
            + products * pairs
            + self._linear.outputs
            - 1
        )

    def __call__(self, state: Tensor, acceleration: Tensor) -> Tensor:
        """See ``InverseFeatures``."""
        one = torch.ones_like(state[..., :1])
        scaled = state / self._scale.to(state)
        link = state.index_select(-1, self._bends).cumsum(-1)
        e = torch.cat((link.cos(), link.sin()), -1)
        square = e.index_select(-1, self._first) * e.index_select(-1, self._second)
        products = torch.cat((one, square), -1)
        yaw = state[..., self._turn, None]
        sine, cosine = yaw.sin(), yaw.cos()
        n, k = self._joints, self._positions
        base = torch.cat((one, scaled[..., n:k], scaled[..., k + n :]), -1)
        rates = scaled[..., k : k + n]
        first, second = (rates.index_select(-1, k) for k in (self._rate_first, self._rate_second))
        pulled = torch.cat((one, cosine.square(), sine * cosine), -1)
        driven = _outer(pulled, acceleration / ACCELERATION)
        held = _outer(torch.cat((one, sine, cosine), -1), torch.cat((one, e), -1))
        parts = (
            _outer(products, driven),
            _outer(held, base),
            _outer(products, first * second),
            self._linear(state, acceleration)[..., 1:],
        )
        return torch.cat(parts, -1)


def _outer(a: Tensor, b: Tensor) -> Tensor:
    return (a.unsqueeze(-1) * b.unsqueeze(-2)).flatten(-2)


INVERSE_FEATURES: Mapping[str, Callable[[Layout], InverseFeatures]] = {
    "linear": Linear,
    "pairwise": PairwiseProducts,
    "structured": Structured,
}
"""By name."""
