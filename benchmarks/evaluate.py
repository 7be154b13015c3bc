"""What the evaluation of finished policies costs, in kernels and in torch.

    python -m benchmarks.evaluate [--policies 8] [--episodes 20] [--json FILE]

experiment=bicycle: the policies of learners that have ridden to the goal once, fresh rides of each
to the goal; CPU seconds, random numbers included, and us per tick.  One ride of each in torch.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import torch

from benchmarks.bicycle import compiled
from benchmarks.timing import cpu_seconds, print_table, write_json
from edtorch.app.build import build
from edtorch.app.compose import compose
from edtorch.native.evaluation import evaluate_policies
from edtorch.run.episodes import Episode
from edtorch.run.training import Training


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--policies", type=int, default=8)
    parser.add_argument("--episodes", type=int, default=20)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    setup = build(compose(["experiment=bicycle", f"seeds={options.policies}"]))
    training = Training(
        setup.learner, setup.world, setup.seeds, setup.budget, schedule=setup.schedule
    )
    compiled(training)
    while not training.done:
        training.advance(4096)
    parameters = setup.learner.acting(training.learners)
    found: list[list[list[Episode]]] = []

    def rides(episodes: int, how: str) -> float:
        def work() -> None:
            found.append(
                evaluate_policies(
                    setup.learner.policy,
                    parameters,
                    setup.calm(),
                    setup.seeds,
                    episodes,
                    native="on" if how == "kernels" else "off",
                )
            )

        return cpu_seconds(work)

    rides(1, "kernels")
    table, content = {}, {}
    for how, episodes in (("kernels", options.episodes), ("torch", 1)):
        seconds = rides(episodes, how)
        ticks = sum(e.seconds for own in found[-1] for e in own) / setup.world.dt
        content[how] = {
            "episodes": episodes,
            "cpu_s": seconds,
            "us_per_tick": 1e6 * seconds / ticks,
        }
        table[how] = [str(episodes), f"{seconds:.2f}", f"{1e6 * seconds / ticks:.3f}"]
    print_table("", ["episodes each", "CPU s", "us per tick"], table)
    write_json(options.json, {"policies": options.policies, **content})


if __name__ == "__main__":
    main()
