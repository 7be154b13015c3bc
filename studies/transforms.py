"""Errors of each transform's moments, rewards and values, and its cost.

Random smooth systems (tests/smooth_systems.py), the truth by coupled Monte Carlo.  Errors are
medians over the systems; gain is first's error over the transform's, the median over the systems,
and for the value (`medians`) also the ratio of the medians.  Cost is
CPU time of value and gradient with respect to the policy, transforms taking turns within one run,
as a ratio to ``first``.  Writes JSON beside the table; with ``--docs`` it only writes the table of
an existing JSON file into docs/theory.md:

    python -m studies.transforms [--sizes 1 2 5 14] [--systems 60] [--json FILE]
    python -m studies.transforms --json runs/reference/transforms.json --docs docs/theory.md
"""

from __future__ import annotations

import argparse
import json
import statistics
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.func import grad_and_value

from benchmarks.timing import interleaved, write_json
from edtorch.report.tables import Table, as_markdown
from edtorch.transform import (
    Cubature,
    FirstOrder,
    GaussHermite,
    MeanOnly,
    PositiveNoise,
    SecondOrder,
    Transform,
    point_belief,
)
from edtorch.types import Trajectory
from edtorch.value.unroll import Horizon, propagate
from studies.bounds import insert
from tests.smooth_systems import SmoothSystem, Truth, coupled_monte_carlo, random_system

MARK = "<!-- transforms table -->"
QUANTITIES = ("mean", "cov", "reward", "value")


def transforms(n: int) -> dict[str, Transform]:
    every: dict[str, Transform] = {
        "mean_only": MeanOnly(),
        "first": FirstOrder(),
        "second": SecondOrder(),
        "cubature": Cubature(),
    }
    if n <= 5:
        every["gauss_hermite"] = GaussHermite(3)
    return every


@dataclass(frozen=True)
class WithJacobian:
    """The system's closed loop, with its Jacobian in closed form."""

    system: SmoothSystem

    def __call__(self, state: Tensor) -> Tensor:
        return self.system.closed_loop(state)

    def jacobian(self, state: Tensor) -> Tensor:
        slope = 1 - self.system.policy(state).square()
        return self.system.A + self.system.B @ (slope.unsqueeze(-1) * self.system.W)


def trajectory(system: SmoothSystem, transform: Transform, *, closed: bool = False) -> Trajectory:
    return propagate(
        point_belief(system.start),
        WithJacobian(system) if closed else system.closed_loop,
        system.policy,
        reward=system.reward,
        transform=transform,
        noise=PositiveNoise(system.noise),
        horizon=Horizon(system.horizon, 1.0, system.discount, 1.0),
    )


def errors(found: Trajectory, truth: Truth) -> dict[str, float]:
    """Median over the steps of each error's norm; the value's absolute error."""
    return {
        "mean": float((found.mean[1:] - truth.mean).norm(dim=-1).median()),
        "cov": float((found.cov[1:] - truth.cov).flatten(1).norm(dim=-1).median()),
        "reward": float((found.reward - truth.reward).abs().median()),
        "value": float((found.value - truth.value).abs()),
    }


def value_and_gradient(system: SmoothSystem, transform: Transform, *, closed: bool) -> Tensor:
    def value(W: Tensor, b: Tensor) -> Tensor:
        return trajectory(replace(system, W=W, b=b), transform, closed=closed).value

    return grad_and_value(value, argnums=(0, 1))(system.W, system.b)[1]


def cost(system: SmoothSystem, rounds: int) -> dict[str, float]:
    """CPU ms of value and gradient, transforms in turn; medians over the rounds.

    ``first, own J`` is first with the closed loop's own Jacobian instead of jacrev's.
    """
    cases = {name: (t, False) for name, t in transforms(len(system.start)).items()}
    cases["first, own J"] = (FirstOrder(), True)
    works = {
        name: partial(value_and_gradient, system, transform, closed=closed)
        for name, (transform, closed) in cases.items()
    }
    return {name: 1e3 * seconds for name, seconds in interleaved(works, rounds=rounds).items()}


