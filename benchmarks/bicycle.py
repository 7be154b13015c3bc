"""The paper's bicycle as edtorch trains it, and its numbers as arrays for the peers."""

from __future__ import annotations

from typing import Any

import numpy as np

from edtorch.app.build import Setup, build
from edtorch.app.compose import compose
from edtorch.native.plan import plan_of
from edtorch.native.stage import Native
from edtorch.run.random import Purpose, Streams, stream_key
from edtorch.run.training import Training

Array = np.ndarray[Any, Any]


def paper_setup(
    size: int,
    *,
    covariance: bool = False,
    path: str = "auto",
) -> Setup:
    """experiment=bicycle_paper with ``size`` learners that never stop."""
    transform = "first" if covariance else "mean_only"
    config = compose(
        [
            "experiment=bicycle_paper",
            f"seeds={size}",
            f"transform={transform}",
            f"unroll.path={path}",
            "train.seconds=1e9",
        ],
    )
    return build(config)


def paper_training(size: int, *, covariance: bool = False) -> Training:
    """A population at its first tick."""
    setup = paper_setup(size, covariance=covariance)
    return Training(setup.learner, setup.world, setup.seeds, setup.budget)


def native_training(size: int, *, covariance: bool = False, threads: int = 1) -> Training:
    """The same in kernels."""
    return compiled(paper_training(size, covariance=covariance), threads)


def compiled(training: Training, threads: int = 1) -> Training:
    """A population, in kernels from now on."""
    population = training.stage.population
    plan = plan_of(training.tick, population)
    training.stage = Native(plan, training.tick, population, training.seeds, threads=threads)
    return training


def numbers(training: Training) -> dict[str, Array]:
    """Copies of everything that a peer goes on from, by the names of its arguments."""
    learners, here = training.learners, training.worlds
    found = {
        "world": here.world,
        "observation": here.observation,
        "weight": learners.model["weight"],
        "theta": learners.policy["weight"],
        "ticks": training.clock - here.begun,
        "episodes": here.episodes,
        "falls": here.failures,
        "rides": here.successes,
    }
    if learners.noise:
        found["noise"] = learners.noise["nu"]
    # A tensor of steps may be laid out otherwise than its shape says.
    return {name: np.array(tensor.numpy(), order="C") for name, tensor in found.items()}


def draws(training: Training, ticks: int) -> tuple[Array, Array]:
    """Uniforms and normals ``[K, B, 2]`` of the next ticks, those that ``training`` will draw."""
    keys = [stream_key(seed, Purpose.LEARNING) for seed in training.seeds]
    world = training.world
    streams = Streams(keys, world.uniforms, len(world.spec.action), world.dtype)
    ahead = [streams.at(training.clock + 1 + k) for k in range(ticks)]
    uniform = np.stack([draw.uniform.numpy() for draw in ahead])
    return uniform, np.stack([draw.normal.numpy() for draw in ahead])
