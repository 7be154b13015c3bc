"""What a whole tick of learning costs: edtorch beside JAX and compiled scalar code.

The paper's bicycle (experiment=bicycle_paper), populations of B learners, blocks of 256 ticks; us
of CPU per learner and tick, one thread, all rows of a size in turn, and in brackets the ratios to
JAX in float64 and to numba.  The ticks of edtorch draw their random numbers, record and log; those
of the peers are given the numbers, and do neither.  "By hand" is JAX with the gradient written out
in the best layout.  Mixed: the simulator in float64, the learner in float32.

    python -m benchmarks.tick [--sizes 1 16 256 4096] [--covariance] [--parts] [--json FILE]

--covariance: with the covariance of the unroll; --parts: also where edtorch's eager tick spends its
time.  Peers that are not installed (extra [bench]) are left out.
"""

from __future__ import annotations

import argparse
import importlib.util
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch

from benchmarks.bicycle import draws, native_training, numbers, paper_setup, paper_training
from benchmarks.timing import Work, interleaved, print_table, write_json
from edtorch.learner.learner import AnyLearner, Learner
from edtorch.run.training import Training
from edtorch.value.unroll import ValuePath

BLOCK = 256
WARM_UP = 300
"""Ticks before anything is timed, so that there is something to learn from."""


def rows(size: int, covariance: bool) -> dict[str, Work]:
    """Each way to run a block of ticks; each goes on from where it got to."""
    training = paper_training(size, covariance=covariance)
    training.advance(WARM_UP)
    found: dict[str, Work] = {"edtorch eager, float64": lambda: training.advance(BLOCK)}
    native = native_training(size, covariance=covariance)
    native.advance(WARM_UP)
    found["edtorch native, float64"] = partial(native.advance, BLOCK)
    if importlib.util.find_spec("jax") is not None:
        for precision, dtype in (("float64", "float64"), ("mixed", "float32")):
            found[f"JAX, {precision}"] = jax_row(training, "ticks", dtype)
            found[f"JAX by hand, {precision}"] = jax_row(training, "ticks_by_hand", dtype)
    if importlib.util.find_spec("numba") is not None:
        found["numba, float64"] = numba_row(training)
    return found


def jax_row(training: Training, name: str, dtype: str) -> Work:
    from benchmarks import peers_jax

    ticks = getattr(peers_jax, name)
    population = peers_jax.population(numbers(training), dtype)
    uniform, normal = (peers_jax.array(given, dtype) for given in draws(training, BLOCK))

    def work() -> None:
        nonlocal population
        population, values = ticks(population, uniform, normal)
        peers_jax.ready((population, values))

    return work


def numba_row(training: Training) -> Work:
    from benchmarks import peers_numba

    population = {"noise": np.empty((0, 5, 5)), **numbers(training)}
    uniform, normal = draws(training, BLOCK)
    ticks: Any = peers_numba.ticks
    given = [*(population[name] for name in peers_numba.ORDER), uniform, normal]
    values = np.empty(uniform.shape[:2])
    return lambda: ticks(*given, values)


def _value(learner: AnyLearner) -> ValuePath:
    assert isinstance(learner, Learner)
    return learner.value


def parts(size: int, covariance: bool) -> dict[str, Work]:
    """The pieces of an eager tick for a population of ``size``."""
    training = paper_training(size, covariance=covariance)
    training.advance(WARM_UP)
    closed, generic = (
        _value(paper_setup(size, covariance=covariance, path=path).learner)
        for path in ("closed_form", "generic")
    )
    world, learners, here = training.world, training.learners, training.worlds
    uniform = torch.rand(size, world.uniforms, dtype=torch.float64)
    action = torch.zeros(size, 2, dtype=torch.float64)
    # Tensors of the loop are inference tensors, which cannot be differentiated: copies can.
    model, policy, noise = (
        {name: p.clone() for name, p in parameters.items()}
        for parameters in (learners.model, learners.policy, learners.noise)
    )
    state = here.observation.clone()
    pieces: dict[str, Work] = {
        "whole tick": lambda: training.advance(1),
        "simulator step": lambda: world.step(here.world, action, uniform),
        "observation, outcome": lambda: (
            world.observe(here.world),
            world.outcome(here.world, training.clock - here.begun),
        ),
        "value and gradient, closed form": lambda: closed(model, policy, noise, state),
    }
    found = {name: torch.inference_mode()(work) for name, work in pieces.items()}
    found["value and gradient, generic"] = torch.no_grad()(
        lambda: generic(model, policy, noise, state)
    )
    return found


def cell(us: dict[str, float], name: str) -> str:
    peers = ("JAX, float64", "numba, float64")
    ratios = [f"{us[name] / us[peer]:.2f}" for peer in peers if peer in us]
    return f"{us[name]:.2f} ({', '.join(ratios)})" if ratios else f"{us[name]:.2f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[1, 16, 256, 4096])
    parser.add_argument("--covariance", action="store_true")
    parser.add_argument("--parts", action="store_true")
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    kind = "mean and covariance" if options.covariance else "mean only"
    columns = [f"B = {size}" for size in options.sizes]
    content: dict[str, object] = {"covariance": options.covariance, "block": BLOCK}

    whole: dict[int, dict[str, float]] = {}
    for size in options.sizes:
        seconds = interleaved(rows(size, options.covariance), rounds=options.rounds)
        whole[size] = {name: 1e6 * s / BLOCK / size for name, s in seconds.items()}
    print(f"us per learner and tick, {kind} (ratio to JAX float64, to numba)")
    names = next(iter(whole.values()))
    print_table("", columns, {name: [cell(us, name) for us in whole.values()] for name in names})
    content["us_per_learner_tick"] = whole

    if options.parts:
        pieces: dict[int, dict[str, float]] = {}
        for size in options.sizes:
            seconds = interleaved(parts(size, options.covariance), rounds=options.rounds)
            pieces[size] = {name: 1e6 * s for name, s in seconds.items()}
        print("\nus per eager tick of the whole population")
        names = next(iter(pieces.values()))
        print_table("", columns, {n: [f"{us[n]:.0f}" for us in pieces.values()] for n in names})
        content["us_of_parts_per_tick"] = pieces
    write_json(options.json, content)


if __name__ == "__main__":
    main()
