"""How tight the corrected bounds are: bound over error on random smooth systems, per dimension.

Gaussian noise, weak (v0 .02), ten steps from a known state, exact constants, errors by coupled
Monte Carlo; medians over systems and steps of the ratios whose error Monte Carlo resolves (more
than 8 standard errors, and not rounding).  Makes the first table of docs/theory.md, and JSON:

    python -m studies.bounds [--json FILE] [--docs docs/theory.md]
"""

from __future__ import annotations

import argparse
import statistics
from pathlib import Path as File

import torch

from benchmarks.timing import write_json
from edtorch.bounds import GAUSSIAN, bound_errors, definition_weights
from tests.bounds.coupled import Estimate, coupled, gaussian, one_step
from tests.bounds.systems import smooth_system

HORIZON, DISCOUNT = 10, 0.95
MARK = "<!-- bounds table -->"
SIZES = {1: (16, 400_000), 2: (12, 200_000), 5: (12, 100_000), 14: (4, 40_000)}
"""Systems and Monte Carlo samples by dimension."""
COLUMNS = ("T1", "T2", "T3", "mean", "covariance", "reward", "value")


def ratios(n: int, systems: int, samples: int) -> dict[str, list[float]]:
    """Bound over error, wherever the error is resolved."""
    found: dict[str, list[float]] = {name: [] for name in COLUMNS}

    def note(name: str, bound: float, error: Estimate) -> None:
        if error.size > max(8 * error.se, 1e-12):
            found[name].append(bound / error.size)

    weights = definition_weights(DISCOUNT, HORIZON)
    for seed in range(systems):
        system = smooth_system(n, seed, v0=0.02)
        path, constants = system.path(HORIZON, None), system.constants()
        bounds = bound_errors(path, constants, noise_law=GAUSSIAN, weights=weights)
        steps, value = coupled(system, path, gaussian, samples, weights, seed)
        for t, step in enumerate(steps):
            T1, T2, T3 = one_step(path, t, step, constants)
            if t < HORIZON:
                note("T1", T1, steps[t + 1].mean)
                note("T2", T2, steps[t + 1].cov)
            note("T3", T3, step.reward)
            note("mean", bounds.mean[t], step.mean)
            note("covariance", bounds.cov[t], step.cov)
            note("reward", bounds.reward[t], step.reward)
        note("value", bounds.value, value)
    return found


def insert(page: File, mark: str, table: str) -> None:
    """Replace what stands between two marks on a page."""
    before, _, after = page.read_text(encoding="utf-8").split(mark)
    page.write_text(f"{before}{mark}\n{table}\n{mark}{after}", encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(description="How tight the corrected bounds are.")
    parser.add_argument("--json", type=File)
    parser.add_argument("--docs", type=File)
    options = parser.parse_args()
    torch.set_num_threads(1)
    results: dict[int, dict[str, dict[str, float | int] | None]] = {}
    lines = [f"| n | {' | '.join(COLUMNS)} |", f"|---|{'---|' * len(COLUMNS)}"]
    for n, (systems, samples) in SIZES.items():
        found = ratios(n, systems, samples)
        results[n] = {
            name: {"median": statistics.median(r), "least": min(r), "count": len(r)} if r else None
            for name, r in found.items()
        }
        cells = [f"{statistics.median(found[c]):.3g}" if found[c] else "" for c in COLUMNS]
        lines.append(f"| {n} | {' | '.join(cells)} |")
        print(lines[-1], flush=True)
    content = {
        "command": "python -m studies.bounds",
        "systems_and_samples": SIZES,
        "results": results,
    }
    write_json(options.json, content)
    if options.docs is not None:
        insert(options.docs, MARK, "\n".join(lines))


if __name__ == "__main__":
    main()
