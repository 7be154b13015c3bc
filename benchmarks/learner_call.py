"""What one learner costs in real time: act and learn, called from Python, beside the torch learner.

    python -m benchmarks.learner_call [--rounds 7] [--json FILE]

experiment=bicycle, one learner; us of CPU for both calls of a tick, random numbers included, with
and without an improvement of the policy.  The world is left out: observations are those of a ride.
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path

import torch

from benchmarks.ride import setup_of
from benchmarks.timing import Work, interleaved, print_table, write_json
from edtorch.native.apart import RealTime
from edtorch.run.random import learning_streams
from edtorch.run.training import Training
from edtorch.types import Transition

TICKS = 100
"""Of a call of each row, so that the clock's own cost does not count."""


def rows() -> dict[str, Work]:
    setup = setup_of(1)
    training = Training(setup.learner, setup.world, setup.seeds, setup.budget)
    training.advance(100)
    learner, world = setup.learner, setup.world
    state = training.learners
    streams = learning_streams(world, setup.seeds)
    seen = [world.sim.observe(training.worlds.world)]
    for _ in range(TICKS):
        training.advance(1)
        seen.append(world.sim.observe(training.worlds.world))
    scaled = [world.counted(each) for each in seen]
    given = [each[0].numpy().copy() for each in seen]
    native = RealTime(learner, world, 0)

    def in_kernels(improve: bool) -> Work:
        def work() -> None:
            native.begin(given[0])
            for following in given[1:]:
                native.act()
                native.learn(following, improve=improve)

        return work

    valid = torch.ones(1, dtype=torch.bool)

    def in_torch(improve: bool) -> Work:
        def work() -> None:
            with torch.inference_mode():
                for tick, (before, after) in enumerate(pairwise(scaled)):
                    action = world.clip(learner.act(state, before, streams.at(tick).normal))
                    transition = Transition(before, action, after, world.seconds, valid)
                    learner.step(state, transition, improve=improve)

        return work

    return {
        "kernels, improving": in_kernels(True),
        "kernels, resting": in_kernels(False),
        "torch, improving": in_torch(True),
        "torch, resting": in_torch(False),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    seconds = interleaved(rows(), rounds=options.rounds)
    us = {name: 1e6 * s / TICKS for name, s in seconds.items()}
    print_table("act and learn, B = 1", ["us"], {k: [f"{v:.1f}"] for k, v in us.items()})
    write_json(options.json, {"us_per_tick": us})


if __name__ == "__main__":
    main()
