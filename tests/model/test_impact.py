"""The learned strike map against the impact of a walker of five links."""

from __future__ import annotations

import pytest
import torch

from edtorch.errors import FitError
from edtorch.model.chain import impact_terms
from edtorch.model.impact import Impact, Kinks, fit_impact, no_jump
from edtorch.model.mechanism import coupled
from sims.rows import TORCH
from sims.tasks.five_links import foot_over, impact_over
from tests.walkers import TOLD, D, strike, structure, true_weight

pytestmark = pytest.mark.oracle

COLUMNS = torch.tensor([0, 3])


def strikes(count: int, seed: int, held: bool = False) -> Kinks:
    """Of the true impact, rates scaled; held: the knee of the stance leg at its stop."""
    generator = torch.Generator().manual_seed(seed)
    q = 0.4 * torch.randn(count, 5, generator=generator, dtype=torch.float64)
    if held:
        q[:, 4] = q[:, 3]
    v = 2 * torch.randn(count, 5, generator=generator, dtype=torch.float64)
    _, _, east, up = foot_over(TORCH)(q.unbind(-1), v.unbind(-1))
    before = torch.zeros(count, 13).double()
    before[:, 0:10:2], before[:, 1:10:2] = q, v / 6.0
    before = strike().relabelled(before)
    stops = ((1.0 if held else 0.0) * torch.ones(count).double(), torch.zeros(count).double())
    p, w = before[:, 0:10:2], before[:, 1:10:2] * 6.0
    found = torch.stack(impact_over(TORCH)(p.unbind(-1), w.unbind(-1), east, up, stops), -1)
    after = before.clone()
    after[:, 1:10:2] = found / 6.0
    shut = torch.zeros(count, 2, dtype=torch.bool)
    shut[:, 0] = held & ((found[:, 0] - found[:, 1]).abs() < 1e-9)
    return Kinks(before, after, shut)


def joined(first: Kinks, second: Kinks) -> Kinks:
    """The strikes of both."""
    return Kinks(
        torch.cat([first.before, second.before]),
        torch.cat([first.after, second.after]),
        torch.cat([first.held, second.held]),
    )


def fitted(kinks: Kinks) -> Impact:
    """With the true free model."""
    built = structure()
    features = impact_terms(TOLD, built.lift)
    return fit_impact(built, true_weight(built), kinks, COLUMNS, *features)


def wrong(found: Impact, kinks: Kinks) -> float:
    """Greatest error of a rate, rad/s, where no stop pressed."""
    built = structure()
    free = ~kinks.held.any(-1)
    rates = found(built, true_weight(built), kinks.before[free])
    return float((rates - kinks.after[free, 1:10:2]).abs().max()) * 6


def test_without_a_jump_rates_are_the_same() -> None:
    built, before = structure(), strikes(5, 7).before
    found = no_jump(built, true_weight(built))(built, true_weight(built), before)
    torch.testing.assert_close(found, before[:, 1:10:2], rtol=1e-12, atol=1e-12)


def test_the_matrix_is_the_inertia_by_rows() -> None:
    built, state = structure(), strikes(5, 0).before
    q = state[:, 0:10:2]
    expected = torch.from_numpy(D / D.diagonal()[:, None]) * (q[:, :, None] - q[:, None, :]).cos()
    found = coupled(built, true_weight(built), state)
    torch.testing.assert_close(found, expected, rtol=0, atol=1e-12)


def test_the_true_impact_is_in_the_span() -> None:
    assert wrong(fitted(strikes(60, 1)), strikes(40, 2)) < 1e-2


def test_impulses_of_stops_do_not_matter() -> None:
    """A map from strikes of which most press a knee onto its stop is that of the others."""
    pressed = strikes(80, 3, held=True)
    assert 20 < int(pressed.held.sum()) < 70
    only = Kinks(
        *(part[pressed.held[:, 0]] for part in (pressed.before, pressed.after, pressed.held))
    )
    found = fitted(joined(only, strikes(10, 4)))
    assert wrong(found, strikes(40, 2)) < 2e-2
    ignored = Kinks(only.before, only.after, torch.zeros_like(only.held))
    assert wrong(fitted(joined(ignored, strikes(10, 4))), strikes(40, 2)) > 0.2


def test_noise_averages_out() -> None:
    generator = torch.Generator().manual_seed(5)

    def noisy(kinks: Kinks) -> Kinks:
        noise = 0.005 / 6 * torch.randn(kinks.after.shape, generator=generator).double()
        return Kinks(kinks.before, kinks.after + noise, kinks.held)

    errors = [wrong(fitted(noisy(strikes(count, 6))), strikes(40, 2)) for count in (20, 400)]
    assert errors[1] < 0.02 and errors[1] < errors[0]


def test_a_strike_that_is_no_strike_weighs_little() -> None:
    kinks = strikes(60, 7)
    kinks.after[:2, 1] += 3.0
    assert wrong(fitted(kinks), strikes(40, 2)) < 5e-2


def test_too_few_strikes() -> None:
    with pytest.raises(FitError, match="strikes: got 5, expected at least 9 to learn what they do"):
        fitted(strikes(5, 0))


def test_the_height_is_learned_from_strikes() -> None:
    """States whose feet touch the ground, to 1 mm."""
    built, told = structure(), strike()
    lift, generator = built.lift, torch.Generator().manual_seed(8)
    state = torch.zeros(400, 13).double()
    q = 0.3 * torch.randn(400, 5, generator=generator, dtype=torch.float64)
    cosine = q[:, 0].cos() + q[:, 1].cos() - q[:, 3].cos()
    q[:, 4] = cosine.clamp(-1, 1).acos()
    state[:, 0:10:2] = q
    # Both feet on the ground, the swing foot on its way down.
    state[:, 1], state[:, 9] = 0.1 * q[:, 0].sign(), -0.2
    kept = state[(told.of_state(lift, state).abs() < 1e-9)][:60]
    kept = kept + 1e-3 * torch.randn(kept.shape, generator=generator, dtype=torch.float64)
    found = strike(height=None).with_height(built, kept)
    length = torch.from_numpy(found.height[lift.at[[0, 2, 6, 8]] + 1])
    assert length.sign().tolist() == [1, 1, -1, -1] and float(length.sum()) == 0.0
    torch.testing.assert_close(length.abs(), torch.ones(4).double(), rtol=0, atol=0.05)
    with pytest.raises(FitError, match=r"told.strike.height: 1 strikes, expected 2 or more"):
        told.with_height(built, kept[:1])
