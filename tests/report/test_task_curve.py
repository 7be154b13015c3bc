"""The graph of the paper's Figure 3, on episodes made by hand."""

from __future__ import annotations

from edtorch.report.domain import Domain
from edtorch.report.task_curve import FAILURE_RATE, curve, task_curve
from edtorch.run.episodes import Episode
from sims.base import Measure, Outcome, Words

ARM = Domain(
    "arm",
    Words("crash", "crashes"),
    (Measure("joint_error_rad", "error", "rad"), Measure("joint_speed_rad_s", "speed", "rad/s")),
)
DONE, FELL = Outcome.SUCCEEDED, Outcome.FAILED


def _episode(row: int, start: float, error: float, outcome: Outcome = DONE) -> Episode:
    measures = {"joint_error_rad": error, "joint_speed_rad_s": 2 * error}
    return Episode(row, 0, start, 2.0, outcome, measures)


EPISODES = [
    _episode(0, 0.0, 0.4, FELL),
    _episode(0, 2.0, 0.2),
    _episode(0, 8.0, 0.1),
    _episode(1, 0.0, 0.5),
    _episode(1, 8.0, 0.3),
    _episode(2, 0.0, 0.7),
]


def test_quartiles_over_the_seeds_of_their_means() -> None:
    found = curve(EPISODES, 3, 2, "joint_error_rad")
    assert found.seconds.tolist() == [2.5, 7.5]
    # Means of the first span: .3, .5, .7; of the second, where seed 2 has none: .1, .3.
    assert found.quartiles[:, 0].round(12).tolist() == [0.4, 0.5, 0.6]
    assert found.quartiles[:, 1].round(12).tolist() == [0.15, 0.2, 0.25]
    crashes = curve(EPISODES, 3, 2, FAILURE_RATE)
    assert crashes.quartiles[1].tolist() == [0.0, 0.0]
    assert crashes.quartiles[2].tolist() == [0.25, 0.0]


def test_three_panels_and_a_legend_for_several_runs() -> None:
    runs = {"a": (EPISODES, 3), "b": (EPISODES, 3), "none": ([], 1)}
    figure = task_curve(runs, ARM, "title")
    assert [len(axes.lines) for axes in figure.axes] == [2, 2, 2]
    assert figure.axes[0].get_legend() is not None
    labels = [axes.get_ylabel() for axes in figure.axes]
    assert labels == ["error, rad", "speed, rad/s", "share of crashes"]
    assert [axes.get_yscale() for axes in figure.axes] == ["log", "log", "linear"]
