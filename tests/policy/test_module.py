"""Any module as a policy: its gradient, its first parameters, and that it learns."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor, nn

from edtorch.model.features import Identity
from edtorch.model.models import DerivativeModel
from edtorch.policy.module import ModulePolicy, as_policy
from edtorch.rewards import QuadraticReward
from edtorch.transform import FirstOrder, MeanOnly
from edtorch.value.unroll import Generic, Horizon
from tests.systems import normal


class Radial(nn.Module):
    """Radial basis functions whose centres move."""

    def __init__(self) -> None:
        super().__init__()
        self.centres = nn.Parameter(torch.empty(5, 2))
        self.out = nn.Linear(5, 1, bias=False)

    def reset_parameters(self) -> None:
        nn.init.normal_(self.centres)

    def forward(self, state: Tensor) -> Tensor:
        away = state.unsqueeze(-2) - self.centres
        return self.out(torch.exp(-away.square().sum(-1)))


MODULES = {
    "sequential": lambda: nn.Sequential(nn.Linear(2, 4), nn.Tanh(), nn.Linear(4, 1)),
    "radial": Radial,
}
MODEL = DerivativeModel(2, 1, Identity(3), torch.zeros(2).double())


def generic(policy: Any, transform: Any) -> Generic:
    reward = QuadraticReward(torch.eye(2).double(), 0.1 * torch.eye(1).double())
    return Generic(MODEL, policy, reward, transform, Horizon(3, 0.2, 0.95, 0.2), None, None)


@pytest.mark.parametrize("name", MODULES)
@pytest.mark.parametrize("transform", [MeanOnly(), FirstOrder()])
def test_gradient_against_finite_differences(name: str, transform: Any) -> None:
    g = torch.Generator().manual_seed(0)
    policy = ModulePolicy(MODULES[name](), 2, 1)
    path, parameters = generic(policy, transform), policy.initial([3, 4])
    model, state = {"weight": normal(g, 2, 2, 3)}, normal(g, 2, 2)
    found = path(model, parameters, {}, state)
    h = 1e-6
    for key, p in parameters.items():
        way = normal(g, *p.shape)
        up, down = (path(model, parameters | {key: p + x * way}, {}, state) for x in (h, -h))
        slope = (up.value - down.value) / (2 * h)
        wanted = (found.gradient[key] * way).flatten(1).sum(-1)
        assert torch.allclose(slope, wanted, rtol=1e-6, atol=1e-9)


@pytest.mark.parametrize("name", MODULES)
def test_first_parameters_depend_on_the_seed_alone(name: str) -> None:
    policy = ModulePolicy(MODULES[name](), 2, 1)
    before = torch.random.get_rng_state()
    alone, among = policy.initial([7]), policy.initial([5, 6, 7])
    assert torch.equal(torch.random.get_rng_state(), before)
    again = ModulePolicy(MODULES[name](), 2, 1).initial([7])
    for key in alone:
        assert torch.equal(alone[key][0], among[key][2])
        assert torch.equal(alone[key], again[key])
        assert not torch.equal(among[key][0], among[key][1])


def test_a_population_acts_as_each_of_its_members() -> None:
    g = torch.Generator().manual_seed(1)
    policy = ModulePolicy(MODULES["sequential"](), 2, 1)
    many, state = policy.initial([1, 2, 3]), normal(g, 4, 3, 2)
    together = policy.action(many, state)
    for row, seed in enumerate([1, 2, 3]):
        one = policy.action(policy.initial([seed]), state[:, row : row + 1])
        assert torch.allclose(together[:, row : row + 1], one, rtol=1e-14)
    limited = policy.action(many | {"limit": torch.full((3, 2), 0.1).double()}, state)
    assert torch.allclose(limited, policy.action(many, state.clamp(-0.1, 0.1)))


def test_constants_are_not_learned() -> None:
    module = Radial()
    module.centres.requires_grad_(False)
    policy = ModulePolicy(module, 2, 1)
    assert list(policy.initial([0])) == ["out.weight"]


@pytest.mark.parametrize(
    ("part", "message"),
    [
        (3, r"int has no action\(parameters, state\), and is not a torch.nn.Module"),
        (nn.Linear(2, 3), r"takes states of shape \(2,\) to \(3,\), expected .* \(1,\)"),
        (nn.Linear(3, 1), r"Linear fails for states of shape \(2,\): RuntimeError: mat1 and mat2"),
        (nn.Sequential(nn.Linear(2, 1), nn.Threshold(9, float("nan"))), "that are not finite"),
        (nn.Module, "Module is a class, expected an object of it"),
        (nn.Tanh(), "Tanh has no parameter that requires a gradient"),
    ],
)
def test_refusals(part: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        as_policy(part, 2, 1)
