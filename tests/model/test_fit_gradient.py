"""A model that is not linear in its parameters learns a known map by gradient steps."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor, nn

from edtorch.learner.estimator import estimator_of
from edtorch.model.fit import SquaredError
from edtorch.model.fit_gradient import GradientFit
from edtorch.model.module import NextStateModule, as_model
from edtorch.types import Transition
from tests.systems import normal


class Wave(nn.Module):
    """s' = a sin(b s) + c u, one component."""

    integrates = False

    def __init__(self) -> None:
        super().__init__()
        self.p = nn.Parameter(torch.tensor([0.5, 1.5, 0.0]))

    def reset_parameters(self) -> None:
        nn.init.uniform_(self.p, 0.5, 1.2)

    def forward(self, state: Tensor, action: Tensor) -> Tensor:
        a, b, c = self.p.unbind(-1)
        return a * torch.sin(b * state) + c * action


def test_learns_a_known_map() -> None:
    g = torch.Generator().manual_seed(0)
    model = as_model(Wave(), 1, 1, torch.zeros(1).double())
    fit = GradientFit(rate=0.02, recent=50)
    parameters = model.initial([0, 1])
    memory = fit.initial_memory(model, parameters)
    residual = torch.tensor(torch.inf)
    for _ in range(500):
        s, u = normal(g, 2, 1), normal(g, 2, 1)
        end = 0.8 * torch.sin(1.1 * s) - 0.6 * u
        dt, valid = torch.tensor(0.1).double(), torch.ones(2, dtype=torch.bool)
        found = fit.improve(model, parameters, memory, Transition(s, u, end, dt, valid))
        parameters, memory, residual = found.parameters, found.memory, found.residual
    wanted = torch.tensor([0.8, 1.1, -0.6]).double().expand(2, 3)
    assert torch.allclose(parameters["p"], wanted, atol=1e-2)
    assert residual.abs().max() < 1e-2


def test_learners_do_not_mix() -> None:
    g = torch.Generator().manual_seed(1)
    model = as_model(Wave(), 1, 1, torch.zeros(1).double())
    assert isinstance(model, NextStateModule)
    fit = GradientFit(recent=3, steps=2)
    s, u, end = normal(g, 5, 2, 1), normal(g, 5, 2, 1), normal(g, 5, 2, 1)

    def run(rows: list[int]) -> Tensor:
        parameters = model.initial(rows)
        memory = fit.initial_memory(model, parameters)
        for k in range(5):
            dt, valid = torch.tensor(0.1).double(), torch.ones(len(rows), dtype=torch.bool)
            lived = Transition(s[k, rows], u[k, rows], end[k, rows], dt, valid)
            found = fit.improve(model, parameters, memory, lived)
            parameters, memory = found.parameters, found.memory
        return parameters["p"]

    assert torch.allclose(run([0, 1])[1], run([1])[0], rtol=1e-13)


def test_a_rule_for_weights_is_refused() -> None:
    model = as_model(Wave(), 1, 1, torch.zeros(1).double())
    with pytest.raises(ValueError, match="fit=SquaredError: expected a rule that fits any"):
        estimator_of(SquaredError(1.0), model, None)
    with pytest.raises(ValueError, match="int has no next"):
        as_model(3, 1, 1, torch.zeros(1).double())
