"""What learning on Cardea costs: how many times faster than real time one learner is, on one core.

The default experiment, with its policy updated every five control steps and at every one, without
and with the covariance, and the paper's settings; simulator, random numbers and records included,
evaluations and logging not.  Each is measured early, while the arm still crashes and the inverse
model is solved for every 25 ticks, and late.  Also what value and gradient cost by themselves, the
adjoint written out beside torch's differentiation.

    python -m benchmarks.cardea [--early 500] [--late 6000] [--rounds 9] [--json FILE]
"""

from __future__ import annotations

import argparse
import importlib.util
from functools import partial
from pathlib import Path
from statistics import median

import torch
from torch import Tensor

from benchmarks.timing import Work, cpu_seconds, interleaved, print_table, write_json
from edtorch.app.build import Setup, build
from edtorch.app.compose import compose
from edtorch.inverse.learner import InverseLearner
from edtorch.run.training import Training

EACH_STEP = ("inverse.every=1", "inverse.recent=1")
RUNS = {
    "default": ("experiment=cardea",),
    "policy updated at every control step": ("experiment=cardea", *EACH_STEP),
    "with covariance": ("experiment=cardea", "transform=first"),
    "with covariance, at every control step": (
        "experiment=cardea",
        "transform=first",
        *EACH_STEP,
    ),
    "the paper's settings": ("experiment=cardea_paper",),
}
WAYS = {
    "mean, adjoint written out": (),
    "mean, torch": ("unroll.path=generic",),
    "covariance, adjoint written out": ("transform=first",),
    "covariance, torch": ("transform=first", "unroll.path=generic"),
}
BLOCK = 100
"""Ticks of a sample: an episode."""


def setup(*overrides: str) -> Setup:
    return build(compose(overrides))


def learners(size: int, *overrides: str) -> Training:
    made = setup(*overrides, f"seeds={size}")
    return Training(made.learner, made.world, made.seeds, made.budget)


def speeds(trainings: dict[str, Training], rounds: int) -> dict[str, float]:
    """Simulated seconds of one learner per CPU second, medians of blocks in turn."""
    samples: dict[str, list[float]] = {name: [] for name in trainings}
    for _ in range(rounds):
        for name, training in trainings.items():
            seconds = cpu_seconds(partial(training.advance, BLOCK))
            samples[name].append(BLOCK * training.world.dt / seconds)
    return {name: median(found) for name, found in samples.items()}


def value_ways(size: int, starts: int) -> dict[str, Work]:
    """Value and gradient of ``size`` learners from ``starts`` states each, every way."""
    works: dict[str, Work] = {}
    for name, overrides in WAYS.items():
        learner = setup("experiment=cardea", *overrides).learner
        assert isinstance(learner, InverseLearner)
        layout, theta = learner.policy.policy.layout, _normal(size, 5, 20)
        base, state = _normal(size, 2, 25), _normal(size, starts, layout.size)
        noise = torch.eye(7, dtype=torch.float64).expand(size, 7, 7)
        goal = _normal(size, starts, layout.joints)
        work = partial(learner.unroll, theta, base, state, goal, noise)
        works[name] = work if learner.needs_autograd else torch.inference_mode()(work)
    return works


def _normal(*shape: int) -> Tensor:
    generator = torch.Generator().manual_seed(0)
    return 0.2 * torch.randn(*shape, generator=generator, dtype=torch.float64)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--early", type=int, default=500, help="ticks before the first figures")
    parser.add_argument("--late", type=int, default=6000, help="ticks before the second ones")
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if importlib.util.find_spec("pybullet") is None:
        print("left out: needs PyBullet, the extra [cardea]")
        return
    torch.set_num_threads(1)

    trainings = {name: learners(1, *overrides) for name, overrides in RUNS.items()}
    found: dict[str, dict[str, float]] = {}
    for when in ("early", "late"):
        for training in trainings.values():
            training.advance(getattr(options, when) - training.clock)
        seconds = next(iter(trainings.values())).seconds
        found[f"from {seconds:.0f} s"] = speeds(trainings, options.rounds)
    print("times real time, one learner, one core")
    rows = {name: [f"{own[name]:.2f}" for own in found.values()] for name in RUNS}
    print_table("", list(found), rows)

    ms: dict[str, dict[str, float]] = {}
    for size, starts in ((1, 1), (1, 10), (5, 10)):
        seconds_of = interleaved(value_ways(size, starts), rounds=5)
        ms[f"{size} x {starts}"] = {name: 1e3 * s for name, s in seconds_of.items()}
    print("\nms of CPU for value and gradient, learners x states")
    print_table("", list(ms), {name: [f"{own[name]:.2f}" for own in ms.values()] for name in WAYS})
    write_json(options.json, {"times_real_time": found, "ms_of_value_and_gradient": ms})


if __name__ == "__main__":
    main()
