"""The force of the ground on a biped, learned from what is read, against Newton's law."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from edtorch.errors import FitError
from edtorch.model.families import ChainModel
from edtorch.model.mechanism import Structure
from edtorch.model.told import Told
from edtorch.search.ground import fit_ground, ground_features
from edtorch.types import Transition
from sims.rows import TORCH, unstacked
from sims.tasks.five_links import accelerations_over, ground_over
from sims.tasks.walker import Walker
from tests.systems import f64

SPEC = Walker().spec
UNIT = f64([q.scale for q in SPEC.state])


def structure() -> Structure:
    told = Told.of(SPEC, ignored=["steps", "force_x", "force_y"])
    return ChainModel().structures(told)["chain"]


def transitions(count: int) -> Transition:
    """Random states and torques; rates that change by dt times their accelerations, and the force
    read a tick later."""
    generator = np.random.default_rng(0)
    q, v = (torch.from_numpy(s * generator.standard_normal((count, 5))) for s in (0.4, 2.0))
    torque = torch.from_numpy(20 * generator.standard_normal((count, 4)))
    none = (torch.zeros(count).double(), torch.zeros(count).double())
    angles, rates, dt = unstacked(q), unstacked(v), 0.01
    a = accelerations_over(TORCH)(angles, rates, unstacked(torque), none)
    force = ground_over(TORCH)(angles, rates, a)
    nothing = torch.zeros(count, 3).double()
    state = torch.cat([torch.stack([q, v], -1).flatten(1), nothing], -1)
    moved = torch.stack([q, v + dt * torch.stack(a, -1)], -1).flatten(1)
    after = torch.cat([moved, nothing[:, :1], torch.stack(force, -1)], -1)
    valid = torch.ones(count, dtype=torch.bool)
    return Transition(state / UNIT, torque, after / UNIT, torch.tensor(dt).double(), valid)


def test_the_force_is_that_of_newton() -> None:
    built, given = structure(), transitions(400)
    found = fit_ground(built, given, (11, 12), UNIT)
    new = transitions(500)
    told = (new.next_state * UNIT)[:, 11:]
    left = ground_features(built, new, found.hinge) @ torch.from_numpy(found.weight).mT - told
    assert float(left.abs().max()) < 1e-2 < 1e-3 * float(told.std())


def test_ticks_in_which_motion_stops_weigh_little() -> None:
    built, given = structure(), transitions(400)
    given.next_state[::40, 1:10:2] = given.state[::40, 1:10:2]
    found = fit_ground(built, given, (11, 12), UNIT)
    new = transitions(100)
    told = (new.next_state * UNIT)[:, 11:]
    left = ground_features(built, new, found.hinge) @ torch.from_numpy(found.weight).mT - told
    assert float(left.abs().median()) < 1.0


def test_too_few_ticks_are_refused() -> None:
    with pytest.raises(FitError, match="transitions: 12 without an impact, expected 21 or more"):
        fit_ground(structure(), transitions(12), (11, 12), UNIT)
