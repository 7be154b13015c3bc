"""Choice among models by what they predict of rows held out."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from torch import Tensor

from edtorch.errors import FitError, NonFiniteError
from edtorch.model.evidence import Posterior
from edtorch.model.held_out import CONSTANT, CONSTANT_RATES, choose_model
from edtorch.model.lift import Lift
from edtorch.model.mechanism import Structure
from edtorch.model.path_fit import fit_paths
from edtorch.model.terms import Terms
from edtorch.model.told import Told
from edtorch.types import Transition
from tests.cart_poles import structure, told, trial

MASS = Told(("x", "v"), (1.0, 1.0), (False, False), (-1, 0), ("u",), invariant=frozenset("x"))
ROWS = 40
ONE = torch.zeros(ROWS, dtype=torch.int64)


def _mass(degree: int) -> Structure:
    lift = Lift.of(MASS)
    return Structure.of(MASS, lift, Terms.monomials(MASS, lift, degree))


def _walk(push: float, noise: float) -> Transition:
    """v' = v + .1 push u + noise, x' = x + .1 (v + v') / 2."""
    generator = torch.Generator().manual_seed(3)
    u = torch.randn(ROWS, 1, generator=generator, dtype=torch.float64)
    kick = 0.1 * push * u[:, 0]
    kick = kick + noise * torch.randn(ROWS, generator=generator, dtype=torch.float64)
    v = torch.cat([torch.zeros(1, dtype=torch.float64), kick.cumsum(0)])
    x = torch.cat([torch.zeros(1, dtype=torch.float64), (0.05 * (v[1:] + v[:-1])).cumsum(0)])
    state = torch.stack([x, v], dim=-1)
    valid = torch.ones(ROWS, dtype=torch.bool)
    return Transition(state[:-1], u, state[1:], torch.tensor(0.1, dtype=torch.float64), valid)


def test_a_mechanism_is_best_described_by_its_equations() -> None:
    """Cart-pole after one trial of 4 s."""
    candidates = {kind: structure(told(), kind) for kind in ("products", "implicit")}
    chosen = choose_model(candidates, trial(told(), 0), ONE)
    assert chosen.name == chosen.best == "implicit" and chosen.better_than_constant
    assert chosen.scores["implicit"].error < 0.5 * chosen.scores["products"].error
    refit = fit_paths(candidates["implicit"], trial(told(), 0))
    assert torch.equal(chosen.posterior.weight, refit.weight)
    assert chosen.words.startswith("model=implicit: error 0.0") and "\n" not in chosen.words


def test_the_simpler_wins_a_tie() -> None:
    candidates = {"rich": _mass(4), "poor": _mass(1), "none": _mass(0)}
    chosen = choose_model(candidates, _walk(push=2.0, noise=0.05), ONE)
    assert chosen.name == "poor" and [chosen.scores[n].terms for n in candidates] == [15, 3, 1]
    assert chosen.scores["poor"].behind <= chosen.scores["poor"].standard_error
    assert chosen.scores["none"].behind > chosen.scores["none"].standard_error
    tie = "within one standard error of rich, and simpler"
    assert (tie in chosen.words) == (chosen.best == "rich")


def test_a_model_of_noise_is_no_better_than_a_constant() -> None:
    chosen = choose_model({"poor": _mass(1)}, _walk(push=0.0, noise=0.05), ONE)
    assert not chosen.better_than_constant
    assert choose_model({"poor": _mass(1)}, _walk(2.0, 0.05), ONE).better_than_constant


def _geometric(data: Transition, starts: list[int], ticks: int, rates: bool) -> float:
    logs = []
    for i in starts:
        x, v = data.state[i].tolist()
        squares = [
            ((x + 0.1 * (k + 1) * v * rates - float(data.next_state[i + k, 0])) ** 2
             + (v - float(data.next_state[i + k, 1])) ** 2) / 2
            for k in range(ticks)
        ]  # fmt: skip
        logs.append(math.log(sum(squares) / ticks))
    return math.exp(sum(logs) / len(logs) / 2)


@pytest.mark.parametrize("invalid", [None, 33])
def test_windows_keep_to_one_episode_and_one_block(invalid: int | None) -> None:
    """Errors of the constants, added up window by window: blocks of 10, episodes of 14 and 26."""
    data, episode = _walk(2.0, 0.05), (torch.arange(ROWS) >= 14).long()
    rows = [k for k in range(ROWS) if k != invalid]
    valid = torch.tensor([k in rows for k in range(ROWS)])
    chosen = choose_model({"poor": _mass(1)}, replace(data, valid=valid), episode)
    block = {row: place * 4 // len(rows) for place, row in enumerate(rows)}
    starts = [
        i for i in rows if set(range(i, i + 5)) <= block.keys()
        and block[i] == block[i + 4] and not i < 14 <= i + 4
    ]  # fmt: skip
    for name in (CONSTANT, CONSTANT_RATES):
        expected = _geometric(data, starts, 5, name == CONSTANT_RATES)
        assert chosen.scores[name].error == pytest.approx(expected, rel=1e-9)


def _first(rows: int) -> tuple[Transition, Tensor]:
    data = _walk(2.0, 0.05)
    parts = (data.state[:rows], data.action[:rows], data.next_state[:rows])
    return Transition(*parts, data.dt, data.valid[:rows]), ONE[:rows]


@pytest.mark.parametrize(("rows", "seconds"), [(39, 0.5), (12, 0.3), (8, 0.4), (6, 0.3)])
def test_few_rows_make_short_windows_and_few_blocks(rows: int, seconds: float) -> None:
    chosen = choose_model({"poor": _mass(1)}, *_first(rows))
    assert chosen.seconds == pytest.approx(seconds)


def test_short_episodes_make_short_windows() -> None:
    """Twenty episodes of two ticks."""
    chosen = choose_model({"poor": _mass(1)}, _walk(2.0, 0.05), torch.arange(ROWS) // 2)
    assert chosen.seconds == pytest.approx(0.2)


def test_refuses_too_few_rows() -> None:
    with pytest.raises(ValueError, match=r"got 5, expected at least 6 to hold some of them out"):
        choose_model({"poor": _mass(1)}, *_first(5))


def test_a_candidate_that_cannot_be_fitted_is_not_chosen() -> None:
    broken = _mass(0)

    def fit(built: Structure, transition: Transition) -> Posterior:
        if built is broken:
            raise FitError("the fit broke")
        return fit_paths(built, transition)

    data = _walk(2.0, 0.05)
    chosen = choose_model({"broken": broken, "poor": _mass(1)}, data, ONE, fit=fit)
    assert chosen.name == "poor" and chosen.scores["broken"].error > 1e10
    with pytest.raises(FitError):
        choose_model({"broken": broken}, data, ONE, fit=fit)


def test_refuses_numbers_that_are_not_finite() -> None:
    data = _walk(2.0, 0.05)
    wrong: Tensor = data.next_state.clone()
    wrong[3, 1] = torch.inf
    with pytest.raises(NonFiniteError, match=r"row 3, column 4 .* is inf"):
        choose_model({"poor": _mass(1)}, replace(data, next_state=wrong), ONE)
