"""Ridge least squares against the textbook."""

from __future__ import annotations

import pytest
import torch

from edtorch.model.fit_ridge import Ridge


def _samples(count: int, batch: int = 3) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(1)
    phi = torch.randn(count, batch, 6, generator=generator, dtype=torch.float64)
    y = torch.randn(count, batch, 2, generator=generator, dtype=torch.float64)
    return phi, y


def _fit(rule: Ridge, phi: torch.Tensor, y: torch.Tensor) -> torch.Tensor:
    weight = phi.new_zeros(phi.shape[1], y.shape[-1], phi.shape[-1])
    memory, unit = rule.initial(weight), torch.tensor(0.02)
    for sample, target in zip(phi, y, strict=True):
        fitted = rule.update(weight, memory, sample, target, unit)
        assert torch.equal(fitted.residual, target - (weight @ sample[..., None])[..., 0])
        weight, memory = fitted.weight, fitted.memory
    return weight


def test_equals_least_squares_with_the_penalty_as_samples() -> None:
    phi, y = _samples(40)
    weight = _fit(Ridge(penalty=0.3, every=8, later=8), phi, y)
    root = 0.3**0.5 * torch.eye(6, dtype=torch.float64)
    for k in range(3):
        rows = torch.cat((phi[:, k], root))
        targets = torch.cat((y[:, k], torch.zeros(6, 2, dtype=torch.float64)))
        expected = torch.linalg.lstsq(rows, targets).solution.mT
        torch.testing.assert_close(weight[k], expected, rtol=1e-12, atol=1e-12)


def test_solves_after_each_block_and_less_often_later() -> None:
    phi, y = _samples(40)
    rule = Ridge(every=4, later=12, settled=16)
    solved = [bool(_fit(rule, phi[:n], y[:n]).ne(_fit(rule, phi[: n - 1], y[: n - 1])).any())
              for n in range(2, 37)]  # fmt: skip
    assert [n for n, changed in zip(range(2, 37), solved, strict=True) if changed] == [
        4, 8, 12, 16, 24, 36,
    ]  # fmt: skip


def test_a_row_of_zeros_tells_nothing() -> None:
    phi, y = _samples(16)
    rule = Ridge(every=4, later=4)
    spread = torch.zeros(32, 3, 6, dtype=torch.float64), torch.zeros(32, 3, 2, dtype=torch.float64)
    spread[0][::2], spread[1][::2] = phi, y
    torch.testing.assert_close(_fit(rule, *spread), _fit(rule, phi, y), rtol=1e-13, atol=1e-13)


@pytest.mark.parametrize(
    "given", [{"penalty": 0}, {"every": 0}, {"every": 4, "later": 6}, {"settled": -1}]
)
def test_refuses(given: dict[str, float]) -> None:
    name = "later" if len(given) == 2 else next(iter(given))
    with pytest.raises(ValueError, match=f"^{name}="):
        Ridge(**given)  # pyright: ignore[reportArgumentType]