def measure(n: int, options: argparse.Namespace) -> dict:
    """The rows of one size."""
    found: dict[str, list[dict[str, float]]] = {}
    ratios, floor = [], []
    for seed in range(options.systems):
        system = random_system(n, seed, options.nl, options.noise, options.v0)
        generator = torch.Generator().manual_seed(1_000_000 + seed)
        truth = coupled_monte_carlo(system, options.samples, generator)
        values = {}
        for name, transform in transforms(n).items():
            path = trajectory(system, transform)
            values[name] = path.value
            found.setdefault(name, []).append(errors(path, truth))
        missing = truth.value - values["first"]
        ratios.append(float((values["second"] - values["first"]) / missing))
        floor.append(float(truth.value_error / missing.abs()))
    milliseconds = cost(random_system(n, 0, options.nl, options.noise, options.v0), 5)
    rows = {}
    for name, cases in found.items():
        error = {q: statistics.median(c[q] for c in cases) for q in QUANTITIES}
        first = found["first"]
        gain = {
            q: statistics.median(f[q] / c[q] for f, c in zip(first, cases, strict=True))
            for q in QUANTITIES
        }
        rows[name] = {
            "error": error,
            "gain": gain,
            "ratio_of_medians": {
                q: statistics.median(f[q] for f in first) / error[q] for q in QUANTITIES
            },
            "ms": milliseconds[name],
            "cost": milliseconds[name] / milliseconds["first"],
        }
    return {
        "transforms": rows,
        "indicator_ratio": {
            "median": statistics.median(ratios),
            "quartiles": statistics.quantiles(ratios, n=4),
        },
        "standard_error_over_first_error": statistics.median(floor),
        "ms_of_first_with_its_own_jacobian": milliseconds["first, own J"],
    }


def markdown(results: dict[str, Any]) -> str:
    """A row per dimension and transform."""
    header = "n|transform|mean|covariance|reward|value|value, ratio of medians|cost".split("|")
    rows: list[tuple[str, ...]] = []
    for n, result in results.items():
        for name, row in result["transforms"].items():
            if name == "first":
                continue
            gains = (f"{row['gain'][q]:.3g}" for q in ("mean", "cov", "reward", "value"))
            ratio, cost = row["ratio_of_medians"]["value"], row["cost"]
            rows.append((n, f"`{name}`", *gains, f"{ratio:.3g}", f"{cost:.2f}"))
    ratios = ", ".join(
        f"{result['indicator_ratio']['median']:.2f} (n = {n})" for n, result in results.items()
    )
    note = f"Value error estimate over true value error of `first`, median: {ratios}."
    return as_markdown(Table("", tuple(header), tuple(rows), note))


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[1, 2, 5, 14])
    parser.add_argument("--systems", type=int, default=60)
    parser.add_argument("--samples", type=int, default=100_000)
    parser.add_argument("--nl", type=float, default=0.6)
    parser.add_argument("--v0", type=float, default=0.05)
    parser.add_argument("--noise", choices=("gaussian", "uniform"), default="gaussian")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--docs", type=Path, help="a page to write the table of FILE into")
    options = parser.parse_args()
    if options.docs is not None:
        content = json.loads(options.json.read_text(encoding="utf-8"))
        made = f"Made by `{content['command']}`, torch {content['torch']}."
        insert(options.docs, MARK, f"{markdown(content['results'])}\n\n{made}")
        return
    torch.set_num_threads(1)
    table = {}
    for n in options.sizes:
        table[n] = measure(n, options)
        print(
            f"n = {n}: value error estimate / error of first: median "
            f"{table[n]['indicator_ratio']['median']:.2f}; Monte Carlo standard error / error of "
            f"first: {table[n]['standard_error_over_first_error']:.1e}"
        )
        print(
            f"{'':15}{'median error':^40}{'median gain over first':^32}"
            f"{'medians':>9}{'ms':>7}{'cost':>7}"
        )
        print(
            f"{'':15}"
            + "".join(f"{q:>10}" for q in QUANTITIES)
            + "".join(f"{q:>8}" for q in QUANTITIES)
        )
        for name, row in table[n]["transforms"].items():
            cells = "".join(f"{row['error'][q]:10.1e}" for q in QUANTITIES)
            gains = "".join(f"{row['gain'][q]:8.1f}" for q in QUANTITIES)
            medians = row["ratio_of_medians"]["value"]
            print(
                f"{name:15}{cells}{gains}{medians:9.1f}{row['ms']:7.1f}{row['cost']:7.2f}",
                flush=True,
            )
        own = table[n]["ms_of_first_with_its_own_jacobian"]
        ratio = own / table[n]["transforms"]["first"]["ms"]
        print(f"{'first, own J':15}{'':81}{own:7.1f}{ratio:7.2f}", flush=True)
    content = {
        "command": (
            f"python -m studies.transforms --sizes {' '.join(map(str, options.sizes))} "
            f"--systems {options.systems} --samples {options.samples} --nl {options.nl} "
            f"--v0 {options.v0} --noise {options.noise}"
        ),
        "seeds": list(range(options.systems)),
        "settings": {
            "samples": options.samples,
            "nl": options.nl,
            "v0": options.v0,
            "noise": options.noise,
            "horizon": 10,
            "discount": 0.95,
        },
        "results": table,
    }
    write_json(options.json, content)


if __name__ == "__main__":
    main()
