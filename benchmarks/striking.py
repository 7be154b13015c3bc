"""What a tick through stops and strikes costs beside a tick of the same model without them.

    python -m benchmarks.striking [--rounds 7] [--json FILE]

A walker of five links with its true weights: 100 terms, one step of Runge and Kutta's method in a
tick.  Microseconds of a tick, by what happens in it: free motion, a knee held at its stop, and in
roll-outs of 60 ticks from the start, falling over without torques.  Smooth: no stops, and a height
that never falls.
"""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.timing import interleaved, print_table, write_json
from edtorch.search.striking import StrikingModel, struck_states
from edtorch.search.tick_model import TickModel
from sims.tasks.walker import START
from tests.walkers import STOPS, strike, structure, true_impact, true_weight

ROWS = 200
HELD = (0.1, 0.1, 0.0, 0.3, 0.6)
"""rad: the stance knee at its stop."""


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    built = structure()
    weight = true_weight(built).numpy()
    free = TickModel(built, weight, 0.01, np.zeros(4), np.ones(4), 1, STOPS)
    hybrid = StrikingModel(free, strike(), true_impact(built))
    # A height that stays above zero, no stops: the same kernel does nothing but free motion.
    above = replace(hybrid.strike, height=np.eye(len(hybrid.strike.height))[0])
    smooth = replace(hybrid, free=replace(free, stops=None), strike=above)
    works: dict[str, Callable[[], object]] = {}
    push = np.array([-0.5, 0.0, 0.0, 0.0])  # keeps the stance knee at its stop
    for kind, start, action, ticks in (
        ("free", START, 0 * push, 1),
        ("held", HELD, push, 1),
        ("roll-out", START, 0 * push, 60),
    ):
        state = np.zeros((ROWS if ticks == 1 else 10, 13))
        state[:, 0:10:2] = start
        actions = np.broadcast_to(action, (len(state), ticks, 4))
        for name, model in (("smooth", smooth), ("hybrid", hybrid)):
            works[f"{kind}, {name}"] = partial(struck_states, model, state, actions)
    seconds = interleaved(works, rounds=options.rounds)
    content, rows = {}, {}
    for kind, ticks in (("free", ROWS), ("held", ROWS), ("roll-out", 600)):
        each = [1e6 * seconds[f"{kind}, {name}"] / ticks for name in ("smooth", "hybrid")]
        content[kind] = {"smooth": each[0], "hybrid": each[1], "ratio": each[1] / each[0]}
        rows[kind] = [f"{value:.2f}" for value in content[kind].values()]
    print_table("us of a tick", ["smooth", "hybrid", "ratio"], rows)
    write_json(options.json, content)


if __name__ == "__main__":
    main()
