"""Regulators on the model of the trials so far."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch
from torch import Tensor
from torch.testing import assert_close

from edtorch.model.batch_fit import LearnedModel
from edtorch.model.evidence import Posterior
from edtorch.search.knowledge import Knowledge
from edtorch.search.problem import Improvement
from edtorch.search.regulated import RegulatedSearch
from edtorch.search.tick_model import TickModel
from edtorch.value.linear.stationary import regulator_at
from tests.planning import oscillator, oscillator_cost, search_problem

ZERO = torch.zeros(2, dtype=torch.float64)


def _improved(model: TickModel, wanted: Tensor = ZERO, held: dict[str, float] | None = None):
    """What is found after one trial, where the fit finds this model; the reward wants ``wanted``
    of x and v."""
    cost = oscillator_cost(model)
    rows = cost.rows.copy()
    rows[..., 0] = -(rows[..., 1:3] * wanted.numpy()).sum(-1)
    weight = torch.from_numpy(model.weight)
    posterior = Posterior(weight, weight.new_zeros(1, 3, 3), torch.ones(1).double())
    learned = LearnedModel("only", posterior, ZERO, 0.0, 2)
    problem = replace(
        search_problem(model, replace(cost, rows=rows)),
        learn=lambda transitions, trial: learned,
        goal=wanted.expand(len(rows), 2),
        names=["x", "v"],
    )
    actions = torch.zeros(2, 1, dtype=torch.float64)
    knowledge = Knowledge().with_trial(torch.zeros(3, 2).double(), actions, torch.ones(2).bool())
    found = RegulatedSearch(held=held or {}).improve(problem, knowledge, 0, 1)
    return problem, found


def _regulator(model: TickModel, state: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    cost = oscillator_cost(model)
    found = regulator_at(
        model.structure, torch.from_numpy(model.weight), state, torch.tensor([True, False]),
        torch.zeros(1).double(), torch.from_numpy(model.half), model.dt,
        torch.from_numpy(cost.rows[-1].copy()), torch.from_numpy(cost.action),
    )  # fmt: skip
    return found.state, found.action, found.gain


def _taken(found: Improvement) -> tuple[Tensor, Tensor]:
    return found.parameters["state"][0], found.parameters["gain"][0]


@pytest.mark.parametrize("held", [{}, {"x": 0.4}])
def test_holds_what_is_named_or_else_what_the_reward_wants(held: dict[str, float]) -> None:
    model = oscillator()
    _, found = _improved(model, torch.tensor([0.4, 0.0]).double(), held)
    state, _, _ = _regulator(model, torch.tensor([0.4, 0.0]).double())
    assert_close(_taken(found)[0], state, rtol=0, atol=1e-6)
    assert found.notes == ()


def test_a_speed_that_follows_from_a_place_is_not_held_itself() -> None:
    """x = 1 and v = 0.3 cannot both last; x is wanted, and v is what lets it stay."""
    _, found = _improved(oscillator(), torch.tensor([1.0, 0.3]).double())
    assert_close(_taken(found)[0], torch.tensor([1.0, 0.0]).double(), rtol=0, atol=1e-3)


def test_without_an_equilibrium_the_targets_themselves_are_regulated() -> None:
    """x = 1 needs u = -2, out of range: deviations from x = 1 are what the gain counts."""
    model = replace(oscillator(), half=torch.ones(1).double().numpy())
    wanted = torch.tensor([1.0, 0.0]).double()
    _, found = _improved(model, wanted)
    state, gain = _taken(found)
    assert_close(state, wanted, rtol=0, atol=0)
    # The model is linear, and so its regulator is the same everywhere.
    assert_close(gain, _regulator(model, ZERO)[2], rtol=1e-9, atol=1e-12)
    (note,) = found.notes
    assert "moves by" in note
    assert note.endswith("regulated about the targets themselves")


def test_a_reference_is_for_planners() -> None:
    problem, _ = _improved(oscillator())
    rows = problem.rows.copy()
    rows[3] *= 2
    with pytest.raises(ValueError, match=r"regulated: expected a reward without a reference"):
        RegulatedSearch().actor(replace(problem, rows=rows))
