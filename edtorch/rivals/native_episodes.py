"""Episodes of linear policies as one compiled loop."""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import Any

import numpy as np
import torch
from torch import Tensor

from edtorch.compiled import load_kernel
from edtorch.native.plan import KernelPlan, NoKernel, add_policy
from edtorch.native.source import source_of
from edtorch.native.worlds import plan_of_world
from edtorch.policy.policies import LinearPolicy
from edtorch.rewards.base import quadratic_form_of
from edtorch.rivals.episodes import Accumulator, Ended
from edtorch.run.scaled_sim import World

EPISODE_LANES = 16
"""Episodes at a time; their digits do not depend on it."""
_TICKS = 1_000_000
"""Of all lanes together, from one piece to the next: a fraction of a second."""


def episodes_plan(
    world: World, policy: LinearPolicy, accumulator: Accumulator | None, limit: int
) -> KernelPlan:
    """Of such episodes.  Raises NoKernel."""
    m, features = policy.weight.shape
    deviation = 0.0 if accumulator is None else accumulator.deviation
    summed = sum(map(math.prod, shapes_of(accumulator)))
    plan = plan_of_world(world, {"THETA": m * features, "SUMS": summed}, {"EPISODE": 1, "KEY": 2})
    add_policy(plan, policy)
    plan.constants |= {
        # An angle is that of the moment, whatever it was before.
        **dict.fromkeys(("LIMITED", "ANNEALED", "UNWRAPS"), 0),
        "EXPLORES": int(deviation > 0),
        "PAIRS": (m + 1) // 2 if deviation > 0 else 0,
        "SUMMED": summed,
        **dict.fromkeys(("AGE", "LIMIT"), 0),
    }
    plan.chosen["add"] = "no_sums" if accumulator is None else accumulator.kernel
    plan.numbers |= {"LIMIT_TICKS": limit, "DEVIATION": [deviation, deviation, 1.0]}
    if accumulator is not None:
        _add_reward(plan, accumulator)
    return plan


def shapes_of(accumulator: Accumulator | None) -> list[torch.Size]:
    """Of the sums of one episode."""
    return [] if accumulator is None else [part.shape[1:] for part in accumulator.begin(0)]


def _add_reward(plan: KernelPlan, accumulator: Accumulator) -> None:
    form = quadratic_form_of(accumulator.reward)
    if form is None:
        raise NoKernel("a reward that is not quadratic")
    plan.numbers |= {
        "RETURN_STATE": form.state,
        "RETURN_ACTION": form.action,
        "RETURN_CROSS": form.cross,
        "RETURN_LINEAR": torch.cat([form.state_linear, form.action_linear]),
        "RETURN_CONSTANT": form.constant,
        **accumulator.numbers,
    }


class NativeEpisodes:
    """``edtorch.rivals.episodes.Episodes``, compiled; the same to rounding."""

    def __init__(
        self,
        world: World,
        policy: LinearPolicy,
        accumulator: Accumulator | None,
        limit: int,
        *,
        lanes: int = EPISODE_LANES,
    ) -> None:
        """Compile, or fetch what has been compiled before.  Raises NoKernel or Unavailable."""
        self.steps = 0
        plan = episodes_plan(world, policy, accumulator, limit)
        self._size = c = plan.constants
        self._lanes = lanes
        self._shapes = shapes_of(accumulator)
        self._drawn = (np.zeros((lanes, 1, world.uniforms)), np.zeros((lanes, 1, c["M"])))
        source, self._number, self._constants = source_of(plan, world.sim, lanes)
        nothing = self._places(
            np.zeros((0, c["M"] * c["KP"])), np.zeros((0, 2), np.int64), np.zeros((0, c["WIDTH"]))
        )
        what = f"episodes of {world.spec.name}"
        (self._run,) = load_kernel(source, {"episodes": (*nothing, 0, 0, 0, 0)}, what)

    def _places(self, weight: Any, key: Any, state: Any) -> tuple[Any, ...]:
        c, lanes, count = self._size, self._lanes, len(key)
        return (
            np.zeros(c["Z"] * lanes),
            np.zeros(c["COUNTERS"] * lanes, np.int64),
            np.zeros(c["SCRATCH"] * lanes),
            self._number,
            self._constants,
            *self._drawn,
            weight,
            key,
            state,
            np.zeros((count, 2), np.int64),
            np.zeros((count, c["SUMMED"])),
            np.zeros(count, np.int64),
        )

    def pieces(self, weight: Tensor, key: Tensor, start: Tensor) -> Iterator[Ended]:
        """See ``Episodes``."""
        copies = (x.detach().flatten(1).contiguous().numpy().copy() for x in (weight, key, start))
        places = self._places(*copies)
        state, ended, sums, order = places[-4:]
        begun = done = clock = 0
        count = max(1, _TICKS // self._lanes)
        while done < len(key):
            before = done
            begun, done, made = self._run(*places, begun, done, clock, count)
            clock += count
            self.steps += made
            rows = order[before:done]
            number, kept, found, added = (
                torch.from_numpy(part[rows] if part is not order else rows.copy())
                for part in (order, state, ended, sums)
            )
            yield Ended(number, found[:, 0], found[:, 1], kept, self._split(added))

    def _split(self, sums: Tensor) -> tuple[Tensor, ...]:
        found, first = [], 0
        for shape in self._shapes:
            last = first + math.prod(shape)
            found.append(sums[:, first:last].reshape(len(sums), *shape))
            first = last
        return tuple(found)
