"""Stacked networks: each acts as its own would alone, in any company."""

from __future__ import annotations

import torch
from torch import nn

from edtorch.rivals.networks import Networks, stacked


def _networks(count: int) -> list[nn.Sequential]:
    torch.manual_seed(0)
    return [
        nn.Sequential(nn.Linear(3, 8), nn.Tanh(), nn.Linear(8, 8), nn.Tanh(), nn.Linear(8, 2))
        for _ in range(count)
    ]


def _linear(network: nn.Sequential) -> list[nn.Linear]:
    return [layer for layer in network if isinstance(layer, nn.Linear)]


CENTRE, RADIUS = torch.tensor([0.5, 0.0]).double(), torch.tensor([1.5, 2.0]).double()
ACTOR = Networks(3, torch.tanh, torch.tanh, CENTRE, RADIUS)


def test_each_policy_acts_as_its_own_network() -> None:
    networks = _networks(3)
    parameters = stacked([_linear(network) for network in networks])
    observation = torch.randn(12, 3, dtype=torch.float64)
    repeated = {name: p.repeat_interleave(4, dim=0) for name, p in parameters.items()}
    found = ACTOR.action(repeated, observation)
    wanted = [
        CENTRE + RADIUS * torch.tanh(network(rows.float())).double()
        for network, rows in zip(networks, observation.split(4), strict=True)
    ]
    assert found.dtype is torch.float64
    torch.testing.assert_close(found, torch.cat(wanted), rtol=1e-6, atol=1e-6)


def test_company_changes_no_digit() -> None:
    parameters = stacked([_linear(network) for network in _networks(3)])
    observation = torch.randn(15, 3, dtype=torch.float64)
    repeated = {name: p.repeat_interleave(5, dim=0) for name, p in parameters.items()}
    together = ACTOR.action(repeated, observation)
    for row in range(3):
        own = slice(5 * row, 5 * row + 5)
        alone = ACTOR.action({k: p[own] for k, p in repeated.items()}, observation[own])
        assert alone.equal(together[own])


def test_the_parameters_are_copies() -> None:
    networks = _networks(1)
    parameters = stacked([_linear(network) for network in networks])
    before = parameters["weight_1"].clone()
    with torch.no_grad():
        _linear(networks[0])[0].weight.zero_()
    assert parameters["weight_1"].equal(before)
