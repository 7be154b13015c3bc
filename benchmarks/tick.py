"""What a tick of learning costs, and where: us of CPU per tick of a whole population.

Eager, float64, one thread.  All rows of a population size are measured in turn within one run, so
that ratios hold on a busy machine; the figures themselves do not.  Writes JSON beside the table:

    python benchmarks/tick.py [--sizes 1 8 64 256] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import torch
from hydra import compose, initialize_config_module

from edtorch.app import schemas
from edtorch.app.build import build
from edtorch.interact import Training
from edtorch.learner import AnyLearner, Learner
from edtorch.unroll import ValuePath


def _value(learner: AnyLearner) -> ValuePath:
    assert isinstance(learner, Learner)
    return learner.value


def cpu_us(work: Callable[[], object], calls: int) -> float:
    """CPU microseconds of one call."""
    began = time.process_time()
    for _ in range(calls):
        work()
    return (time.process_time() - began) / calls * 1e6


def parts(size: int) -> dict[str, Callable[[], object]]:
    """The pieces of a tick for a population of ``size``, each as a function to time."""
    with initialize_config_module("conf", version_base="1.3"):
        configs = {
            path: compose("train", ["experiment=bicycle", f"seeds={size}", f"unroll.path={path}"])
            for path in ("closed_form", "generic")
        }
    setups = {path: build(config) for path, config in configs.items()}
    setup = setups["closed_form"]
    training = Training(setup.learner, setup.world, setup.seeds, setup.budget)
    training.advance(300)
    world, learners, here = training.world, training.learners, training.worlds
    uniform = torch.rand(size, world.uniforms, dtype=torch.float64)
    action = torch.zeros(size, 2, dtype=torch.float64)
    model, policy, noise, state = (
        learners.model,
        learners.policy,
        learners.noise,
        here.observation,
    )
    # Tensors of the loop are inference tensors, which cannot be differentiated: copies can.
    copied_model = {name: p.clone() for name, p in model.items()}
    copied_policy = {name: p.clone() for name, p in policy.items()}
    copied_state = state.clone()
    closed_form, generic = (_value(setups[path].learner) for path in ("closed_form", "generic"))
    return {
        "whole tick": lambda: training.advance(1),
        "simulator step": lambda: world.step(here.world, action, uniform),
        "observation, outcome": lambda: (
            world.observe(here.world),
            world.outcome(here.world, training.clock - here.begun),
        ),
        "value and gradient, closed form": lambda: closed_form(model, policy, noise, state),
        "value and gradient, generic": lambda: generic(
            copied_model, copied_policy, noise, copied_state
        ),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description="What a tick of learning costs, and where.")
    parser.add_argument("--sizes", type=int, nargs="+", default=[1, 8, 64, 256])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    schemas.register()
    table: dict[str, dict[int, float]] = {}
    for size in options.sizes:
        pieces = parts(size)
        samples: dict[str, list[float]] = {name: [] for name in pieces}
        for _ in range(options.rounds):
            for name, work in pieces.items():
                with torch.no_grad() if name.endswith("generic") else torch.inference_mode():
                    samples[name].append(cpu_us(work, 5 if name.endswith("generic") else 200))
        for name, values in samples.items():
            table.setdefault(name, {})[size] = statistics.median(values)
    print("us of CPU per tick of the population (median), and per learner")
    print(f"{'':34}" + "".join(f"{f'B = {size}':>20}" for size in options.sizes))
    for name, row in table.items():
        cells = "".join(f"{row[s]:11.0f} {row[s] / s:8.2f}" for s in options.sizes)
        print(f"{name:34}{cells}")
    if options.json is not None:
        content = {
            "us_per_tick": table,
            "torch": torch.__version__,
            "python": platform.python_version(),
            "machine": platform.processor() or platform.machine(),
            "threads": 1,
        }
        options.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
