"""How large a command may be: against simulated responses, one by one."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch
from torch import Tensor

from edtorch.learner.annealing import Annealed
from edtorch.learner.limit import Ramp, Safe
from edtorch.model.features import Affine, Identity
from edtorch.model.models import DerivativeModel
from edtorch.model.noise import LinearNoise, ResidualNoise
from edtorch.policy.policies import LinearPolicy, bounded
from tests.systems import normal

N, M, COMMAND, DT, STEPS = 4, 2, 3, 0.05, 20
WIDE = Ramp(COMMAND, N, Annealed(50.0, 50.0, 1.0), torch.float64)
SHARE = Annealed(0.7, 0.7, 1.0)
MODEL = DerivativeModel(N, M, Identity(N + M), torch.zeros(N, dtype=torch.float64))
POLICY = LinearPolicy(N, M, Identity(N))


def safe(**changes: object) -> Safe:
    plain = Safe(WIDE, MODEL, POLICY, ResidualNoise(1.0), DT, STEPS, ((0, 1.5), (1, 0.8)), SHARE)
    return replace(plain, **changes)


def learned(batch: int) -> tuple[dict[str, Tensor], dict[str, Tensor], dict[str, Tensor], Tensor]:
    """Random models, policies and noise of stable loops, and ages."""
    g = torch.Generator().manual_seed(3)
    weight = 0.6 * normal(g, batch, N, N + M)
    weight[:, range(N), range(N)] -= 2.0
    root = 0.3 * normal(g, batch, N, N)
    policy = 0.5 * normal(g, batch, M, N)
    return {"weight": weight}, {"weight": policy}, {"nu": root @ root.mT}, torch.zeros(batch)


def loop(model: Tensor, policy: Tensor) -> np.ndarray:
    return np.eye(N) + DT * (model[:, :N] + model[:, N:] @ policy).numpy()


def responses(A: np.ndarray) -> np.ndarray:
    """States of the loop with the command held at 1, from rest, ``[STEPS, N]``."""
    state = np.zeros(N)
    rows = []
    for _ in range(STEPS):
        state[COMMAND] = 1.0
        state = A @ state
        rows.append(state)
    return np.array(rows)


def test_a_ramp_bounds_one_component() -> None:
    ramp = Ramp(1, 3, Annealed(0.5, 2.0, 10.0), torch.float64)
    bound = ramp({}, {}, {}, torch.tensor([0, 10**6]))
    assert bound.tolist() == [[math.inf, 0.5, math.inf], [math.inf, 2.0, math.inf]]
    seen = bounded(torch.tensor([[9.0, -9.0, 9.0], [9.0, 1.5, 9.0]]).double(), bound)
    assert seen.tolist() == [[9.0, -0.5, 9.0], [9.0, 1.5, 9.0]]


def test_the_largest_command_uses_up_its_share_of_a_limit() -> None:
    model, policy, noise, ages = learned(6)
    found = safe()(model, policy, noise, ages)
    assert bool(torch.isinf(found[:, [0, 1, 2]]).all())
    for row in range(6):
        path = responses(loop(model["weight"][row], policy["weight"][row]))
        used = float(found[row, COMMAND]) * np.abs(path).max(0)
        # The command that is allowed meets one of the limits, and exceeds none.
        assert max(used[0] / (0.7 * 1.5), used[1] / (0.7 * 0.8)) == pytest.approx(1.0, rel=1e-10)


def test_deviations_keep_the_noise_off_the_limit() -> None:
    # Paths with the allowed command, simulated: at no step do more of them exceed the share of a
    # limit than a normal deviation of k allows, and at the worst step about as many do.
    model, policy, noise, ages = learned(3)
    k = 1.5
    rule = safe(deviations=k, limits=((0, 1.5),))
    found = rule(model, policy, noise, ages)
    wider = safe(limits=((0, 1.5),))(model, policy, noise, ages)
    assert bool((found[:, COMMAND] < wider[:, COMMAND]).all())
    g = np.random.default_rng(0)
    beyond = 0.5 * math.erfc(k / math.sqrt(2))
    for row in range(3):
        A = loop(model["weight"][row], policy["weight"][row])
        command = float(found[row, COMMAND])
        root = np.linalg.cholesky(DT * noise["nu"][row].numpy() + 1e-12 * np.eye(N))
        state = np.zeros((20_000, N))
        sign = math.copysign(1.0, max(responses(A)[:, 0], key=abs))
        rates = []
        for _ in range(STEPS):
            state[:, COMMAND] = command
            state = state @ A.T + g.standard_normal(state.shape) @ root.T
            rates.append(np.mean(sign * state[:, 0] > 0.7 * 1.5))
        assert max(rates) == pytest.approx(beyond, abs=0.01)


def test_knows_no_limit_where_a_command_does_nothing_and_none_where_all_explodes() -> None:
    model, policy, noise, ages = learned(2)
    idle = {"weight": torch.zeros_like(model["weight"])}
    assert safe()(idle, policy, noise, ages)[:, COMMAND].tolist() == [50.0, 50.0]
    wild = {"weight": 1e200 * model["weight"]}
    assert safe()(wild, policy, noise, ages)[:, COMMAND].tolist() == [0.0, 0.0]
    # The noise alone uses up all of the limit.
    loud = {"nu": 1e6 * noise["nu"]}
    assert safe(deviations=1.0)(model, policy, loud, ages)[:, COMMAND].tolist() == [0.0, 0.0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"limits": ()}, "limits: expected at least one component"),
        ({"limits": ((0, -1.0),)}, r"limits\[0\]=-1.0: expected a number > 0"),
        ({"limits": ((COMMAND, 1.0),)}, "the command itself has a limit"),
        ({"share": Annealed(0.5, 1.5, 1.0)}, r"share=1.5: expected a number in \(0, 1\]"),
        ({"share": Annealed(0.0, 0.5, 1.0)}, r"share_start=0.0: expected a number in"),
        ({"deviations": -1.0}, "deviations=-1.0: expected a number >= 0"),
        ({"deviations": 1.0, "noise": None}, "deviations=1.0: expected a constant rule"),
        ({"deviations": 1.0, "noise": LinearNoise(1.0)}, "expected a constant rule"),
        ({"horizon": 0}, "horizon=0: expected at least one step"),
        ({"policy": LinearPolicy(N, M, Affine(N))}, "features: expected a linear model"),
    ],
    ids=str,
)
def test_refuses_what_cannot_be(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        safe(**changes)


def test_a_ramp_needs_bounds() -> None:
    with pytest.raises(ValueError, match=r"start=0.0: expected a number > 0"):
        Ramp(0, 2, Annealed(0.0, 1.0, 1.0), torch.float64)


def test_the_share_grows_with_age() -> None:
    model, policy, noise, _ = learned(2)
    rule = safe(share=Annealed(0.2, 0.8, 100.0))
    young, old = (
        rule(model, policy, noise, torch.full((2,), age))[:, COMMAND] for age in (0, 10**6)
    )
    assert torch.allclose(old, 4 * young, rtol=1e-9)


def test_no_command_takes_an_action_beyond_its_bounds() -> None:
    model, policy, noise, ages = learned(4)
    bounds = ((0, 0.2), (1, 0.3))
    found = safe(limits=((0, 1e6),), actions=bounds)(model, policy, noise, ages)
    for row in range(4):
        theta = policy["weight"][row].numpy()
        path = responses(loop(model["weight"][row], policy["weight"][row]))
        states = np.vstack([np.eye(N)[COMMAND], path[:-1]])
        states[:, COMMAND] = 1.0
        used = float(found[row, COMMAND]) * np.abs(states @ theta.T).max(0)
        assert max(used / np.array([0.2, 0.3])) == pytest.approx(1.0, rel=1e-9)
    with pytest.raises(ValueError, match=r"actions\[0\]=0.0: expected a number > 0"):
        safe(actions=((0, 0.0),))
