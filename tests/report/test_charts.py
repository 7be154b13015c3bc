"""The axes of a report's charts."""

from __future__ import annotations

from collections.abc import Sequence

import pytest
from matplotlib.figure import Figure

from edtorch.report.charts import DECADES, stretch


@pytest.mark.parametrize(
    ("values", "scale"),
    [
        ([1.0, 19.0], "linear"),
        ([1.0, 21.0], "log"),
        ([0.0, 1.0, 19.0], "linear"),
        ([0.0, 1.0, 21.0], "symlog"),
        ([-1.0, 1.0, 1000.0], "linear"),
        ([0.0], "linear"),
        ([], "linear"),
    ],
)
def test_an_axis_is_logarithmic_where_values_differ_much(
    values: Sequence[float], scale: str
) -> None:
    axes = Figure().subplots()
    stretch(axes, values)
    assert axes.get_xscale() == scale


@pytest.mark.parametrize("values", [[0.0, 30.0, 5000.0], [0.0, 0.6, 300.0, 400_000.0]])
def test_zero_and_the_others_can_be_told_apart(values: Sequence[float]) -> None:
    """In the order and about evenly: the least of the others is as far from zero as any."""
    axes = Figure().subplots()
    axes.scatter(values, values)
    stretch(axes, values)
    places = axes.transData.transform([(v, 0.0) for v in values])[:, 0]
    steps = places[1:] - places[:-1]
    assert (steps > 0.1 * (places[-1] - places[0])).all()
    ticks = axes.get_xticks()
    assert ticks[0] == 0 and 2 <= len(ticks) <= DECADES + 2
    assert ticks[1] <= values[1]
