"""Value and gradient of a linear closed loop: edtorch beside JAX and compiled scalar code.

Mean only and with covariance, over sizes n (states), m (actions), T (steps) and B (learners), each
size with all rows in turn; us of CPU per call, one thread, and in brackets the ratios to JAX as its
users write it (`JAX`) and to numba.  JAX's further rows help it along.  Not measured,
"-": what would need more than --memory GiB.

    python -m benchmarks.unroll [--full] [--states 5] [--steps 30] [--learners 256] [--json FILE]

Without --full the default sizes vary one thing at a time; peers that are not installed (extra
[bench]) are left out.
"""

from __future__ import annotations

import argparse
import importlib.util
from collections.abc import Callable
from dataclasses import dataclass
from itertools import product
from pathlib import Path

import numpy as np
import torch

from benchmarks.timing import Work, interleaved, print_table, write_json
from edtorch.model.features import Identity
from edtorch.model.models import DerivativeModel
from edtorch.model.noise import ResidualNoise
from edtorch.policy.policies import LinearPolicy
from edtorch.rewards import QuadraticReward
from edtorch.transform import FirstOrder, MeanOnly
from edtorch.value.choose import Choice, Method, choose_path
from edtorch.value.unroll import Horizon

ACTIONS = {5: 2, 14: 5, 32: 10}
"""m by n: a bicycle, an arm, something larger."""
STATES, STEPS, LEARNERS = (5, 14, 32), (10, 30, 100, 300), (1, 16, 256, 4096)
DT = 0.051


@dataclass(frozen=True)
class Size:
    """One column: what is unrolled, for how many learners."""

    covariance: bool
    n: int
    m: int
    steps: int
    learners: int
    dtype: str

    def tape(self) -> float:
        """GiB of all states (or second moments) of all learners, as a reverse pass keeps them."""
        per_step = self.n**2 if self.covariance else self.n
        return self.learners * self.steps * per_step * np.dtype(self.dtype).itemsize / 2**30


class Problem:
    """Random learners of one size, around loops that are about stable, as learned ones are."""

    def __init__(self, size: Size) -> None:
        random = np.random.default_rng(0)

        def normal(*shape: int) -> np.ndarray:
            return random.standard_normal(shape).astype(size.dtype)

        n, m, B = size.n, size.m, size.learners
        self.size = size
        self.weight = normal(B, n, n + m) / n**0.5
        self.weight[:, :, :n] -= np.eye(n, dtype=size.dtype)
        self.theta = normal(B, m, n) / n**0.5
        self.start = normal(B, n)
        root = normal(B, n, n)
        self.noise = root @ root.swapaxes(1, 2) / n
        """Per second."""
        self.cost = np.diag(random.random(n)).astype(size.dtype)
        self.horizon = Horizon(size.steps, DT, 0.97, DT)


def edtorch_rows(problem: Problem, memory: float) -> dict[str, Work]:
    """The paths of edtorch that ``edtorch.value.choose`` offers."""
    size = problem.size
    dtype = getattr(torch, size.dtype)
    model = DerivativeModel(
        size.n, size.m, Identity(size.n + size.m), torch.zeros(size.n).to(dtype)
    )
    policy = LinearPolicy(size.n, size.m, Identity(size.n), dtype)
    reward = QuadraticReward(
        torch.from_numpy(problem.cost), torch.zeros(size.m, size.m, dtype=dtype)
    )
    weight, theta, start, noise = (
        torch.from_numpy(array)
        for array in (problem.weight, problem.theta, problem.start, problem.noise)
    )

    def choice(method: Method) -> Choice:
        return choose_path(
            method,
            model,
            policy,
            reward,
            FirstOrder() if size.covariance else MeanOnly(),
            problem.horizon,
            noise=ResidualNoise(1.0) if size.covariance else None,
        )

    def row(method: Method) -> Work:
        path = choice(method).path

        def work() -> object:
            with torch.no_grad() if path.needs_autograd else torch.inference_mode():
                return path({"weight": weight}, {"weight": theta}, {"nu": noise}, start)

        return work

    rows: dict[str, Work] = {}
    # Differentiation keeps about ten arrays of the size of the states in every step.
    if 10 * size.tape() <= memory:
        rows["edtorch generic"] = row("generic")
    if 2 * size.tape() <= memory:
        rows["edtorch closed form"] = row("closed_form")
    return rows


