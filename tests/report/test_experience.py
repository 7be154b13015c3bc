"""The figure of success against experience."""

from __future__ import annotations

import math

import numpy as np
import pytest

from edtorch.report.experience import SeedExperience, experience_curve, median_seconds

SEEDS = [
    SeedExperience([4.0, 8.0], [0.2, 1.0], 8.0),
    SeedExperience([4.0], [0.97], 4.0),
    SeedExperience([4.0, 6.5, 10.5], [0.0, 0.1, 0.3], math.inf),
]


def test_the_share_of_solved_seeds_rises_where_they_are_solved() -> None:
    figure = experience_curve(SEEDS, 0.95, "three")
    share, rates = figure.axes
    (line,) = share.get_lines()
    moments, shares = np.asarray(line.get_data())
    found = dict(zip(moments.tolist(), shares.tolist(), strict=True))
    assert found == pytest.approx({0: 0, 4: 1 / 3, 6.5: 1 / 3, 8: 2 / 3, 10.5: 2 / 3, 11.55: 2 / 3})
    assert len(rates.get_lines()) == len(SEEDS) + 1


def test_an_unsolved_seed_counts_as_infinity() -> None:
    assert median_seconds([4.0, math.inf, 8.0]) == 8
    assert median_seconds([math.inf, math.inf, 8.0]) == math.inf
    assert median_seconds([4.0, math.inf]) == math.inf
