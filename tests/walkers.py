"""The walker's mechanics as weights of ``edtorch.model.chain``."""

from __future__ import annotations

import numpy as np
import torch
from torch import Tensor

from edtorch.model.chain import impact_terms
from edtorch.model.families import ChainModel
from edtorch.model.impact import Impact
from edtorch.model.lift import Lift
from edtorch.model.mechanism import Structure
from edtorch.model.stops import Stops
from edtorch.model.strike import Strike
from edtorch.model.terms import Factors
from edtorch.model.told import Told
from edtorch.search.ground import GroundForce
from sims.tasks.five_links import CENTRES, GRAVITY, INERTIAS, MASSES
from sims.tasks.walker import Walker

WALKER = Walker()
TOLD = Told.of(WALKER.spec, ignored=("steps", "force_x", "force_y"))
UNIT = np.array([quantity.scale for quantity in WALKER.spec.state])
ACTION_UNIT = np.array([quantity.scale for quantity in WALKER.spec.action])
D = CENTRES.T @ np.diag(MASSES) @ CENTRES + np.diag(INERTIAS)
G = np.array(MASSES) @ CENTRES
TORQUES = np.array([[1, 0, 0, 0], [-1, 1, 0, 0], [0, -1, -1, 0], [0, 0, 1, -1], [0, 0, 0, 1]])
_RATE = 6.0
"""rad/s: the unit of rates."""


def structure() -> Structure:
    """Of ``TOLD``."""
    return ChainModel().structures(TOLD)["chain"]


def placed(terms: dict[tuple[int, Factors], int], at: list[int], i: int, j: int) -> list[int]:
    """The places of the two terms of cos(q_i - q_j) f_j."""
    return [terms[j, tuple(sorted((at[i] + k, at[j] + k)))] for k in (1, 0)]


def places(built: Structure) -> dict[tuple[int, Factors], int]:
    """Of the terms, by derivative and factors."""
    return {
        (int(j), tuple(int(k) for k in row if k)): place
        for place, (j, row) in enumerate(
            zip(built.terms.derivative, built.terms.factors, strict=True)
        )
    }


def true_weight(built: Structure) -> Tensor:
    """Weights ``[5, K]`` that are ``sims.tasks.five_links`` exactly, scaled units."""
    terms, at = places(built), [int(built.lift.at[2 * i]) for i in range(5)]
    rates = [int(built.lift.at[2 * i + 1]) for i in range(5)]
    weight = torch.zeros(5, built.terms.count, dtype=torch.float64)
    for i in range(5):
        for j in range(5):
            if i == j:
                continue
            share = D[i, j] / D[i, i]
            weight[i, placed(terms, at, i, j)] = -share
            for sign, first, second in ((-1, at[i], at[j] + 1), (1, at[i] + 1, at[j])):
                key = (-1, tuple(sorted((first, second, rates[j], rates[j]))))
                weight[i, terms[key]] = sign * share * _RATE
        weight[i, terms[-1, (at[i],)]] = GRAVITY * G[i] / D[i, i] / _RATE
        for k in range(4):
            column = terms[-1, (built.lift.action_at + k,)]
            weight[i, column] = TORQUES[i, k] * ACTION_UNIT[k] / D[i, i] / _RATE
    return weight


def drawn(count: int, seed: int = 0) -> tuple[Tensor, Tensor]:
    """States ``[count, 13]`` and actions ``[count, 4]``, scaled."""
    generator = torch.Generator().manual_seed(seed)
    state = torch.randn(count, 13, generator=generator, dtype=torch.float64)
    return 0.5 * state, 0.5 * torch.randn(count, 4, generator=generator, dtype=torch.float64)


LEVERS = np.array([-0.4, -0.4, 0.0, 0.4, 0.4])
"""m, of the new stance foot before a strike: its velocity forward is the sum of these times
cos(q) v, up the sum of these times -sin(q) v."""
STOPS = Stops.of(
    TOLD,
    {
        f"{leg}_knee": {
            "of": {f"{leg}_shank": 1.0, f"{leg}_thigh": -1.0},
            "column": f"{leg}_knee",
            "at": 0.0,
        }
        for leg in ("stance", "swing")
    },
)


def true_impact(built: Structure) -> Impact:
    """``sims.tasks.five_links.impact_over`` without its stops, exactly: row i has (D_ij + G_i
    lever_j) / D_ii cos(q_i - q_j) v_j."""
    terms, _ = impact_terms(TOLD, built.lift)
    rows = {tuple(k for k in row if k): n for n, row in enumerate(terms.factors.tolist())}
    at = [int(built.lift.at[2 * i]) for i in range(5)]
    weight = torch.zeros(5, terms.count, dtype=torch.float64)
    for i in range(5):
        for j in range(5):
            rate, share = int(built.lift.at[2 * j + 1]), (D[i, j] + G[i] * LEVERS[j]) / D[i, i]
            if i == j:
                weight[i, rows[(rate,)]] = share
            else:
                for k in (0, 1):
                    weight[i, rows[tuple(sorted((at[i] + k, at[j] + k, rate)))]] = share
    return Impact(terms, weight, 0.0, 0)


HEIGHT: dict[str, float] = {
    "stance_shank": 0.4,
    "stance_thigh": 0.4,
    "swing_thigh": -0.4,
    "swing_shank": -0.4,
}
"""Of the swing foot, m: the sum of these times the cosines."""


def strike(height: dict[str, float] | None = HEIGHT) -> Strike:
    """Of the swing foot."""
    return Strike.of(
        TOLD,
        Lift.of(TOLD),
        height=height,
        swap={
            "stance_shank": "swing_shank",
            "stance_thigh": "swing_thigh",
            "stance_knee": "swing_knee",
            "stance_hip": "swing_hip",
        },
        counter="steps",
    )


def true_ground() -> GroundForce:
    """``sims.tasks.five_links.ground_over`` exactly."""
    weight = np.zeros((2, 21))
    weight[0, 1:20:4], weight[0, 2:20:4] = _RATE * G, -(_RATE**2) * G
    weight[1, 0:20:4], weight[1, 3:20:4] = -_RATE * G, -(_RATE**2) * G
    weight[1, 20] = GRAVITY * sum(MASSES)
    return GroundForce(weight, np.arange(0, 10, 2), np.zeros(2))
