"""How a run computes: precision, device, and whether its ticks are compiled."""

from __future__ import annotations

import math
import os
from dataclasses import dataclass, replace
from typing import Any, get_args

import torch

from edtorch.app.errors import ConfigError
from edtorch.compiled.compilation import CannotCompile, CompileMode, check_compiler
from edtorch.learner.learner import AnyLearner
from edtorch.run.episodes import Budget
from edtorch.run.random import BLOCK
from edtorch.run.recorder import kept_bytes
from edtorch.run.scaled_sim import World

PRECISIONS = ("auto", "float64", "mixed")

WORTHWHILE_SECONDS = 150.0
"""That a run takes uncompiled, about, from which on compiling takes less time than it saves."""
_TICK, _LEARNER = 1e-3, 2e-5
"""Seconds that a tick takes uncompiled, and each learner in it besides, about."""

LARGEST_UNCOMPILED = 1024
"""Learners up to which a run starts uncompiled, to show something while nothing is compiled yet."""

_BYTES = 8
"""Of a number, at most."""


@dataclass(frozen=True)
class Compute:
    """dtype: of the learner; device: of everything; compiled: whether its ticks are, if they can
    be; required: whether it is an error if they cannot; after: the tick from which on."""

    dtype: torch.dtype
    device: torch.device
    compiled: bool
    required: bool
    after: int


def expected_ticks(budget: Budget, world: World) -> float:
    """Ticks that a learner will live for, at most."""
    limits = [math.inf if budget.seconds is None else budget.seconds / world.dt]
    limits += [
        math.inf if count is None else count * world.limit_ticks
        for count in (budget.episodes, budget.successes)
    ]
    return min(limits)


def check_choices(config: Any) -> None:
    """Reject unknown precisions, compile modes and devices."""
    for name, known in (
        ("precision", PRECISIONS),
        ("compile", get_args(CompileMode)),
        ("device", ("cpu", "cuda")),
    ):
        if config[name] not in known:
            hint = "; mixed is float32 for the learner" if config[name] == "float32" else ""
            raise ConfigError(
                f"compute.{name}={config[name]}: expected one of {', '.join(known)}{hint}"
            )


def _device(name: str) -> torch.device:
    """The device of the run; ConfigError if it is not there."""
    if name == "cuda" and not torch.cuda.is_available():
        raise ConfigError(
            f"compute.device=cuda: torch {torch.__version__} finds no CUDA device; expected cpu, or"
            " a machine with one and a torch that is built for it"
        )
    return torch.device(name)


def plan(config: Any, budget: Budget, world: World, learners: int) -> Compute:
    """From the group ``compute``; raises ConfigError."""
    check_choices(config)
    required = config.compile == "on"
    compiled = required or (
        config.compile == "auto"
        and getattr(world.sim, "traceable", False)
        and expected_ticks(budget, world) * (_TICK + _LEARNER * learners) >= WORTHWHILE_SECONDS
    )
    if required:
        if not getattr(world.sim, "traceable", False):
            raise ConfigError(
                "compute.compile=on: expected a domain that can be compiled;"
                f" {world.spec.name} does not say so of itself (traceable)"
            )
    single = config.precision == "mixed" or (config.precision == "auto" and compiled)
    after = config.compile_after if learners <= LARGEST_UNCOMPILED else 0
    dtype = torch.float32 if single else torch.float64
    return Compute(dtype, _device(config.device), compiled, required, after)


def check_machine(compute: Compute) -> None:
    """Refuse a run that has to be compiled where nothing can be; ConfigError.

    Called when the configuration is known to be sound, so that what is wrong with it is said first
    on every machine.
    """
    if compute.required:
        try:
            check_compiler()
        except CannotCompile as error:
            raise ConfigError(f"compute.compile=on: {error}") from error


def uncompiled(compute: Compute, config: Any) -> Compute:
    """The same without compiling, and in the precision that ``auto`` then stands for."""
    dtype = torch.float64 if config.precision == "auto" else compute.dtype
    return replace(compute, dtype=dtype, compiled=False)


def plan_inverse(config: Any, budget: Budget, world: World) -> Compute:
    """``plan`` for learners of inverse models, which are never compiled."""
    check_choices(config)
    if config.compile == "on":
        raise ConfigError(
            "compute.compile=on: expected auto or off with an inverse model, which is not compiled"
        )
    if config.device != "cpu":
        raise ConfigError(f"compute.device={config.device}: expected cpu with an inverse model")
    return uncompiled(plan(config, budget, world, 1), config)


def needed_bytes(learner: AnyLearner, world: World, learners: int) -> int:
    """Memory that a population takes, about: its random numbers, its state (now, before, and twice
    more on the way), and the tape of an uncompiled unroll."""
    one = learner.initial([0])
    parts = (one.model, one.policy, one.fit, one.noise, one.step)
    states = sum(p.numel() for part in parts for p in part.values())
    tape = 100 * len(world.spec.state) ** 2
    return learners * (_random_numbers(world) + 4 * states + tape + 500) * _BYTES


def _random_numbers(world: World) -> int:
    """Of a learner, that are held at a time."""
    return 2 * BLOCK * (world.uniforms + len(world.spec.action))


def check_memory(learner: AnyLearner, world: World, learners: int) -> None:
    """Refuse a population that the machine has no memory for; ConfigError."""
    needed = needed_bytes(learner, world, learners)
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
    """Refuse to keep more transitions than half of the free memory holds; ConfigError."""
    ticks = expected_ticks(budget, world)
    needed, free = kept_bytes(world, learners, ticks), free_bytes(torch.device("cpu"))
    if needed > free / 2:
        raise ConfigError(
            f"log.transitions=true: {learners} learners of up to {ticks * world.dt:.0f} s each take"
            f" about {needed / 2**30:.1f} GiB of memory, {free / 2**30:.1f} are free, of which half"
            " may be used; expected fewer seeds, or less in train.seconds"
        )
