"""Run folders made by hand: small, and like those of edtorch-train where a report looks."""

from __future__ import annotations

import json
import statistics
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import yaml


def spread(values: Sequence[float | None]) -> dict[str, Any]:
    known = [v for v in values if v is not None]
    return {
        "per_seed": list(values),
        "median": statistics.median(known) if known else None,
        "min": min(known, default=None),
        "max": max(known, default=None),
    }


def learners(
    folder: Path,
    falls: Sequence[int],
    *,
    seed: int = 0,
    never: Sequence[int] = (),
    domain: str = "sims.bicycle.Bicycle",
    more: dict[str, Any] | None = None,
    **settings: Any,
) -> Path:
    """A finished run; never: rows that did not ride; more: of the summary; settings: groups."""
    size = len(falls)
    config = {
        "domain": {"_target_": domain, "dt": 0.01},
        "step": {"_target_": "edtorch.policy.steps.SaturatedStep", "alpha": 0.1},
        "log": {"every": 5},
        "seed": seed,
        "seeds": size,
    } | settings
    seeds = [seed + k for k in range(size)]
    summary = {
        "seeds": seeds,
        "falls_before_first_ride": spread(list(falls)),
        "seconds_before_first_ride": spread([2.0 * f + 1 for f in falls]),
        "falls_after_first_ride": spread([0] * size),
        "never_rode": [seeds[k] for k in never],
        "goal_rate": spread([1.0] * size),
        "goal_time_s": spread([360.0 + f for f in falls]),
        "cpu_s": 2.0 * size,
        "command": f"edtorch-train seed={seed}",
        "versions": {"torch": "2.13.0"},
    } | (more or {})
    return write(folder, config, summary)


def search(folder: Path, goal: int, total: int, *, seed: int = 0, **settings: Any) -> Path:
    """A finished random search."""
    config = {"domain": {"_target_": "sims.bicycle.Bicycle"}, "seed": seed} | settings
    shares = {
        "goal": {"count": goal, "total": total},
        "rejected": {"count": total - goal, "total": total},
    }
    return write(folder, config, {"seed": seed, **shares, "distance_m": 1007.0, "cpu_s": 3.0})


def write(folder: Path, config: dict[str, Any], summary: dict[str, Any]) -> Path:
    folder.mkdir(parents=True)
    (folder / "config.yaml").write_text(yaml.safe_dump(config))
    (folder / "summary.json").write_text(json.dumps(summary))
    return folder
