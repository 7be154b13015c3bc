"""The tick of ``edtorch.rivals.sarsa`` as one compiled loop."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import torch
from torch import Tensor

from edtorch.compiled import load_kernel
from edtorch.native.plan import KernelPlan
from edtorch.native.source import source_of
from edtorch.native.worlds import plan_of_world
from edtorch.rewards import QuadraticReward
from edtorch.run.scaled_sim import World

BoxTable = tuple[int, Sequence[tuple[int, int, Tensor]]]
"""First row of a table, and of each component: which it is, rows of a step, edges (scaled)."""


def sarsa_plan(world: World, reward: QuadraticReward, numbers: Mapping[str, float]) -> KernelPlan:
    """Raises NoKernel."""
    plan = plan_of_world(world, {}, {"CHOICE": 1})
    plan.numbers |= {
        "STATE_COST": reward.state_cost,
        "ACTION_COST": reward.action_cost,
        **numbers,
    }
    return plan


class SarsaKernel:
    """Compiled ticks of S seeds; one tick of ``edtorch.rivals.sarsa`` after the other, to rounding.

    actions ``[A, m]``: as they act, scaled; rates ``[T]``; key ``[S, 2]``; numbers: of the method,
    as ``edtorch/native/kernels/sarsa.py`` names them.
    """

    def __init__(
        self,
        world: World,
        reward: QuadraticReward,
        tables: Sequence[BoxTable],
        actions: Tensor,
        rates: Tensor,
        key: Tensor,
        numbers: Mapping[str, float],
    ) -> None:
        """Compile, or fetch what has been compiled before.  Raises NoKernel or Unavailable."""
        plan = sarsa_plan(world, reward, numbers)
        self._size = plan.constants
        source, number, constants = source_of(plan, world.sim, 1)
        edges = [own for _, parts in tables for _, _, own in parts]
        ends = np.cumsum([0, *map(len, edges)])
        places = [(t, *part[:2]) for t, (_, parts) in enumerate(tables) for part in parts]
        self._before = (
            np.zeros(plan.constants["SCRATCH"]),
            number,
            constants,
            np.zeros((1, 1, world.uniforms)),
            np.zeros(len(actions)),
            np.zeros(len(tables), np.int64),
            key.numpy(),
            actions.contiguous().numpy(),
        )
        self._after = (
            rates.numpy(),
            np.column_stack((np.array(places, np.int64), ends[:-1], ends[1:])),
            torch.cat(edges).numpy(),
            np.array([first for first, _ in tables], np.int64),
        )
        one = self._kept(0, 0)
        nothing = (np.zeros((0, 0)), np.zeros((0, 0, 0), np.int64), np.zeros((0, 0, 0)))
        rows, going, ended = np.zeros((0, 0), np.int64), np.zeros(0, np.bool_), one[1]
        arguments = (*one, *self._before, *nothing, rows, going, *self._after, ended, 0, 0)
        (self._run,) = load_kernel(source, {"sarsa": arguments}, f"Sarsa in {world.spec.name}")

    def _kept(self, seeds: int, clock: int) -> tuple[Any, Any]:
        counts = np.zeros((seeds, self._size["COUNTERS"]), np.int64)
        counts[:, self._size["ACTIVE"]], counts[:, self._size["BEGUN"]] = 1, clock
        return np.zeros((seeds, self._size["Z"])), counts

    def __call__(
        self,
        memory: Sequence[Tensor],
        moment: Sequence[Tensor],
        ended: Tensor,
        going: Tensor,
        clock: int,
        count: int,
    ) -> tuple[Tensor, ...]:
        """The moment ``count`` ticks after ``clock``: state ``[k, S]``, ticks ``[S]``, observation
        ``[n, S]``, rows ``[T, S]``, choice ``[S]``.

        memory: table ``[S rows A]``, visited and trace ``[S, T, K]``, which are changed in place,
        as ended ``[CHUNK, S]`` is.
        """
        c = self._size
        table, visited, trace = (part.numpy() for part in memory)
        state, ticks, seen, row, choice = (part.numpy() for part in moment)
        z, counts = self._kept(len(ticks), clock)
        world = slice(c["WORLD"], c["WORLD"] + c["WIDTH"])
        observation = slice(c["OBSERVATION"], c["OBSERVATION"] + c["N"])
        z[:, world], z[:, observation] = state.T, seen.T
        counts[:, c["BEGUN"]] -= ticks
        counts[:, c["CHOICE"]] = choice
        rows = row.T.copy()
        tables = table.reshape(len(ticks), -1)
        self._run(
            *(z, counts, *self._before, tables, visited, trace, rows, going.numpy()),
            *(*self._after, ended.numpy(), clock, count),
        )
        later = (
            *(z[:, world].T, clock + count - counts[:, c["BEGUN"]], z[:, observation].T),
            *(rows.T, counts[:, c["CHOICE"]]),
        )
        return tuple(torch.from_numpy(np.ascontiguousarray(part)) for part in later)
