"""Prior knowledge of a strike: an event at which rates jump and components may change names.

A strike happens where height(s) = sum_k height_k A_k(s), linear in entries of the lift, falls to
zero, such as that of a foot above the ground.  Components and actions that are swapped change
places, a counter grows by one, and rates jump (``edtorch.model.impact``).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from edtorch.errors import FitError
from edtorch.model.lift import Lift
from edtorch.model.mechanism import Structure
from edtorch.model.told import Told


@dataclass(frozen=True, eq=False)
class Strike:
    """The event, without its jump of the rates.

    height ``[A]``: of the entries of the lift, nan where they are to be learned; order int64
    ``[n]``, action_order int64 ``[m]``: component i is component order_i from before; jump ``[n]``:
    added to the state, scaled; counter: the component that counts strikes, -1 where none does.
    """

    height: np.ndarray
    order: np.ndarray
    action_order: np.ndarray
    jump: np.ndarray
    counter: int

    @classmethod
    def of(
        cls,
        told: Told,
        lift: Lift,
        *,
        height: Mapping[str, float] | None,
        swap: Mapping[str, str],
        counter: str | None = None,
    ) -> Strike:
        """A strike by names.

        height: {angle: length}, the sum of length cos(angle), in any unit; None to learn it.  swap:
        {a: b} of positions, whose rates follow them, and of actions.  counter: a component that
        counts.  Raises ValueError for names that are unknown or given twice, for heights that are
        all zero, and for a swap after which the height is another one but for its sign.
        """
        swapped = [name for pair in swap.items() for name in pair]
        for name in swapped:
            if swapped.count(name) > 1:
                raise ValueError(
                    f"told.strike.swap: {name!r} is given {swapped.count(name)} times; expected"
                    " each name once, with another one"
                )
        if height is not None and not any(height.values()):
            raise ValueError(
                f"told.strike.height={dict(height)}: expected lengths that are not all zero, or"
                " null to learn it"
            )
        order, actions = np.arange(len(told.names)), np.arange(len(told.actions))
        for pair in swap.items():
            into, names = (
                (actions, told.actions) if pair[0] in told.actions else (order, told.names)
            )
            i, j = (_place("told.strike.swap", name, names) for name in pair)
            into[i], into[j] = j, i
            if into is order and told.rate[i] >= 0:
                order[told.rate[i]], order[told.rate[j]] = told.rate[j], told.rate[i]
        entries, jump = np.zeros(lift.size), np.zeros(len(told.names))
        for name, length in (height or {}).items():
            i = _place("told.strike.height", name, told.names)
            if not told.angle[i]:
                raise ValueError(f"told.strike.height: {name!r} is no angle, expected angles")
            entries[lift.at[i] + 1] = length
        lengths = np.where(told.angle, entries[lift.at + 1], 0.0)
        after = lengths[order]
        if not (np.array_equal(after, lengths) or np.array_equal(after, -lengths)):
            swapped_height = {
                name: float(length)
                for name, length in zip(told.names, after, strict=True)
                if length
            }
            raise ValueError(
                f"told.strike.swap: makes the height {swapped_height} of {dict(height or {})};"
                " expected the same but for its sign, for it is zero before and after a strike"
            )
        counting = -1
        if counter is not None:
            counting = _place("told.strike.counter", counter, told.names)
            jump[counting] = 1.0 / told.unit[counting]
        found = cls(entries, order, actions, jump, counting)
        return found if height is not None else replace(found, height=entries * np.nan)

    def happened(self, state: Tensor, next_state: Tensor) -> Tensor:
        """Ticks ``[*batch]`` in which the counter changed, by at least half of its step.

        Raises ValueError where nothing counts.
        """
        if self.counter < 0:
            raise ValueError("told.strike.counter: expected a component that counts strikes")
        change = (next_state - state)[..., self.counter].abs()
        return change > 0.5 * float(self.jump[self.counter])

    def relabelled(self, state: Tensor) -> Tensor:
        """The state ``[*batch, n]`` after components have changed places, before rates jump."""
        return state[..., torch.from_numpy(self.order)]

    def with_height(self, structure: Structure, before: Tensor) -> Strike:
        """With the height learned from states ``[N, n]`` just before strikes, at which it is zero.

        Swapped components exchange the two ends, so that the height changes its sign: it is a sum
        of length (cos a - cos b) over pairs, the least singular vector of these at the strikes, of
        length 1 for the longest.  Its sign is such that it falls.  Raises FitError where there are
        fewer strikes than pairs.
        """
        lift = structure.lift
        pairs = [(i, j) for i, j in enumerate(self.order.tolist()) if i < j and bool(lift.angle[i])]
        if len(before) < len(pairs) or not pairs:
            raise FitError(
                f"told.strike.height: {len(before)} strikes, expected {max(1, len(pairs))} or more"
                " to learn it; tell it, or let more be tried first"
            )
        at = torch.from_numpy(lift.at)
        lifted = lift.of_state(before)
        first, second = (at[[pair[k] for pair in pairs]] + 1 for k in (0, 1))
        table = lifted[:, first] - lifted[:, second]
        length = torch.linalg.svd(table).Vh[-1]
        length = length / length[length.abs().argmax()]
        height = np.zeros(lift.size)
        height[first.numpy()], height[second.numpy()] = length.numpy(), -length.numpy()
        action = before.new_zeros(len(before), lift.actions)
        slope = lift.jacobian(before, action)[..., : lift.states]
        source = torch.from_numpy(structure.source)
        rates = torch.from_numpy(structure.ratio) * before[:, source.clamp(min=0)]
        falls = torch.einsum("a,nai,ni->n", torch.from_numpy(height), slope, rates).mean()
        return replace(self, height=-height if float(falls) > 0 else height)

    def of_state(self, lift: Lift, state: Tensor) -> Tensor:
        """The height ``[*batch]`` of states ``[*batch, n]``."""
        return lift.of_state(state) @ torch.from_numpy(self.height)


def _place(key: str, name: str, names: Sequence[str]) -> int:
    if name not in names:
        raise ValueError(f"{key}: {name!r} is unknown; expected one of {', '.join(names)}")
    return names.index(name)
