"""The graph of the paper's Figure 3, on episodes made by hand."""

from __future__ import annotations

from edtorch.report.reaching import curve, reaching_curve
from edtorch.report.statistics import goal_figures
from edtorch.run.episodes import Episode
from sims.base import Outcome

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
    crashes = curve(EPISODES, 3, 2, "crash_rate")
    assert crashes.quartiles[1].tolist() == [0.0, 0.0]
    assert crashes.quartiles[2].tolist() == [0.25, 0.0]


def test_three_panels_and_a_legend_for_several_runs() -> None:
    figure = reaching_curve({"a": (EPISODES, 3), "b": (EPISODES, 3), "none": ([], 1)}, "title")
    assert [len(axes.lines) for axes in figure.axes] == [2, 2, 2]
    assert figure.axes[0].get_legend() is not None


def test_figures_of_fresh_episodes() -> None:
    own = [_episode(0, 0.0, e) for e in (0.1, 0.2, 0.6)] + [_episode(0, 0.0, 1.1, FELL)]
    figures = goal_figures([own, own[:1]])
    assert figures["joint_error_rad"]["per_seed"] == [0.5, 0.1]
    assert figures["joint_error_median_rad"]["per_seed"] == [0.4, 0.1]
    assert figures["joint_speed_rad_s"]["max"] == 1.0
    assert figures["crash_rate"]["per_seed"] == [0.25, 0.0]
    assert figures["success_rate"]["min"] == 0.75
