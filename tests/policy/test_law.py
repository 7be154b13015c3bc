"""Policies on numpy beside torch, with settings that ``tests/app/test_acting.py`` does not have."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from edtorch.law import law_of
from edtorch.model.features import Affine, Identity, Pairwise
from edtorch.policy.bounded import OddPolicy
from edtorch.policy.knots import KnotPolicy
from edtorch.policy.policies import LinearPolicy, Policy, SquashedPolicy
from edtorch.policy.radial import RadialPolicy
from edtorch.policy.squash import Squash
from edtorch.types import Parameters
from tests.policy.test_bounded import LIFT, PLACES
from tests.policy.test_linear_gait import policy as straight
from tests.policy.test_phase import policy as phase
from tests.systems import f64, normal

SQUASH = Squash(f64([0.5, 0.0]), f64([2.0, 1.0]))
PERIOD, METRIC = f64([0.0, 0.0, 6.0, 0.0]), f64([1.0, torch.inf, 0.5, 2.0])
RADIAL = RadialPolicy(LIFT, PLACES, SQUASH, centres=4, normalised=False)
NEAREST, KNOTS = (KnotPolicy(6, SQUASH, PERIOD, METRIC, width) for width in (0.0, 1.0))
LINEAR, AFFINE = LinearPolicy(4, 2, Identity(4)), LinearPolicy(4, 2, Affine(4))
CASES: dict[str, tuple[Policy, Parameters]] = {
    "nearest": (NEAREST, NEAREST.initial([0])),
    "knots": (KNOTS, KNOTS.initial([0])),
    "radial": (RADIAL, RADIAL.initial([0])),
    "odd": (OddPolicy(RADIAL), RADIAL.initial([0])),
    "phase": (phase(), phase().initial([0])),
    "linear gait": (straight(), straight().initial([0])),
    "linear": (LINEAR, LINEAR.initial([0])),
    "affine": (AFFINE, AFFINE.initial([0])),
    "limited": (AFFINE, {**AFFINE.initial([0]), "limit": torch.zeros(1, 4).double()}),
}


@pytest.mark.parametrize("name", CASES)
def test_a_law_is_the_policy_of_one_state(name: str) -> None:
    generator = torch.Generator().manual_seed(0)
    policy, shaped = CASES[name]
    parameters = {n: normal(generator, *p.shape) for n, p in shaped.items()}
    if "limit" in parameters:
        parameters["limit"] = parameters["limit"].abs()
    law = law_of(policy, parameters)
    assert law is not None
    states = 2 * normal(generator, 40, 1, 4)
    found = np.stack([law(state[0].numpy()) for state in states])
    wanted = policy.action(parameters, states)[:, 0].numpy()
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12)
    assert np.ptp(found) > 0


def test_what_is_not_linear_is_left_to_torch() -> None:
    class Doubled(LinearPolicy):
        def action(self, parameters: Parameters, state: torch.Tensor) -> torch.Tensor:
            return 2 * super().action(parameters, state)

    for policy in (
        SquashedPolicy(4, 2, Identity(4)),
        LinearPolicy(4, 2, Pairwise(4)),
        Doubled(4, 2, Identity(4)),
    ):
        assert law_of(policy, policy.initial([0])) is None
