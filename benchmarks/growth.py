"""How time grows: of a tick with the population, of value and gradient with T and n.

    python -m benchmarks.growth [--sizes 256 4096 65536] [--steps 10 30 60] [--states 5 14 32]
        [--json FILE]

The paper's bicycle in kernels; the closed form of value and gradient for 256 learners;
all sizes in turn, so that the ratios to the first of each kind are those of one run.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

import torch

from benchmarks.bicycle import native_training
from benchmarks.timing import Work, interleaved, print_table, write_json
from benchmarks.unroll import ACTIONS, Problem, Size, edtorch_rows

BLOCK, WARM_UP = 16, 32
LEARNERS = 256
MEMORY = 4.0


def tick(size: int) -> Work:
    """A block of compiled ticks."""
    training = native_training(size)
    training.advance(WARM_UP)
    return partial(training.advance, BLOCK)


def value(n: int, steps: int, *, covariance: bool) -> Work:
    """Value and gradient, the closed form."""
    size = Size(covariance, n, ACTIONS[n], steps, LEARNERS, "float64")
    return edtorch_rows(Problem(size), MEMORY)["edtorch closed form"]


def report(title: str, seconds: dict[str, float], per: dict[str, float]) -> dict[str, float]:
    """us per learner (and tick) of each size; printed with the ratios to the first."""
    us = {name: 1e6 * s / per[name] for name, s in seconds.items()}
    first = next(iter(us.values()))
    print_table(
        title,
        ["us per learner", "ratio"],
        {k: [f"{v:.3g}", f"{v / first:.2f}"] for k, v in us.items()},
    )
    return us


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[256, 4096, 65536])
    parser.add_argument("--steps", type=int, nargs="+", default=[10, 30, 60])
    parser.add_argument("--states", type=int, nargs="+", default=[5, 14, 32], choices=ACTIONS)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    content: dict[str, object] = {}

    rows = {f"B = {size}": tick(size) for size in options.sizes}
    per = {f"B = {size}": float(size * BLOCK) for size in options.sizes}
    content["tick"] = report("tick", interleaved(rows, rounds=options.rounds), per)
    for covariance, kind in ((False, "mean"), (True, "covariance")):
        for variable, sizes in (
            ("T", {steps: (5, steps) for steps in options.steps}),
            ("n", {n: (n, 30) for n in options.states}),
        ):
            rows = {
                f"{variable} = {key}": value(*size, covariance=covariance)
                for key, size in sizes.items()
            }
            with torch.inference_mode():
                seconds = interleaved(rows, rounds=options.rounds)
            name = f"value and gradient, {kind}, with {variable}"
            content[name] = report(name, seconds, dict.fromkeys(rows, float(LEARNERS)))
    write_json(options.json, content)


if __name__ == "__main__":
    main()
