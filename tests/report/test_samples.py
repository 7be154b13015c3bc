"""Estimates over seeds against definitions, hand-worked examples and known distributions."""

from __future__ import annotations

import itertools
import math
import statistics

import numpy as np
import pytest

from edtorch.report import samples
from edtorch.report.samples import (
    Interval,
    Sample,
    difference,
    interquartile_mean,
    interval,
    kaplan_meier_median,
    median,
    probability_less,
    survival,
)


@pytest.fixture(autouse=True)
def _no_draws_left() -> None:
    samples._draws.cache_clear()


@pytest.mark.parametrize("n", range(1, 14))
def test_interquartile_mean_drops_a_quarter_at_each_end(n: int) -> None:
    values = [float(k * k) for k in range(n)]
    cut = math.floor(0.25 * n)
    assert interquartile_mean(np.array(values)) == statistics.fmean(values[cut : n - cut])
    assert median(np.array(values)) == statistics.median(values)


class TestBootstrap:
    def test_against_every_resample(self) -> None:
        """Of four values all 256 resamples can be written down."""
        values = [1.0, 2.0, 4.0, 11.0]
        every = sorted(
            statistics.fmean(sorted(chosen)[1:3]) for chosen in itertools.product(values, repeat=4)
        )
        found = interval(Sample.of(values), interquartile_mean)
        assert found.value == 3.0
        # The ends are steps of that distribution: its 2.5 and 97.5 % lie between them.
        below = sum(v < found.low for v in every) / 256, sum(v <= found.low for v in every) / 256
        above = sum(v < found.high for v in every) / 256, sum(v <= found.high for v in every) / 256
        assert below[0] <= 0.03 and below[1] >= 0.02
        assert above[0] <= 0.98 and above[1] >= 0.97

    @pytest.mark.oracle
    def test_covers(self) -> None:
        """Of 400 normal samples of 50, 95 % of the intervals hold the true interquartile mean: 0.

        Four standard errors of a share of 400, and the percentile bootstrap's known lack at this
        size, about a per cent.
        """
        random = np.random.default_rng(1)
        held = 0
        for _ in range(400):
            found = interval(Sample.of(random.normal(size=50).tolist()), interquartile_mean)
            held += found.low <= 0 <= found.high
        assert 0.89 <= held / 400 <= 0.99

    def test_the_width_is_that_of_theory(self) -> None:
        """The mean's interval of n values is about 2 * 1.96 s / sqrt(n) wide."""
        values = np.random.default_rng(2).normal(size=400)
        found = interval(Sample.of(values.tolist()), lambda v: v.mean(-1))
        assert found.high - found.low == pytest.approx(2 * 1.96 * values.std() / 20, rel=0.05)

    def test_repeats_and_does_not_care_for_order(self) -> None:
        values = [3.0, 1.0, 4.0, 1.0, 5.0, 9.0, 2.0, 6.0]
        first = interval(Sample.of(values), interquartile_mean)
        samples._draws.cache_clear()
        assert interval(Sample.of(values[::-1]), interquartile_mean) == first

    def test_one_seed_has_an_interval_of_no_width(self) -> None:
        assert interval(Sample.of([7.0]), interquartile_mean) == Interval(7.0, 7.0, 7.0)

    def test_more_seeds_than_sixteen_bits_count(self, monkeypatch: pytest.MonkeyPatch) -> None:
        monkeypatch.setattr(samples, "RESAMPLES", 3)
        assert samples._draws(70_000, 0).max() > 65_535


class TestCensored:
    def test_few_leave_the_middle_as_it_is(self) -> None:
        """A learner that never rode is worse than all that did, whatever it has paid so far."""
        sample = Sample.of([5.0, 1.0, 2.0, 3.0], [True, False, False, False])
        assert not sample.heavily_censored
        assert interquartile_mean(sample.ranked) == 2.5
        low = Sample.of([0.0, 1.0, 2.0, 3.0], [True, False, False, False])
        assert interquartile_mean(low.ranked) == 2.5
        assert interval(low, interquartile_mean).high == math.inf
        assert interval(low, interquartile_mean).as_json()["high"] is None

    def test_all(self) -> None:
        sample = Sample.of([5.0, 5.0], [True, True])
        assert sample.heavily_censored
        assert kaplan_meier_median(sample) == Interval(math.inf, math.inf, math.inf)
        assert median(sample.ranked) == math.inf

    def test_kaplan_and_meier_s_own_example(self) -> None:
        """Section 2 of their paper: deaths at 0.8, 3.1, 5.4, 9.2, losses at 1.0, 2.7, 7.0, 12.1:
        survival 7/8, 7/10, 21/40, 21/80."""
        values = [0.8, 1.0, 2.7, 3.1, 5.4, 7.0, 9.2, 12.1]
        lost = [False, True, True, False, False, True, False, True]
        sample = Sample.of(values[::-1], lost[::-1])
        expected = [7 / 8, 7 / 8, 7 / 8, 7 / 10, 21 / 40, 21 / 40, 21 / 80, 21 / 80]
        assert survival(sample) == pytest.approx(expected)
        assert kaplan_meier_median(sample).value == 9.2

    def test_a_tie_of_an_event_and_a_loss(self) -> None:
        """The lost one was at risk: 1 - 1/3, then nothing, then 0."""
        sample = Sample.of([2.0, 2.0, 4.0], [True, False, False])
        assert survival(sample) == pytest.approx([2 / 3, 2 / 3, 0])

    def test_ties_of_events_telescope(self) -> None:
        assert survival(Sample.of([1.0, 1.0, 1.0, 2.0])) == pytest.approx([3 / 4, 1 / 2, 1 / 4, 0])

    @pytest.mark.parametrize("n", range(1, 12))
    def test_without_censoring_it_is_the_median(self, n: int) -> None:
        values = np.random.default_rng(n).normal(size=n).tolist()
        sample = Sample.of(values)
        assert kaplan_meier_median(sample).value == pytest.approx(statistics.median(values))

    def test_exactly_half_is_not_reached(self) -> None:
        sample = Sample.of([1.0, 2.0, 9.0, 9.0], [False, False, True, True])
        assert kaplan_meier_median(sample).value == math.inf

    @pytest.mark.oracle
    def test_exponential_lives_that_are_cut_short(self) -> None:
        """Of lives with mean 1, half of which end by censoring, the median is still ln 2."""
        random = np.random.default_rng(3)
        lives, losses = random.exponential(size=(2, 4000))
        sample = Sample.of(np.minimum(lives, losses).tolist(), (losses < lives).tolist())
        found = kaplan_meier_median(sample)
        assert found.value == pytest.approx(math.log(2), rel=0.06)
        assert found.low < math.log(2) < found.high


