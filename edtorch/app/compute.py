"""How a run computes: device, threads, compiled kernels or not, and whether memory suffices."""

from __future__ import annotations

import logging
import math
import os
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, get_args

import torch

from edtorch.app.errors import ConfigError
from edtorch.app.settings import Settings
from edtorch.compiled import numba
from edtorch.errors import Unavailable
from edtorch.learner.learner import AnyLearner
from edtorch.native.apart import Halves
from edtorch.native.choice import Mode
from edtorch.native.layout import RowLayout
from edtorch.native.plan import NoKernel, learner_plan, plan_of
from edtorch.native.stage import Native
from edtorch.run.episodes import Budget
from edtorch.run.random import BLOCK, learning_streams
from edtorch.run.recorder import Recorder, gathering_bytes
from edtorch.run.scaled_sim import World
from edtorch.run.tick import Population, Tick
from edtorch.run.training import Training
from edtorch.types import LearnerState

logger = logging.getLogger("edtorch")

_BYTES = 8
"""Of a number."""


def expected_ticks(budget: Budget, world: World) -> float:
    """Ticks that a learner will live for, at most."""
    limits = [math.inf if budget.seconds is None else budget.seconds / world.dt]
    limits += [
        math.inf if count is None else count * world.limit_ticks
        for count in (budget.episodes, budget.successes)
    ]
    return min(limits)


def device_of(config: Any) -> torch.device:
    """From the group ``compute``, the other settings of which are checked too; ConfigError."""
    for name, known in (("native", get_args(Mode)), ("device", ("cpu", "cuda"))):
        if config[name] not in known:
            raise ConfigError(f"compute.{name}={config[name]}: expected one of {', '.join(known)}")
    if config.device == "cuda" and not torch.cuda.is_available():
        raise ConfigError(
            f"compute.device=cuda: torch {torch.__version__} finds no CUDA device; expected cpu, or"
            " a machine with one and a torch that is built for it"
        )
    return torch.device(config.device)


def evaluation_mode(config: Settings) -> Mode:
    """How a run with this configuration is evaluated: with ``on`` the learner has kernels, and the
    run is not to fail at its end where the world has none."""
    return "off" if config.compute.native == "off" else "auto"


def refuse_kernels(config: Any, what: str) -> None:
    """ConfigError where kernels are asked for and ``what`` has none."""
    if config.native == "on":
        raise ConfigError(f"compute.native=on: expected auto or off with {what}")


@contextmanager
def required(key: str) -> Iterator[None]:
    """Kernels that ``key`` asks for: ConfigError where a part has none, or nothing compiles."""
    try:
        yield
    except NoKernel as error:
        raise ConfigError(
            f"{key}=on: there is no kernel for {error}; expected auto or off"
        ) from error
    except Unavailable as error:
        raise ConfigError(f"{key}=on: {error}") from error


def check_kernels(learner: AnyLearner, world: World) -> None:
    """ConfigError where there are no kernels for such learners, or nothing can be compiled."""
    with required("compute.native"):
        learner_plan(learner, world, RowLayout.of(_one(learner, world)))
        numba()


def _one(learner: AnyLearner, world: World) -> Population[LearnerState]:
    """A population of one, to make plans from."""
    uniform = torch.zeros(1, world.uniforms, dtype=world.dtype)
    return Tick(learner, world).first(learner.initial([0]), world.initial(uniform))


def into_kernels(
    training: Training, mode: Mode, threads: int, recorder: Recorder | None = None
) -> str:
    """Let a population go on in kernels where its parts have them; says what became of it.

    The kinds of parts alone decide: where a world has no kernel, or its transitions are kept by a
    ``recorder``, the learners are in kernels all the same.  Raises ConfigError where kernels are
    asked for and do not compile.
    """
    if mode == "off":
        return "uncompiled"
    if mode == "on":
        with required("compute.native"):
            return _into_kernels(training, threads, recorder)
    try:
        return _into_kernels(training, threads, recorder)
    except NoKernel as error:
        return f"uncompiled: there is no kernel for {error}"
    except Unavailable as error:
        logger.warning("uncompiled, some hundred times slower: %s", error)
        return "uncompiled"


def _into_kernels(training: Training, threads: int, recorder: Recorder | None) -> str:
    tick, population, seeds = training.tick, training.stage.population, training.seeds
    try:
        if recorder is not None:
            raise NoKernel("keeping every transition")
        plan = plan_of(tick, population)
        training.stage = Native(plan, tick, population, seeds, threads=threads)
    except NoKernel as missing:
        streams = learning_streams(training.world, seeds)
        training.stage = Halves(tick, population, streams, recorder)
        return f"learners compiled, but not the world: there is no kernel for {missing}"
    return "compiled"


def runs_in_kernels(learner: AnyLearner, world: World, mode: Mode) -> bool:
    """Whether learners and their world are one kernel."""
    if mode == "off" or not hasattr(world.sim, "rows"):
        return False
    try:
        plan_of(Tick(learner, world), _one(learner, world))
        numba()
    except (NoKernel, Unavailable):
        return False
    return True


def needed_bytes(learner: AnyLearner, world: World, learners: int, mode: Mode = "off") -> int:
    """Memory that a population takes, about: its random numbers and its state, in torch several
    times, and there the tape of an unroll."""
    one = learner.initial([0])
    parts = (one.model, one.policy, one.fit, one.noise, one.step)
    states = sum(p.numel() for part in parts for p in part.values())
    drawn = BLOCK * (world.uniforms + len(world.spec.action))
    if runs_in_kernels(learner, world, mode):
        return learners * (drawn + 2 * states + 200) * _BYTES
    tape = 100 * len(world.spec.state) ** 2
    return learners * (2 * drawn + 4 * states + tape + 500) * _BYTES


def check_memory(learner: AnyLearner, world: World, learners: int, mode: Mode = "off") -> None:
    """Refuse a population that the machine has no memory for; ConfigError."""
    needed = needed_bytes(learner, world, learners, mode)
    free = free_bytes(world.device)
    if needed > free:
        raise ConfigError(
            f"seeds={learners}: takes about {needed / 2**30:.1f} GiB of memory,"
            f" {free / 2**30:.1f} are free; expected fewer, or several runs (-m seed=0,100000,...)"
        )


def free_bytes(device: torch.device) -> int:
    """Memory that nobody uses."""
    if device.type == "cuda":
        return torch.cuda.mem_get_info(device)[0]
    return os.sysconf("SC_AVPHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def check_recording(budget: Budget, world: World, learners: int) -> None:
    """Refuse to record more transitions than can be gathered at the end in half of the free memory;
    ConfigError."""
    ticks = expected_ticks(budget, world)
    needed, free = gathering_bytes(world, learners, ticks), free_bytes(torch.device("cpu"))
    if needed > free / 2:
        raise ConfigError(
            f"log.transitions=true: {learners} learners of up to {ticks * world.dt:.0f} s each take"
            f" about {needed / 2**30:.1f} GiB of memory, {free / 2**30:.1f} are free, of which half"
            " may be used; expected fewer seeds, or less in train.seconds"
        )
