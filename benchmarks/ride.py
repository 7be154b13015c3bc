"""What the default ride costs: ticks that improve the policy, ticks that do not, and their mean.

    python -m benchmarks.ride [--size 256] [--rounds 7] [--json FILE]

experiment=bicycle in kernels, both kinds of blocks in turn; us of CPU per
learner and tick, random numbers and records included.  The mean is over a ride of 358 s.
"""

from __future__ import annotations

import argparse
from functools import partial
from pathlib import Path

import torch

from benchmarks.bicycle import compiled
from benchmarks.timing import Work, interleaved, print_table, write_json
from edtorch.app.build import Setup, build
from edtorch.app.compose import compose
from edtorch.learner.schedule import ALWAYS, Schedule
from edtorch.run.training import Training

BLOCK = 256
RIDE = 35_800
"""Ticks."""


def setup_of(size: int) -> Setup:
    """The experiment, for learners that never stop."""
    overrides = [f"seeds={size}", "train.seconds=1e6", "train.successes=null"]
    return build(compose(["experiment=bicycle", *overrides]))


def blocks(setup: Setup, schedule: Schedule) -> Work:
    """Blocks of ticks that are improved by ``schedule``, of learners a second old."""
    training = Training(setup.learner, setup.world, setup.seeds, setup.budget, schedule=schedule)
    training.advance(100)
    compiled(training)
    training.advance(BLOCK)
    return partial(training.advance, BLOCK)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--size", type=int, default=256)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    setup = setup_of(options.size)
    never = Schedule(first=10**9)
    rows = {"improving": blocks(setup, ALWAYS), "resting": blocks(setup, never)}
    seconds = interleaved(rows, rounds=options.rounds)
    us = {name: 1e6 * s / BLOCK / options.size for name, s in seconds.items()}
    improving = sum(setup.schedule.improves(clock) for clock in range(1, RIDE + 1)) / RIDE
    us["a ride"] = improving * us["improving"] + (1 - improving) * us["resting"]
    print(
        f"us per learner and tick, B = {options.size}; {100 * improving:.1f} % of a ride's improve"
    )
    print_table("", ["us"], {name: [f"{value:.2f}"] for name, value in us.items()})
    content = {"us_per_learner_tick": us, "share_improving": improving, "learners": options.size}
    write_json(options.json, content)


if __name__ == "__main__":
    main()
