"""Footnote 2's unit of cost: how long a bicycle stands that nobody touches."""

from __future__ import annotations

import math
import statistics
from dataclasses import dataclass
from typing import Any

import torch

from edtorch.run.evaluation import evaluate_controller
from edtorch.run.scaled_sim import World
from sims.base import Outcome
from sims.bicycle import Bicycle

SEEDS = range(20)


@dataclass(frozen=True)
class Falls:
    """Seconds until the fall, of ``runs`` runs; low, high: 95 % interval of the mean."""

    runs: int
    mean_s: float
    deviation_s: float

    def as_json(self) -> dict[str, Any]:
        reach = statistics.NormalDist().inv_cdf(0.975) * self.deviation_s / math.sqrt(self.runs)
        return {
            "runs": self.runs,
            "mean_s": self.mean_s,
            "deviation_s": self.deviation_s,
            "low_s": self.mean_s - reach,
            "high_s": self.mean_s + reach,
        }


def zero_policy_falls(episodes: int) -> Falls:
    """Of ``episodes`` episodes of each of 20 seeds, without torque and without displacement."""
    world = World(Bicycle(), torch.float64)
    actions = len(world.spec.action)
    found = evaluate_controller(
        lambda state: state.new_zeros(len(state), actions), world, SEEDS, episodes
    )
    ended = [episode for own in found for episode in own]
    if any(episode.outcome is not Outcome.FAILED for episode in ended):
        raise AssertionError("a bicycle that nobody touches did not fall")
    seconds = [episode.seconds for episode in ended]
    return Falls(len(seconds), statistics.fmean(seconds), statistics.stdev(seconds))
