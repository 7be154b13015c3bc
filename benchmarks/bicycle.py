"""The paper's bicycle as edtorch trains it, and its numbers as arrays for the peers."""

from __future__ import annotations

from typing import Any

import numpy as np

from edtorch.app.build import Setup, build
from edtorch.app.compose import compose
from edtorch.compiled.tiles import Tiles
from edtorch.run.random import Purpose, Streams, stream_key
from edtorch.run.training import Training
from edtorch.types import replace

Array = np.ndarray[Any, Any]


def paper_setup(
    size: int,
    *,
    covariance: bool = False,
    path: str = "auto",
    compile: str = "off",
    precision: str = "float64",
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
            f"compute.compile={compile}",
            f"compute.precision={precision}",
        ],
    )
    return build(config)


def paper_training(size: int, *, covariance: bool = False) -> Training:
    """A population at its first tick."""
    setup = paper_setup(size, covariance=covariance)
    return Training(setup.learner, setup.world, setup.seeds, setup.budget)


def compiled_training(size: int, *, covariance: bool = False, precision: str) -> Training:
    """The same on compiled ticks."""
    setup = paper_setup(size, covariance=covariance, compile="on", precision=precision)
    training = Training(setup.learner, setup.world, setup.seeds, setup.budget)
    assert setup.compiled is not None
    tick = replace(training.tick, learner=setup.compiled)
    training.stage = Tiles(tick, training.stage.population, setup.seeds)
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