def jax_rows(problem: Problem, memory: float) -> dict[str, Work]:
    from benchmarks import peers_jax

    size = problem.size
    own = [problem.weight, problem.theta, problem.start]
    more = [problem.cost, np.array(problem.horizon.weights()), np.array(DT)]
    if size.covariance:
        own.append(problem.noise * np.array(DT, size.dtype))

    def row(name: str, layout: Callable[[np.ndarray], np.ndarray]) -> Work:
        function = getattr(peers_jax, name)
        given = [peers_jax.array(layout(array), size.dtype) for array in own]
        given += [peers_jax.array(array, size.dtype) for array in more]
        return lambda: peers_jax.ready(function(*given))

    kind = "covariance" if size.covariance else "mean"
    rows: dict[str, Work] = {}
    if 10 * size.tape() <= memory:
        rows["JAX"] = row(kind, lambda array: array)
        if size.covariance:
            rows["JAX, own Jacobian"] = row("covariance_own_jacobian", lambda array: array)
    if 2 * size.tape() <= memory:
        rows["JAX, by hand"] = row(f"{kind}_adjoint", lambda array: array)
        if not size.covariance or size.n <= peers_jax.LARGEST_LAST:
            last = row(f"{kind}_adjoint_last", lambda array: np.moveaxis(array, 0, -1))
            rows["JAX, by hand, learners last"] = last
    return rows


def numba_rows(problem: Problem) -> dict[str, Work]:
    from benchmarks import peers_numba

    size = problem.size
    dtype = np.dtype(size.dtype).type
    weights, dt = np.array(problem.horizon.weights(), size.dtype), dtype(DT)
    if size.covariance:
        covariance = peers_numba.covariance(size.n, size.m, size.steps, size.dtype)
        own = (problem.weight, problem.theta, problem.start, problem.noise * dt)
        return {"numba": lambda: covariance(*own, problem.cost, weights, dt)}
    mean = peers_numba.mean(size.n, size.m, size.steps, size.dtype)
    own = (problem.weight, problem.theta, problem.start)
    return {"numba": lambda: mean(*own, problem.cost, weights, dt)}


def measure(size: Size, memory: float, rounds: int) -> dict[str, float]:
    """us per call of every row."""
    problem = Problem(size)
    rows = edtorch_rows(problem, memory)
    if importlib.util.find_spec("jax") is not None:
        rows |= jax_rows(problem, memory)
    if importlib.util.find_spec("numba") is not None:
        rows |= numba_rows(problem)
    return {name: 1e6 * seconds for name, seconds in interleaved(rows, rounds=rounds).items()}


def grid(options: argparse.Namespace) -> list[tuple[int, int, int]]:
    """(n, T, B) of all columns."""
    asked = (options.states, options.steps, options.learners)
    if options.full or any(asked):
        states, steps, learners = asked
        return list(product(states or STATES, steps or STEPS, learners or LEARNERS))
    return [
        *((5, 30, learners) for learners in LEARNERS),
        *((5, steps, 256) for steps in STEPS if steps != 30),
        *((n, 30, 256) for n in STATES if n != 5),
    ]


def cell(us: dict[str, float], name: str) -> str:
    if name not in us:
        return "-"
    ratios = [f"{us[name] / us[peer]:.2f}" for peer in ("JAX", "numba") if peer in us]
    return f"{us[name]:.0f} ({', '.join(ratios)})" if ratios else f"{us[name]:.0f}"


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--full", action="store_true", help="all sizes: hours")
    parser.add_argument("--states", type=int, nargs="+", choices=STATES)
    parser.add_argument("--steps", type=int, nargs="+")
    parser.add_argument("--learners", type=int, nargs="+")
    parser.add_argument("--dtypes", nargs="+", default=["float32", "float64"])
    parser.add_argument("--kinds", nargs="+", default=["mean", "covariance"])
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--memory", type=float, default=4.0, help="GiB that a row may take")
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    results = []
    for kind, dtype in product(options.kinds, options.dtypes):
        columns: dict[str, dict[str, float]] = {}
        for n, steps, learners in grid(options):
            size = Size(kind == "covariance", n, ACTIONS[n], steps, learners, dtype)
            us = measure(size, options.memory, options.rounds)
            columns[f"{n}, {steps}, {learners}"] = us
            results.append(
                {
                    "kind": kind,
                    "n": n,
                    "m": size.m,
                    "steps": steps,
                    "learners": learners,
                    "dtype": dtype,
                    "us": us,
                }
            )
        names = dict.fromkeys(name for us in columns.values() for name in us)
        table = {name: [cell(us, name) for us in columns.values()] for name in names}
        print(f"\n{kind}, {dtype}: us per call (ratio to JAX, to numba)")
        print_table("n, T, B", list(columns), table)
    write_json(options.json, {"results": results})


if __name__ == "__main__":
    main()
