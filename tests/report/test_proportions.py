"""Intervals and tests of shares, against figures known from elsewhere."""

from __future__ import annotations

import pytest

from edtorch.report.proportions import Proportion, holm, same_rate


def test_wilson_of_the_paper_s_figures() -> None:
    """The intervals of footnote 1's four rates, n = 100,000."""
    for count, low, high in ((549, 0.505, 0.597), (890, 0.83, 0.95), (300, 0.268, 0.336)):
        found = Proportion(count, 100_000).wilson()
        assert found == pytest.approx((low / 100, high / 100), abs=6e-5)


def test_wilson_at_the_ends() -> None:
    low, high = Proportion(0, 10).wilson()
    assert (low, high) == pytest.approx((0.0, 0.2775), abs=1e-4)
    assert Proportion(10, 10).wilson() == pytest.approx((1 - 0.2775, 1.0), abs=1e-4)


def test_wilson_covers() -> None:
    """Endpoints solve (p - rate)^2 = z^2 p (1 - p) / n."""
    share = Proportion(7, 50)
    for p in share.wilson():
        assert (p - share.rate) ** 2 == pytest.approx(1.959964**2 * p * (1 - p) / 50, rel=1e-5)


def test_same_rate() -> None:
    assert same_rate(Proportion(5, 100), Proportion(50, 1000)) == pytest.approx(1)
    # z = 0.1 / sqrt(0.35 * 0.65 * 2 / 200) = 2.0966
    assert same_rate(Proportion(60, 200), Proportion(80, 200)) == pytest.approx(0.0360, abs=1e-4)
    assert same_rate(Proportion(0, 5), Proportion(0, 9)) == 1.0


@pytest.mark.parametrize(("count", "total"), [(1, 0), (-1, 5), (6, 5)])
def test_refuses_what_is_no_share(count: int, total: int) -> None:
    with pytest.raises(ValueError, match="expected an integer"):
        Proportion(count, total)


def test_holm() -> None:
    """By hand: 4 * .005, 3 * .01, 2 * .03, and .04 no less than that."""
    assert holm([0.01, 0.04, 0.03, 0.005]) == pytest.approx([0.03, 0.06, 0.06, 0.02])
    assert holm([0.4, 0.9, 0.6]) == [1.0, 1.0, 1.0]
    assert holm([0.2]) == [0.2]
    assert holm([]) == []


def test_holm_between_bonferroni_and_nothing() -> None:
    p = [0.5, 0.002, 0.03, 0.03, 0.2, 0.011]
    for adjusted, own in zip(holm(p), p, strict=True):
        assert own <= adjusted <= min(1.0, len(p) * own)
    # The order of the tests does not matter.
    assert holm(p[::-1]) == holm(p)[::-1]


@pytest.mark.parametrize("p", [-0.1, 1.1, float("nan")])
def test_holm_refuses_what_is_no_probability(p: float) -> None:
    with pytest.raises(ValueError, match="expected a probability"):
        holm([0.5, p])
