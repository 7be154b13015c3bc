"""Fresh episodes of finished policies, linear ones or those by a phase, as compiled loops.

``evaluate_policies`` is ``edtorch.run.evaluation.evaluate`` with a choice.  Compiled episodes
differ from the others by rounding.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from edtorch.compiled import load_kernel
from edtorch.errors import Unavailable
from edtorch.learner.learner import Actor
from edtorch.native.choice import Mode
from edtorch.native.plan import KernelPlan, NoKernel, add_policy, add_world, begun, place
from edtorch.native.source import source_of
from edtorch.native.vector import add_vector
from edtorch.policy.memory import EpisodeMemory
from edtorch.policy.vector import VectorPolicy
from edtorch.run import evaluation
from edtorch.run.episodes import Episode
from edtorch.run.evaluation import Watch, starts
from edtorch.run.random import BLOCK, Purpose, draw_block, stream_key
from edtorch.run.rollout import finished
from edtorch.run.scaled_sim import World
from edtorch.run.success import all_settled
from edtorch.types import Parameters

logger = logging.getLogger("edtorch")

TILE = 64
"""Episodes for which random numbers are held at a time."""


def evaluate_policies(
    policy: Actor,
    parameters: Parameters,
    world: World,
    seeds: Sequence[int],
    episodes: int,
    *,
    native: Mode = "auto",
    observer: EpisodeMemory | None = None,
    among: Sequence[Episode] = (),
    purpose: Purpose = Purpose.EVALUATION,
    watch: Watch | None = None,
    ticks: int | None = None,
) -> list[list[Episode]]:
    """As ``edtorch.run.evaluation.evaluate``; native: whether by kernels, by torch's number of
    threads, or by one where somebody watches.

    With ``on``, raises NoKernel where a part has none, and Unavailable where nothing can be
    compiled.
    """
    if native != "off":
        try:
            rides = Rides(policy, parameters, world, observer)
            return all_settled(rides.run(seeds, episodes, purpose, watch, ticks), among)
        except (NoKernel, Unavailable) as error:
            if native == "on":
                raise
            if isinstance(error, Unavailable):
                logger.warning("episodes are evaluated uncompiled: %s", error)
    return evaluation.evaluate(
        policy,
        parameters,
        world,
        seeds,
        episodes,
        observer=observer,
        among=among,
        purpose=purpose,
        watch=watch,
        ticks=ticks,
    )


class Rides:
    """Episodes of some policies in a world.

    An episode's digits do not depend on its company or on the number of threads.
    """

    def __init__(
        self,
        policy: Actor,
        parameters: Parameters,
        world: World,
        observer: EpisodeMemory | None = None,
    ) -> None:
        """parameters: ``[S, ...]``.  Raises NoKernel, and Unavailable."""
        if observer is not None:
            raise NoKernel("estimates of the state")
        self._world = world
        self._plan = plan = _plan(policy, parameters, world)
        self._own = _own(policy, parameters)
        self._limit = parameters.get("limit", torch.zeros(len(self._own), 0))
        rows = plan.rows
        assert rows is not None
        c, width = plan.constants, rows.width
        kept = {"THETA": c["OWN"], "LIMIT": c["N"], "WORLD": width}
        self._kept = place(plan, kept | {"OBSERVATION": c["N"], "EARNED": 1})
        self._counters = place(plan, dict.fromkeys(("ACTIVE", "BEGUN", "AGE"), 1))
        flags = dict.fromkeys(("VALID", "LIVES", "OUTCOME", "DEVIATE"), 1)
        self._scratch = place(plan, {"ACTION": c["M"], "NEXT": c["N"]} | flags)
        source, self._number, self._constants = source_of(plan, world.sim, 1)
        uniform = np.zeros((1, BLOCK, world.uniforms))
        arguments = (*self._memory(1), self._number, self._constants, uniform, np.arange(1))
        (self._rides,) = load_kernel(
            source, {"rides": (*arguments, 0, 0, 0)}, f"episodes of {world.spec.name}"
        )

    def _memory(self, size: int) -> tuple[NDArray[Any], ...]:
        """Memory for ``size`` episodes: numbers, counters, scratch, ends ``[size, 2]``."""
        counters = np.zeros((size, self._counters), dtype=np.int64)
        counters[:, self._plan.constants["ACTIVE"]] = 1
        ends = np.zeros((size, 2), dtype=np.int64)
        return np.zeros((size, self._kept)), counters, np.zeros(self._scratch), ends

    def run(
        self,
        seeds: Sequence[int],
        episodes: int,
        purpose: Purpose,
        watch: Watch | None = None,
        ticks: int | None = None,
    ) -> list[list[Episode]]:
        """The episodes of each policy, in order, of those that end within ``ticks``; whether they
        are a success may be open."""
        size, threads = len(seeds) * episodes, torch.get_num_threads()
        found: list[list[Episode]] = [[] for _ in seeds]
        if not size:
            return found
        share = size if watch is not None else min(TILE, -(-size // threads))
        tiles = [range(first, min(first + share, size)) for first in range(0, size, share)]

        def ridden(rows: range) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]:
            own = [divmod(row, episodes) for row in rows]
            keys = [stream_key(seeds[seed], purpose, number) for seed, number in own]
            policies, of = [seed for seed, _ in own], [seeds[seed] for seed, _ in own]
            return self._tile(policies, of, keys, watch, ticks)

        with ThreadPoolExecutor(threads) as pool:
            try:
                parts = list(pool.map(ridden, tiles) if len(tiles) > 1 else map(ridden, tiles))
            except BaseException:
                pool.shutdown(cancel_futures=True)
                raise
        start, final, ends, earned = map(
            torch.from_numpy, map(np.concatenate, zip(*parts, strict=True))
        )
        for ended in finished(self._world, start, final, ends[:, 0], ends[:, 1], earned):
            if ended is not None:
                row, number = divmod(ended.row, episodes)
                found[row].append(replace(ended, row=row, number=number))
        return found

    def _tile(
        self,
        policies: Sequence[int],
        seeds: Sequence[int],
        keys: Sequence[tuple[int, int]],
        watch: Watch | None,
        ticks: int | None,
    ) -> tuple[NDArray[Any], NDArray[Any], NDArray[Any], NDArray[Any]]:
        """Start, final state, (ticks, outcome) and return of an episode for each key."""
        memory, rows, drawing = self._memory(len(keys)), np.arange(len(keys)), self._world.uniforms
        z, _, _, ends = memory
        uniform, _ = draw_block(keys, drawing, 0, 0)
        start = starts(self._world, seeds, 1, torch.from_numpy(uniform[:, 0]))
        for name, values in (
            ("THETA", self._own[policies]),
            ("LIMIT", self._limit[policies]),
            ("WORLD", start),
            ("OBSERVATION", self._world.observe(start)),
        ):
            first = self._plan.constants[name]
            flat = values.detach().flatten(1).numpy()
            z[:, first : first + flat.shape[1]] = flat
        world, earned = (self._plan.constants[name] for name in ("WORLD", "EARNED"))
        state, clock = z[:, world : world + start.shape[-1]], 0
        last = math.inf if ticks is None else ticks
        while len(rows) and clock < last:
            block, row = divmod(clock + 1, BLOCK)
            if block:
                uniform, _ = draw_block([keys[own] for own in rows.tolist()], drawing, 0, block)
            count = 1 if watch is not None else int(min(BLOCK - row, last - clock))
            ahead = rows, row, clock, count
            self._rides(*memory, self._number, self._constants, uniform, *ahead)
            goes_on = ends[rows, 1] == 0
            rows, uniform, clock = rows[goes_on], uniform[goes_on], clock + count
            if watch is not None:
                watch(torch.from_numpy(state.copy()))
        return start.numpy(), state, ends, z[:, earned]


def _plan(policy: Any, parameters: Parameters, world: World) -> KernelPlan:
    plan = begun(world)
    known = {"weight", "limit"}
    if isinstance(policy, VectorPolicy):
        add_vector(plan, policy, len(world.spec.state), len(world.spec.action))
        known = set(policy.shapes)
    else:
        add_policy(plan, policy)
        plan.chosen["acts"] = "act"
        plan.constants["OWN"] = plan.constants["M"] * plan.constants["KP"]
    add_world(plan, world)
    unknown = set(parameters) - known
    if unknown:
        raise NoKernel(f"policies with {', '.join(sorted(unknown))}")
    assert plan.rows is not None
    plan.constants |= {"LIMITED": int("limit" in parameters), "EXPLORES": 0, "ANNEALED": 0}
    plan.constants |= {"WIDTH": plan.rows.width, "DEVIATION": 0}
    return plan


def _own(policy: Any, parameters: Parameters) -> Tensor:
    """``[S, OWN]``."""
    vector = getattr(policy, "vector", None)
    return parameters["weight"].flatten(1) if vector is None else vector(parameters)
