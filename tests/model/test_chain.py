"""The planar chain against the equations of a walker of five links."""

from __future__ import annotations

import pytest
import torch

from edtorch.model.evidence import ard
from edtorch.model.families import ChainModel
from edtorch.model.mechanism import accelerations, runge_kutta
from edtorch.model.path_fit import fit_paths
from edtorch.model.ties import tied
from edtorch.model.told import Told
from edtorch.types import Transition
from sims.rows import TORCH
from sims.tasks.five_links import accelerations_over
from tests.walkers import ACTION_UNIT, UNIT, WALKER, drawn, structure, true_weight

pytestmark = pytest.mark.oracle


def true_accelerations(state: torch.Tensor, action: torch.Tensor) -> torch.Tensor:
    """Scaled."""
    physical = (state * torch.from_numpy(UNIT)).unbind(-1)
    torques = (action * torch.from_numpy(ACTION_UNIT)).unbind(-1)
    free = (torch.zeros(len(state)).double(),) * 2
    given = (physical[0:10:2], physical[1:10:2], torques, free)
    return torch.stack(accelerations_over(TORCH)(*given), -1) / 6.0


def test_five_links_are_in_the_span() -> None:
    built, (state, action) = structure(), drawn(50)
    found = accelerations(built, true_weight(built), state, action)
    expected = true_accelerations(state, action)
    torch.testing.assert_close(found, expected, rtol=1e-11, atol=1e-11)


def test_features_of_a_row_are_few_and_its_own() -> None:
    """Of n links: 2 (n - 1) pairs, sine, cosine, 1, n rates and the actions."""
    built = structure()
    assert built.ties is not None
    assert built.ties.allowed.sum(1).tolist() == [8 + 3 + 5 + 4] * 5
    # Rows share rates, actions, the constant.
    assert built.ties.allowed.shape == (5, 5 * (8 + 2) + 10)
    assert bool((true_weight(built)[~built.allowed] == 0).all())


def test_a_fit_recovers_the_accelerations() -> None:
    """Ticks of the true equations with noise-free readings."""
    built, (state, action) = structure(), drawn(400, seed=1)
    truth = true_weight(built)
    after = runge_kutta(built, truth, state, action, 0.01, steps=4)
    valid = torch.ones(400, dtype=torch.bool)
    data = Transition(state, action, after, torch.tensor(0.01).double(), valid)
    found = fit_paths(built, data, passes=2)
    state, action = drawn(100, seed=2)
    expected = true_accelerations(state, action)
    wrong = accelerations(built, found.weight, state, action) - expected
    assert float(wrong.square().mean().sqrt()) < 1e-3 * float(expected.square().mean().sqrt())
    # The weights of tied terms are equal or opposite, in any draw.
    generator = torch.Generator().manual_seed(0)
    draw = found.drawn(torch.randn(found.weight.shape, generator=generator, dtype=torch.float64))
    assert built.ties is not None
    share = torch.from_numpy(built.ties.share)
    tie = draw @ torch.linalg.pinv(share) @ share
    torch.testing.assert_close(tie, draw, rtol=0, atol=2e-3)


def test_tied_regression_is_that_on_the_sums() -> None:
    built = structure()
    assert built.ties is not None
    generator = torch.Generator().manual_seed(0)
    X = torch.randn(80, built.terms.count, generator=generator, dtype=torch.float64)
    y = torch.randn(5, 80, generator=generator, dtype=torch.float64)
    share, allowed = map(torch.from_numpy, (built.ties.share, built.ties.allowed))
    ones = torch.ones_like(y)
    found = tied(ard, built.ties)(X, y, ones, built.allowed)
    plain = ard(X @ share.mT, y, ones, allowed)
    torch.testing.assert_close(found.weight @ X.mT, plain.weight @ (X @ share.mT).mT)
    variance = torch.einsum("nk,lkj,nj->ln", X, found.cov, X)
    features = X @ share.mT
    torch.testing.assert_close(
        variance, torch.einsum("nk,lkj,nj->ln", features, plain.cov, features)
    )


def test_what_is_no_chain_is_refused() -> None:
    whole = Told.of(WALKER.spec)
    with pytest.raises(ValueError, match="model=chain: 'steps' is learned and is no rate of an"):
        ChainModel().structures(whole)
