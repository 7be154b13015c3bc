"""The learning curve: what is in it, and that its files open."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from edtorch.report.domain import Domain, domain_of
from edtorch.report.figures import (
    Trace,
    height,
    learning_curve,
    length,
    save_figure,
    shortest_time,
    unwrapped_strokes,
)
from edtorch.run.episodes import Episode
from sims.base import DEFAULT_WORDS, Outcome
from sims.bicycle import Bicycle

BICYCLE = domain_of(Bicycle().spec)
TRACE = Trace(np.arange(4.0), np.array([0.1, 0.2, 0.1, 0.0]), "angle_to_goal", "rad", "a ride")


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
    texts = _texts(learning_curve(EPISODES, 2, BICYCLE, length(356.0), TRACE, "two learners"))
    for wanted in ("fell (2)", "rode to the time limit (1)", "reached the goal (1)"):
        assert wanted in texts
    assert "shortest\npossible,\n356 s" in texts
    assert "angle to goal, degrees" in texts


def test_marks_stand_where_the_episodes_end() -> None:
    upper = learning_curve(EPISODES, 2, BICYCLE, length(), TRACE, "t").axes[0]
    marks = np.concatenate([np.asarray(c.get_offsets()) for c in upper.collections])
    assert sorted(map(tuple, marks.tolist())) == [(2, 2), (3, 3), (402, 400), (1003, 1000)]
    assert upper.get_yscale() == "log"


def test_without_any_episode_it_says_so() -> None:
    figure = learning_curve([], 2, BICYCLE, length(), TRACE, "t")
    assert "no episode has ended" in _texts(figure)
    assert len(figure.axes) == 2
    assert len(learning_curve(EPISODES, 2, BICYCLE, length(), None, "t").axes) == 1


def test_no_stroke_crosses_the_circle() -> None:
    turn = 2 * math.pi
    values = np.array([3.0, 3.1, -3.1, -3.0, 0.1, 3.1, 3.14, -3.13])
    seconds, broken = unwrapped_strokes(np.arange(8.0), values, turn)
    strokes = np.diff(broken)
    assert np.nanmax(np.abs(strokes)) < turn / 2
    assert np.isnan(broken).sum() == 2
    assert broken[~np.isnan(broken)].tolist() == values.tolist()
    assert seconds[~np.isnan(broken)].tolist() == list(range(8))
    trace = Trace(np.arange(8.0), values, "x", "rad", "", turn)
    drawn = learning_curve([], 1, BICYCLE, length(), trace, "t").axes[1]
    assert np.isnan(np.asarray(drawn.lines[0].get_ydata(), dtype=float)).sum() == 2


def test_what_does_not_wrap_is_not_broken() -> None:
    values = np.array([0.0, 100.0, -100.0])
    assert unwrapped_strokes(np.arange(3.0), values, 0.0)[1] is values


def test_elsewhere_it_is_the_return_that_is_shown() -> None:
    hopper = Domain("Hopper", DEFAULT_WORDS, (), None, "environment")
    episodes = [
        replace(e, total_reward=reward) for e, reward in zip(EPISODES, (3, 5, 8, -1), strict=True)
    ]
    figure = learning_curve(episodes, 2, hopper, height(hopper, None, episodes), None, "t")
    (axes,) = figure.axes
    marks = np.concatenate([np.asarray(c.get_offsets()) for c in axes.collections])
    assert sorted(map(tuple, marks.tolist())) == [(2, 3), (3, 5), (402, 8), (1003, -1)]
    texts = _texts(figure)
    for wanted in ("return", "failed (2)", "time limit (1)", "succeeded (1)"):
        assert wanted in texts
    assert not {"fell", "rode", "ride", "goal"} & set(texts.split())
    assert axes.get_yscale() == "linear"
    # Nothing is known of rewards, or the domain measures how long a success takes.
    assert height(hopper, None, EPISODES).label == "length of episode, s"
    assert height(BICYCLE, 300.0, episodes).line == (300.0, "shortest\npossible,\n300 s")


def test_the_shortest_time_is_that_of_successes() -> None:
    assert shortest_time(EPISODES, "shortest_time_s") == 356.0
    assert shortest_time(EPISODES[:2], "shortest_time_s") is None
    assert shortest_time(EPISODES, "") is None


@pytest.mark.parametrize("episodes", [EPISODES, []])
def test_files_open(episodes: list[Episode], tmp_path: Path) -> None:
    save_figure(learning_curve(episodes, 2, BICYCLE, length(), TRACE, "t"), tmp_path, "curve")
    assert sorted(p.name for p in tmp_path.iterdir()) == ["curve.png", "curve.svg"]
    with Image.open(tmp_path / "curve.png") as picture:
        picture.load()
        assert min(picture.size) > 400
        assert len(picture.convert("L").getcolors(256) or []) > 5
    root = ElementTree.parse(tmp_path / "curve.svg").getroot()
    assert root.tag.endswith("svg")
