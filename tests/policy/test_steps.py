"""Policy steps."""

from __future__ import annotations

import pytest
import torch

from edtorch.policy.steps import DecayingStep, PlainStep, SaturatedStep, gradient_norm

UNIT = torch.tensor(0.01, dtype=torch.float64)
THETA = {"weight": torch.zeros(2, 1, 2).double(), "bias": torch.zeros(2, 1).double()}
GRADIENT = {
    "weight": torch.tensor([[[3.0, 0.0]], [[300.0, 0.0]]]).double(),
    "bias": torch.tensor([[4.0], [400.0]]).double(),
}


def test_norm_is_over_all_parameters_of_one_learner() -> None:
    assert gradient_norm(GRADIENT).tolist() == [5.0, 500.0]


def test_saturated_step_by_hand() -> None:
    moved, memory = SaturatedStep(alpha=2.0, beta=1.0)(THETA, GRADIENT, {}, UNIT)
    assert memory == {}
    assert moved["weight"][0, 0, 0] == pytest.approx(2 * 0.01 * 3 / 6, rel=1e-14)
    assert moved["bias"][1, 0] == pytest.approx(2 * 0.01 * 400 / 501, rel=1e-14)


def test_saturated_step_is_bounded_and_turns_into_the_plain_one() -> None:
    huge = {name: 1e9 * g for name, g in GRADIENT.items()}
    moved, _ = SaturatedStep(2.0, 1.0)(THETA, huge, {}, UNIT)
    assert gradient_norm(moved).tolist() == pytest.approx([0.02, 0.02], rel=1e-8)
    tiny = {name: 1e-9 * g for name, g in GRADIENT.items()}
    saturated, _ = SaturatedStep(2.0, 4.0)(THETA, tiny, {}, UNIT)
    plain, _ = PlainStep(0.5)(THETA, tiny, {}, UNIT)
    assert torch.allclose(saturated["weight"], plain["weight"], rtol=1e-6)


def test_decaying_step_is_the_saturated_one_at_first_and_half_of_it_later() -> None:
    rule = DecayingStep(2.0, 1.0, decay=0.03)
    saturated, _ = SaturatedStep(2.0, 1.0)(THETA, GRADIENT, {}, UNIT)
    memory, steps = rule.initial(THETA), []
    for _ in range(4):
        moved, memory = rule(THETA, GRADIENT, memory, UNIT)
        steps.append(float(moved["bias"][0, 0] / saturated["bias"][0, 0]))
    assert steps == pytest.approx([1, 3 / 4, 3 / 5, 3 / 6])


def test_plain_step_climbs_a_hill() -> None:
    theta = {"weight": torch.tensor([[5.0]]).double()}
    for _ in range(300):
        theta, _ = PlainStep(0.1)(theta, {"weight": -2 * (theta["weight"] - 1)}, {}, UNIT * 100)
    assert float(theta["weight"]) == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("make", "message"),
    [
        (lambda: SaturatedStep(-1.0, 1.0), "alpha=-1.0"),
        (lambda: SaturatedStep(1.0, 0.0), "beta=0.0"),
        (lambda: DecayingStep(1.0, 1.0, 0.0), "decay=0.0"),
        (lambda: DecayingStep(-1.0, 1.0, 1.0), "alpha=-1.0"),
        (lambda: PlainStep(float("nan")), "alpha=nan"),
    ],
)
def test_refuses_the_impossible(make, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make()
