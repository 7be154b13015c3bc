"""How many simulated seconds until a policy stabilises the bicycle, though nobody has tried it.

After every tick each learner's policy is closed around the true bicycle, linearised upright and
straight: it stabilises it if all eigenvalues but the heading's are inside the unit circle, and
keeps it on course if the heading's is as well.  Told is the first tick from which on that holds to
the end of what is watched, over seeds.

    python -m studies.stabilising [--seeds 200] [--seed 0] [--seconds 10] [--json FILE]
        [OVERRIDE ...]
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from benchmarks.timing import print_table, write_json
from edtorch.app.build import build
from edtorch.app.compose import compose
from edtorch.run.training import Training
from sims.base import spec_index
from sims.bicycle import Bicycle
from sims.bicycle.lqr import REDUCED, linearised

HEADING = REDUCED.index("heading")


def radii(F: Tensor, G: Tensor, gains: Tensor) -> tuple[Tensor, Tensor]:
    """Spectral radius ``[B]`` of F + G K without and with the heading; gains K ``[B, 2, 5]``."""
    closed = F + G @ gains
    upright = closed[:, :HEADING, :HEADING]
    return tuple(torch.linalg.eigvals(A).abs().amax(-1) for A in (upright, closed))


def first_for_good(holds: np.ndarray) -> np.ndarray:
    """For each column of ``[T, B]`` the first row from which on it holds, T if it never does."""
    broken = ~holds[::-1]
    return np.where(broken.any(0), len(holds) - broken.argmax(0), 0)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--seeds", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--json", type=Path)
    parser.add_argument("overrides", nargs="*", default=[], metavar="OVERRIDE")
    options = parser.parse_args()
    config = compose(
        [
            "experiment=bicycle",
            *options.overrides,
            f"seeds={options.seeds}",
            f"seed={options.seed}",
            f"train.seconds={options.seconds}",
            "compute.native=off",
        ],
    )
    setup = build(config)
    sim = setup.world.sim
    assert isinstance(sim, Bicycle), "expected a bicycle"
    training = Training(
        setup.learner, setup.world, setup.seeds, setup.budget, schedule=setup.schedule
    )
    F, G = linearised(sim.physics, sim.integrate, sim.dt)
    spec = setup.world.spec
    # Gains in physical units, in the regulator's order; its heading is minus the angle to the goal.
    names = [name if name != "heading" else "angle_to_goal" for name in REDUCED]
    order = spec_index(spec, names)
    scale = torch.tensor([spec.state[i].scale for i in order], dtype=torch.float64)
    scale[HEADING] *= -1
    size = torch.tensor([q.scale for q in spec.action], dtype=torch.float64)
    found: list[list[Tensor]] = [[], []]
    while not training.done:
        training.advance(1)
        weight = training.learners.policy["weight"].to(torch.float64)[..., order]
        for kept, radius in zip(found, radii(F, G, size[:, None] * weight / scale), strict=True):
            kept.append(radius < 1)
    table, content = {}, {}
    for name, holds in zip(("upright", "upright and on course"), found, strict=True):
        seconds = sim.dt * first_for_good(torch.stack(holds).numpy())
        quantiles = np.quantile(seconds, [0.5, 0.95, 1.0], method="higher").tolist()
        table[name] = [f"{q:.2f}" for q in quantiles]
        content[name] = dict(zip(("median", "p95", "max"), quantiles, strict=True))
    print(f"simulated seconds until the policy stabilises, {options.seeds} seeds")
    print_table("", ["median", "p95", "max"], table)
    write_json(
        options.json,
        {
            "seconds": content,
            "seeds": options.seeds,
            "seed": options.seed,
            "watched": options.seconds,
            "overrides": options.overrides,
        },
    )


if __name__ == "__main__":
    main()
