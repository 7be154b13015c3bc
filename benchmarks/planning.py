"""What planning the swing-up of a cart-pole costs, on one core.

    python -m benchmarks.planning [--starts 12] [--rounds 5] [--json FILE]

40 ticks of .1 s in two steps of Runge and Kutta's method, 37 terms with weights that are the true
equations of motion.  Milliseconds of one iteration of single and of multiple shooting (expansion,
backward pass, line search), of the gains that weigh noise, and microseconds of an imagined
roll-out.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from benchmarks.timing import interleaved, print_table, write_json
from edtorch.search.imagination import Futures, imagine
from edtorch.search.noise_aware import noise_aware_gains
from edtorch.search.shooting import connect, shoot
from edtorch.search.starts import lines, sinusoids
from tests.planning import HANGING, swing_up, swing_up_cost, tip_error

ROLL_OUTS = 100


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--starts", type=int, default=12)
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    model, generator = swing_up(), np.random.default_rng(0)
    cost = swing_up_cost(model)
    waves = sinusoids(HANGING, cost.ticks, 1, model.dt, options.starts, generator)
    straight = lines(model.structure, HANGING, np.zeros(4), cost.ticks, 1, model.dt, generator)
    single, multiple = shoot(model, cost, waves), connect(model, cost, straight)
    (plan, *_), spread = single.plans, 0.1 * generator.standard_normal((ROLL_OUTS, 4))
    weight, noise = np.tile(model.weight, (ROLL_OUTS, 1, 1)), np.zeros((ROLL_OUTS, cost.ticks, 4))
    small = 1e-4 * np.eye(4)
    seconds = interleaved(
        {
            "single": lambda: shoot(model, cost, waves),
            "multiple": lambda: connect(model, cost, straight),
            "gains": lambda: noise_aware_gains(model, cost, plan, 100 * small, small),
            "imagined": lambda: imagine(
                model, cost, plan, Futures(weight, HANGING + spread, noise)
            ),
        },
        rounds=options.rounds,
        patience=30.0,
    )
    reached = sum(bool((tip_error(plan.state[-10:]) < 0.25).all()) for plan in single.plans)
    content = {
        "starts": options.starts,
        "starts that swing up": reached,
        "seconds of a start": seconds["single"] / options.starts,
        "ms of an iteration, single shooting": 1e3 * seconds["single"] / sum(single.iterations),
        "ms of an iteration, multiple": 1e3 * seconds["multiple"] / sum(multiple.iterations),
        "ms of gains that weigh noise": 1e3 * seconds["gains"],
        "us of an imagined roll-out": 1e6 * seconds["imagined"] / ROLL_OUTS,
    }
    print_table("", [""], {name: [f"{value:.3g}"] for name, value in content.items()})
    write_json(options.json, content)


if __name__ == "__main__":
    main()