class TestComparison:
    def test_difference(self) -> None:
        random = np.random.default_rng(4)
        few, many = random.normal(0, 1, 300), random.normal(2, 1, 200)
        found = difference(Sample.of(many.tolist()), Sample.of(few.tolist()))
        assert found is not None
        cut = interquartile_mean(np.sort(many)) - interquartile_mean(np.sort(few))
        assert found.value == pytest.approx(cut)
        assert found.low < found.value < found.high
        assert found.value == pytest.approx(2, abs=4 * math.sqrt(1.2 * (1 / 300 + 1 / 200)))
        # The variance of the difference of two means is the sum of theirs; the middle half's mean
        # of normal values has 1.2 times the variance of the mean.
        width = 2 * 1.96 * math.sqrt(1.2 * (1 / 300 + 1 / 200))
        assert found.high - found.low == pytest.approx(width, rel=0.15)

    def test_of_a_sample_with_itself_is_not_of_no_width(self) -> None:
        """The two are resampled independently."""
        sample = Sample.of([float(k) for k in range(20)])
        found = difference(sample, sample)
        assert found is not None
        assert found.low < 0 == found.value < found.high

    def test_heavily_censored_has_no_difference(self) -> None:
        lost = Sample.of([1.0, 5.0], [False, True])
        assert difference(lost, Sample.of([1.0])) is None
        assert difference(Sample.of([1.0]), lost) is None

    def test_infinite_on_both_sides_is_undecided(self) -> None:
        sample = Sample.of([1.0, 2.0, 3.0, 9.0], [False, False, False, True])
        found = difference(sample, sample)
        assert found == Interval(0.0, -math.inf, math.inf)

    def test_probability_less_by_counting_pairs(self) -> None:
        random = np.random.default_rng(5)
        ours, theirs = random.integers(5, size=9).tolist(), random.integers(6, size=7).tolist()
        pairs = [(a < b) + 0.5 * (a == b) for a in ours for b in theirs]
        found = probability_less(Sample.of(ours), Sample.of(theirs))
        assert found.value == pytest.approx(statistics.fmean(pairs))
        assert found.low <= found.value <= found.high

    def test_probability_less_of_resamples(self, monkeypatch: pytest.MonkeyPatch) -> None:
        """Each resample by counting its pairs."""
        monkeypatch.setattr(samples, "RESAMPLES", 200)
        ours, theirs = np.array([1.0, 2.0, 2.0, 5.0]), np.array([0.0, 2.0, 6.0])
        a, b = ours[samples._draws(4, 0)], theirs[samples._draws(3, 1)]
        less = (a[:, :, None] < b[:, None]) + 0.5 * (a[:, :, None] == b[:, None])
        expected = samples.percentiles(less.mean((1, 2)))
        found = probability_less(Sample.of(ours.tolist()), Sample.of(theirs.tolist()))
        assert (found.low, found.high) == pytest.approx(expected)

    def test_never_riding_is_worse_than_any_ride_and_a_tie_with_another(self) -> None:
        never, rode = Sample.of([0.0], [True]), Sample.of([1000.0])
        assert probability_less(rode, never).value == 1
        assert probability_less(never, never).value == 0.5


@pytest.mark.parametrize(
    ("values", "censored"), [([], None), ([math.nan], None), ([1.0], [True, False])]
)
def test_refuses_what_is_no_sample(values: list[float], censored: list[bool] | None) -> None:
    with pytest.raises(ValueError, match=r"values.*expected"):
        Sample.of(values, censored)
