"""Path regression on trials of a cart-pole."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from edtorch.errors import NonFiniteError
from edtorch.model.evidence import Evidence, ard, ridge
from edtorch.model.mechanism import Structure, runge_kutta
from edtorch.model.path_fit import fit_paths
from edtorch.model.told import Told
from edtorch.types import Transition
from tests.cart_poles import DT, moved, structure, told, trial, true_weight

TOLD = told()
UNIT = torch.tensor(TOLD.unit, dtype=torch.float64)


def _error(built: Structure, weight: Tensor, count: int = 200) -> Tensor:
    """Root mean square error of the rates after a tick, m/s and rad/s, over broad states."""
    generator = torch.Generator().manual_seed(9)
    both = 2 * torch.rand(count, 5, generator=generator, dtype=torch.float64) - 1
    turn = torch.tensor([1.0, 1.0, math.pi, 1.0], dtype=torch.float64)
    state, action = both[:, :4] * turn, both[:, 4:]
    error = UNIT * runge_kutta(built, weight, state, action, DT) - moved(UNIT * state, 10 * action)
    return error.square().mean(0).sqrt()[[1, 3]]


def _steady(ticks: int, seed: int = 0) -> Transition:
    """Noise-free."""
    return trial(TOLD, seed, ticks, noise=0.0)


def test_recovers_the_weights_where_features_at_the_start_do_not() -> None:
    """Noise-free: the fixed point of the passes is the mechanism."""
    built, data = structure(TOLD), _steady(80)
    found = fit_paths(built, data, passes=6)
    assert found.fallbacks == 0
    torch.testing.assert_close(found.weight, true_weight(built), rtol=0, atol=5e-3)
    change = built.difference(data.next_state, data.state)[:, [1, 3]] / DT
    phi = built.terms(built.lift(data.state, data.action))
    factor = torch.cat([torch.ones_like(phi[:, :1]), change], -1)
    X = phi * factor[:, torch.from_numpy(built.terms.derivative) + 1]
    start = ard(X, change.mT, torch.ones_like(change.mT), built.allowed)
    assert bool((_error(built, start.weight) > 20 * _error(built, found.weight)).all())


def test_each_pass_comes_nearer() -> None:
    built, data = structure(TOLD), _steady(80)
    errors = torch.stack([_error(built, fit_paths(built, data, k).weight) for k in (1, 2, 4)])
    assert bool((errors[1:] < 0.5 * errors[:-1]).all())


@pytest.mark.parametrize("evidence", [ard, ridge])
def test_the_path_of_a_free_mass_is_exact_in_one_pass(evidence: Evidence) -> None:
    """x'' = 2 u - 3: rates are linear in time, and Simpson's rule is exact."""
    mass = Told(("x", "v"), (1.0, 1.0), (False, False), (-1, 0), ("u",), invariant=frozenset("x"))
    built = structure(mass, "products")
    generator = torch.Generator().manual_seed(0)
    state = torch.randn(20, 2, generator=generator, dtype=torch.float64)
    action = torch.randn(20, 1, generator=generator, dtype=torch.float64)
    dt = 0.05 + 0.1 * torch.rand(20, generator=generator, dtype=torch.float64)
    f = 2 * action[:, 0] - 3
    after = torch.stack(
        [state[:, 0] + dt * state[:, 1] + dt**2 * f / 2, state[:, 1] + dt * f], dim=-1
    )
    data = Transition(state, action, after, dt, torch.ones(20, dtype=torch.bool))
    found = fit_paths(built, data, passes=1, evidence=evidence)
    torch.testing.assert_close(runge_kutta(built, found.weight, state, action, dt), after,
                               rtol=0, atol=1e-6)  # fmt: skip


def test_one_noisy_trial_is_enough() -> None:
    """4 s of random actions, readings off by .01: the prototype had .01-.03 m/s, .06-.08 rad/s."""
    built = structure(TOLD)
    errors = torch.stack([_error(built, fit_paths(built, trial(TOLD, k)).weight) for k in range(3)])
    assert bool((errors.median(0).values < torch.tensor([0.03, 0.06])).all())


def test_one_wild_transition_does_not_matter() -> None:
    built, data = structure(TOLD), trial(TOLD, 1)
    wild = data.next_state.clone()
    wild[20, 1] += 20.0
    wild[20, 3] -= 30.0
    before = _error(built, fit_paths(built, data).weight)
    after = _error(built, fit_paths(built, replace(data, next_state=wild)).weight)
    assert bool((after < 3 * before + 0.02).all())


def test_the_order_of_rows_and_units_change_nothing() -> None:
    data = trial(TOLD, 2)
    built = structure(TOLD)
    found = fit_paths(built, data)
    order = torch.randperm(40, generator=torch.Generator().manual_seed(0))
    mixed = Transition(data.state[order], data.action[order], data.next_state[order], data.dt,
                       data.valid[order])  # fmt: skip
    torch.testing.assert_close(fit_paths(built, mixed).weight, found.weight, rtol=1e-6, atol=1e-6)
    other = told(speed=0.5, rate=20.0, position=3.0)
    rebuilt, factor = structure(other), UNIT / torch.tensor(other.unit, dtype=torch.float64)
    scaled = replace(data, state=data.state * factor, next_state=data.next_state * factor)
    again = fit_paths(rebuilt, scaled)
    predicted = runge_kutta(built, found.weight, data.state, data.action, DT)
    torch.testing.assert_close(
        runge_kutta(rebuilt, again.weight, scaled.state, data.action, DT) / factor,
        predicted, rtol=0, atol=1e-6,
    )  # fmt: skip


def test_rows_that_are_not_valid_are_left_out() -> None:
    built, data = structure(TOLD), trial(TOLD, 3)
    valid = torch.ones(40, dtype=torch.bool)
    valid[5] = False
    broken = data.next_state.clone()
    broken[5] = torch.nan
    kept = Transition(data.state[valid], data.action[valid], data.next_state[valid], data.dt,
                      valid[valid])  # fmt: skip
    found = fit_paths(built, replace(data, next_state=broken, valid=valid))
    assert torch.equal(found.weight, fit_paths(built, kept).weight)
    with pytest.raises(NonFiniteError, match=r"transitions: row 5, column 5 of .* is nan") as error:
        fit_paths(built, replace(data, next_state=broken))
    assert "\n" not in str(error.value)


def test_refuses_too_few() -> None:
    built, data = structure(TOLD), trial(TOLD, 3, ticks=2)
    with pytest.raises(ValueError, match=r"transitions: got 2, expected at least 3 to fit"):
        fit_paths(built, data)
    with pytest.raises(ValueError, match=r"passes=0: expected at least 1"):
        fit_paths(built, trial(TOLD, 3), passes=0)


def test_rows_whose_own_path_runs_away_keep_that_of_the_first_pass() -> None:
    built, data = structure(TOLD, "products"), trial(TOLD, 4)
    fast = data.state.clone()
    fast[7, 3] = 900.0  # its square drives the model's own path out of bounds
    found = fit_paths(built, replace(data, state=fast))
    assert found.fallbacks == 1 and bool(found.weight.isfinite().all())
