"""The learning curve: what is in it, and that its files open."""

from __future__ import annotations

import math
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from edtorch.report.figures import Ride, learning_curve, save_figure, unwrapped_strokes
from edtorch.run.episodes import Episode
from sims.base import Outcome

RIDE = Ride(np.arange(4.0), np.array([0.1, 0.2, 0.1, 0.0]), "angle_to_goal", "rad", "a ride")


def _episode(row: int, start: float, seconds: float, outcome: Outcome) -> Episode:
    return Episode(row, 0, start, seconds, outcome, {"shortest_time_s": 356.0})


EPISODES = [
    _episode(0, 0, 2, Outcome.FAILED),
    _episode(1, 0, 3, Outcome.FAILED),
    _episode(0, 2, 400, Outcome.SUCCEEDED),
    _episode(1, 3, 1000, Outcome.TIMED_OUT),
]


def _texts(figure: Figure) -> str:
    """Everything that is written in the figure."""
    words = [text.get_text() for axes in figure.axes for text in axes.texts]
    words += [axes.get_xlabel() + axes.get_ylabel() + axes.get_title() for axes in figure.axes]
    for axes in figure.axes:
        if (legend := axes.get_legend()) is not None:
            words += [text.get_text() for text in legend.get_texts()]
    return "\n".join(words)


def test_every_outcome_has_its_mark_and_count() -> None:
    texts = _texts(learning_curve(EPISODES, 2, RIDE, "two learners"))
    for wanted in ("fell (2)", "rode to the time limit (1)", "reached the goal (1)"):
        assert wanted in texts
    assert "shortest\npossible,\n356 s" in texts
    assert "angle to goal, degrees" in texts


def test_marks_stand_where_the_episodes_end() -> None:
    upper = learning_curve(EPISODES, 2, RIDE, "t").axes[0]
    marks = np.concatenate([np.asarray(c.get_offsets()) for c in upper.collections])
    assert sorted(map(tuple, marks.tolist())) == [(2, 2), (3, 3), (402, 400), (1003, 1000)]
    assert upper.get_yscale() == "log"


def test_without_any_episode_it_says_so() -> None:
    figure = learning_curve([], 2, RIDE, "t")
    assert "no episode has ended" in _texts(figure)
    assert len(figure.axes) == 2
    assert len(learning_curve(EPISODES, 2, None, "t").axes) == 1


def test_no_stroke_crosses_the_circle() -> None:
    turn = 2 * math.pi
    values = np.array([3.0, 3.1, -3.1, -3.0, 0.1, 3.1, 3.14, -3.13])
    seconds, broken = unwrapped_strokes(np.arange(8.0), values, turn)
    strokes = np.diff(broken)
    assert np.nanmax(np.abs(strokes)) < turn / 2
    assert np.isnan(broken).sum() == 2
    assert broken[~np.isnan(broken)].tolist() == values.tolist()
    assert seconds[~np.isnan(broken)].tolist() == list(range(8))
    drawn = learning_curve([], 1, Ride(np.arange(8.0), values, "x", "rad", "", turn), "t").axes[1]
    assert np.isnan(np.asarray(drawn.lines[0].get_ydata(), dtype=float)).sum() == 2


def test_what_does_not_wrap_is_not_broken() -> None:
    values = np.array([0.0, 100.0, -100.0])
    assert unwrapped_strokes(np.arange(3.0), values, 0.0)[1] is values


@pytest.mark.parametrize("episodes", [EPISODES, []])
def test_files_open(episodes: list[Episode], tmp_path: Path) -> None:
    save_figure(learning_curve(episodes, 2, RIDE, "t"), tmp_path, "curve")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["curve.png", "curve.svg"]
    with Image.open(tmp_path / "curve.png") as picture:
        picture.load()
        assert min(picture.size) > 400
        assert len(picture.convert("L").getcolors(256) or []) > 5
    root = ElementTree.parse(tmp_path / "curve.svg").getroot()
    assert root.tag.endswith("svg")
