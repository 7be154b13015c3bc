"""Problems with known answers for rivals: a linear system, whose expected values are sums."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

from edtorch.model.features import Identity
from edtorch.policy.policies import LinearPolicy
from edtorch.rewards import QuadraticReward
from edtorch.rivals.base import Problem, Search
from edtorch.run.scaled_sim import World
from sims.base import Sim
from sims.linear import LinearSystem

F, G = 1.05, 0.5
STATE_COST, ACTION_COST = 1.0, 0.3
TICKS = 12


def pause() -> None:
    """Nothing."""


def scalar(noise: float = 0.0, seeds: Sequence[int] = (3, 4)) -> Problem:
    """s' = 1.05 s + 0.5 a + noise, 12 ticks of 0.5 s from a start in [-1, 1]."""
    sim = LinearSystem([[F]], [[G]], noise=noise, dt=0.5, time_limit=0.5 * TICKS)
    return problem(sim, [STATE_COST], [ACTION_COST], seeds)


def problem(
    sim: Sim,
    state_cost: Sequence[float],
    action_cost: Sequence[float],
    seeds: Sequence[int],
) -> Problem:
    """With costs as diagonals."""
    costs = (torch.diag(torch.tensor(c, dtype=torch.float64)) for c in (state_cost, action_cost))
    n, m = len(state_cost), len(action_cost)
    return Problem(
        World(sim), LinearPolicy(n, m, Identity(n)), QuadraticReward(*costs), list(seeds), "off"
    )


def expected_rewards(gains: Tensor, noise: float, deviation: float) -> Tensor:
    """E r_t ``[T]`` of ``scalar`` where a_t = gains_t s_t + deviation e: the second moment of s."""
    moment = torch.tensor(1 / 3, dtype=torch.float64)
    rewards: list[Tensor] = []
    for gain in gains:
        squared_action = gain**2 * moment + deviation**2
        rewards.append(-(STATE_COST * moment + ACTION_COST * squared_action))
        moment = (F + G * gain) ** 2 * moment + (G * deviation) ** 2 + noise**2
    return torch.stack(rewards)


def constant(gain: float) -> Tensor:
    """The same gain at every tick."""
    return torch.full((TICKS,), gain, dtype=torch.float64)


def best_gain(noise: float) -> float:
    """The constant gain with the greatest sum of expected rewards, to 1e-4."""
    grid = torch.arange(-2.5, 0.5, 1e-4, dtype=torch.float64)
    values = torch.stack([expected_rewards(g.expand(TICKS), noise, 0.0).sum() for g in grid[::100]])
    coarse = float(grid[::100][values.argmax()])
    fine = grid[(grid - coarse).abs() < 0.02]
    values = torch.stack([expected_rewards(g.expand(TICKS), noise, 0.0).sum() for g in fine])
    return float(fine[values.argmax()])


def search_for(search: Search, pieces: int) -> Tensor:
    """Weights ``[S, m, n]`` after so many pieces of work for every seed."""
    for _ in range(pieces):
        search.advance([True] * len(search.accounts), pause)
    return search.parameters["weight"]
