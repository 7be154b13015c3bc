"""Local least squares: weighted ridge regression in closed form, and the choice of a bandwidth."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from torch import Tensor

from edtorch.model.fit_local import LocalLeastSquares
from edtorch.types import Parameters

ONE = torch.ones(())


def _fitted(fit: LocalLeastSquares, phi: Tensor, y: Tensor) -> tuple[Tensor, Parameters]:
    """W and the memory after the samples phi ``[T, B, k]``, y ``[T, B, n]``."""
    weight = phi.new_zeros(phi.shape[1], y.shape[-1], phi.shape[-1])
    memory = fit.initial(weight)
    for k in range(len(phi)):
        found = fit.update(weight, memory, phi[k], y[k], ONE)
        weight, memory = found.weight, found.memory
    return weight, memory


def _samples(seed: int, count: int = 80, spread: float = 1.0) -> tuple[Tensor, Tensor]:
    """States ``[T, 1, 2]`` and actions ``[T, 1, 1]``."""
    g = torch.Generator().manual_seed(seed)
    both = torch.randn(count, 1, 3, generator=g, dtype=torch.float64)
    return spread * both[..., :2], both[..., 2:]


def _phi(state: Tensor, action: Tensor) -> Tensor:
    return torch.cat([torch.ones_like(action), state, action], dim=-1)


def _ridge(phi: Tensor, y: Tensor, w: Tensor, ridge: float) -> Tensor:
    """The minimum of sum w |y - W phi|^2 + ridge sum_j A_jj W_j^2, as a stacked least squares."""
    root = w.sqrt().unsqueeze(-1)
    size = (root * phi).square().sum(0).sqrt()
    rows = torch.cat([root * phi, ridge**0.5 * torch.diag(size)])
    right = torch.cat([root * y, y.new_zeros(phi.shape[-1], y.shape[-1])])
    return torch.linalg.lstsq(rows, right, driver="gelsd").solution.mT


def test_power_zero_is_ridge_regression() -> None:
    state, action = _samples(0)
    phi = _phi(state, action)
    y = torch.randn(80, 1, 2, generator=torch.Generator().manual_seed(1), dtype=torch.float64)
    weight, _ = _fitted(LocalLeastSquares(2, {}, (1.0,), 0.0, 0.01), phi, y)
    expected = _ridge(phi[:, 0], y[:, 0], torch.ones(80).double(), 0.01)
    torch.testing.assert_close(weight[0], expected, rtol=1e-9, atol=1e-9)


def test_samples_are_weighted_by_their_distance_from_the_target() -> None:
    state, action = _samples(2)
    phi, target, h = _phi(state, action), {0: 0.5, 1: -0.2}, 0.3
    y = torch.sin(state)
    weight, memory = _fitted(LocalLeastSquares(2, target, (h,), 2.0, 1e-6), phi, y)
    e = (state[:, 0] - torch.tensor([0.5, -0.2])).square()
    count = torch.arange(1, 81, dtype=torch.float64).unsqueeze(-1)
    distance = (e / (e.cumsum(0) / count)).mean(-1)
    w = ((h**2 + distance) / (h**2 + 1)) ** -2.0
    torch.testing.assert_close(weight[0], _ridge(phi[:, 0], y[:, 0], w, 1e-6), rtol=1e-7, atol=1e-7)
    known = LocalLeastSquares(2, target, (h,)).describe(memory)
    assert known["centre"][0].tolist() == [0.5, -0.2]
    torch.testing.assert_close(known["excursion"][0], e.amax(0).sqrt())
    torch.testing.assert_close(known["spread"][0], e.mean(0).sqrt())
    assert known["count"].item() == 80


@pytest.mark.parametrize("seed", range(4))
def test_a_curved_system_wants_a_narrow_bandwidth(seed: int) -> None:
    """sin and x |x| have the slopes 1 and 0 at the target, and others far from it."""
    state, action = _samples(seed, 150)
    y = torch.stack([state[..., 0].sin() + action[..., 0], state[..., 1] * state[..., 1].abs()], -1)
    phi = _phi(state, action)
    weight, memory = _fitted(LocalLeastSquares(2, {0: 0.0, 1: 0.0}), phi, y)
    assert int(memory["score"].argmin()) <= 1
    plain, _ = _fitted(LocalLeastSquares(2, {0: 0.0, 1: 0.0}, (1000.0,)), phi, y)
    truth = torch.tensor([[0.0, 1.0, 0.0, 1.0], [0.0, 0.0, 0.0, 0.0]]).double()
    assert (weight[0] - truth).norm() < 0.6 * (plain[0] - truth).norm()


def test_noise_wants_a_wide_bandwidth() -> None:
    g = torch.Generator().manual_seed(3)
    state = torch.randn(200, 16, 2, generator=g, dtype=torch.float64)
    action = torch.randn(200, 16, 1, generator=g, dtype=torch.float64)
    truth = torch.tensor([[0.1, 1.0, 0.2, 0.0], [0.0, 0.0, 1.0, 0.5]]).double()
    phi = _phi(state, action)
    y = phi @ truth.mT + torch.randn(200, 16, 2, generator=g, dtype=torch.float64)
    target = {0: 0.0, 1: 0.0}
    chosen, _ = _fitted(LocalLeastSquares(2, target), phi, y)
    narrow, _ = _fitted(LocalLeastSquares(2, target, (0.1,)), phi, y)
    error, narrow_error = ((w - truth).square().mean().item() for w in (chosen, narrow))
    assert error < 0.3 * narrow_error


def test_scores_within_the_tie_give_the_widest_bandwidth() -> None:
    """Prequential scores of pure noise differ by chance alone."""
    state, action = _samples(7, 100)
    g = torch.Generator().manual_seed(8)
    y = torch.randn(100, 1, 2, generator=g, dtype=torch.float64)
    phi, target = _phi(state, action), {0: 0.0, 1: 0.0}
    wide, _ = _fitted(LocalLeastSquares(2, target, (1000.0,)), phi, y)
    chosen, _ = _fitted(LocalLeastSquares(2, target, tie=1e9), phi, y)
    torch.testing.assert_close(chosen, wide, rtol=1e-12, atol=1e-12)


def test_units_do_not_matter() -> None:
    state, action = _samples(5)
    y = torch.cat([state.sin(), action], dim=-1)[..., :2]
    scale = torch.tensor([100.0, 0.01]).double()
    one, _ = _fitted(LocalLeastSquares(2, {0: 0.3}), _phi(state, action), y)
    other, _ = _fitted(LocalLeastSquares(2, {0: 30.0}), _phi(state * scale, action), y)
    other[..., 1:3] *= scale
    torch.testing.assert_close(one, other, rtol=1e-7, atol=1e-9)


def test_learners_do_not_mix() -> None:
    state, action = _samples(6, 40)
    more = torch.cat([state, 2 * state + 0.1], dim=1)
    both = torch.cat([action, -action], dim=1)
    fit = LocalLeastSquares(2, {0: 0.0})
    together, _ = _fitted(fit, _phi(more, both), more.cos())
    for row in range(2):
        rows = slice(row, row + 1)
        alone, _ = _fitted(fit, _phi(more[:, rows], both[:, rows]), more[:, rows].cos())
        torch.testing.assert_close(together[rows], alone, rtol=1e-10, atol=1e-12)


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"bandwidths": ()}, r"bandwidths=\[\]: expected one or more"),
        ({"bandwidths": (0.0,)}, r"bandwidths=\[0\.0\]: expected one or more numbers > 0"),
        ({"ridge": 0.0}, r"ridge=0\.0: expected a number > 0"),
        ({"power": -1.0}, r"power=-1\.0: expected a number >= 0"),
        ({"target": {2: 0.0}}, r"target\[2\]: expected an index below 2"),
    ],
)
def test_refusals(settings: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        LocalLeastSquares(**({"states": 2, "target": {}} | settings))
