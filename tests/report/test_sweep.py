"""A sweep in a report: where its figures stand, and which settings are best."""

from __future__ import annotations

import csv
import itertools
import json
import random
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.colors import to_rgba
from matplotlib.lines import Line2D
from matplotlib.patches import Rectangle

from edtorch.report import samples
from edtorch.report.canvas import NARROW, WIDE
from edtorch.report.comparison import compare_all
from edtorch.report.groups import sections
from edtorch.report.runs import Unusable, load_all
from edtorch.report.sweep import axes_of, read_sweep, sweeps_in, varied
from edtorch.report.sweep_charts import FRAME, sweep_charts
from edtorch.report.sweep_document import best_table, sweep_json, sweep_part
from edtorch.report.sweep_view import SweepView, beside_the_best, ranked, views
from tests.report.folders import learners

Settings = Mapping[str, Sequence[str]]


def _made(folder: Path, axes: Settings, lost: Mapping[int, str] | None = None) -> Path:
    """A sweep of bicycle learners who fall the less the greater their settings are, numbered as
    Hydra would; lost: why jobs have failed."""
    rows: list[dict[str, str]] = []
    draw = random.Random(1)
    for number, values in enumerate(itertools.product(*axes.values())):
        settings = dict(zip(axes, values, strict=True))
        name = str(number)
        if lost and number in lost:
            (folder / name).mkdir(parents=True)
            status = {"status": "failed", "why": lost[number]}
            (folder / name / "status.json").write_text(json.dumps(status))
        else:
            groups: dict[str, Any] = {}
            seed = int(settings.get("seed", 0))
            for key, value in settings.items():
                if key != "seed":
                    group, _, last = key.partition(".")
                    groups.setdefault(group, {})[last] = float(value)
            worth = 10 * sum(axes[k].index(v) for k, v in settings.items() if k != "seed")
            falls = [80 - worth + draw.randrange(5) for _ in range(8)]
            learners(folder / name, falls, seed=seed, **groups)
        rows.append({"folder": name, "status": "failed" if number in (lost or ()) else "done"})
        rows[-1] |= settings
    with (folder / "sweep.csv").open("w", newline="") as file:
        table = csv.DictWriter(file, ["folder", "status", *axes])
        table.writeheader()
        table.writerows(rows)
    return folder


def _view(folder: Path) -> SweepView:
    runs, _ = load_all([folder])
    comparisons = compare_all(sections(runs, lambda s: {}, baseline=None, by_folder=False)[0])
    (sweep,), _ = sweeps_in([folder])
    (view,) = views(sweep, comparisons)
    return view


ALPHA = {"step.alpha": ["0.01", "0.1", "1"]}
TWO = {**ALPHA, "unroll.horizon": ["5", "10"]}
THREE = {**TWO, "exploration.deviation": ["0.1", "0.2"]}


class TestTable:
    def test_axes(self, tmp_path: Path) -> None:
        """Numbers by size, whatever their order; seeds are no axis, but they vary."""
        axes = {"step.alpha": ["10", "9", "0.5"], "step": ["1", "2"], "seed": ["0", "8"]}
        sweep = read_sweep(_made(tmp_path / "s", axes))
        found = {axis.key: axis.values for axis in axes_of(sweep.jobs)}
        assert found == {"step.alpha": ("0.5", "9", "10"), "step": ("1", "2")}
        assert [axis.key for axis in varied(sweep.jobs)] == list(axes)

    def test_jobs_say_what_they_are_today(self, tmp_path: Path) -> None:
        """The table is of the end of the sweep."""
        folder = _made(tmp_path / "s", ALPHA, {1: "no\n wheel"})
        (folder / "0" / "status.json").write_text('{"status": "done", "why": null}')
        sweep = read_sweep(folder)
        assert [job.status for job in sweep.jobs] == ["done", "failed", "done"]
        assert [job.why for job in sweep.unfinished] == ["no wheel"]
        (folder / "1" / "status.json").write_text('{"status": "running", "why": null}')
        assert [job.status for job in read_sweep(folder).unfinished] == ["running"]

    @pytest.mark.parametrize(
        "text", ["", "a,b\n", "folder,status\nx\n", 'folder,status\n"x', "folder,status\nx,y,z\n"]
    )
    def test_a_damaged_one_is_left_out(self, tmp_path: Path, text: str) -> None:
        (tmp_path / "sweep.csv").write_text(text)
        with pytest.raises(Unusable, match=r"corrupted: sweep\.csv"):
            read_sweep(tmp_path)
        sweeps, left_out = sweeps_in([tmp_path])
        assert sweeps == []
        assert [item.path for item in left_out] == [tmp_path]

    def test_each_once(self, tmp_path: Path) -> None:
        _made(tmp_path / "a", ALPHA)
        _made(tmp_path / "b", ALPHA)
        (tmp_path / ".c").mkdir()
        (tmp_path / ".c" / "sweep.csv").write_text("folder,status\n")
        found, _ = sweeps_in([tmp_path, tmp_path / "a"])
        assert [sweep.name for sweep in found] == ["a", "b"]


class TestRanks:
    def test_best_first_with_the_difference_from_it(self, tmp_path: Path) -> None:
        view = _view(_made(tmp_path / "s", TWO))
        assert view.judged_by.name == "seconds_before_first_success"
        order = ranked(view)
        assert order[0] == ("1", "10")
        assert order[-1] == ("0.01", "5")
        found = dict(beside_the_best(view))
        assert found[order[0]].difference is None
        own, best = (found[place].sample for place in (order[-1], order[0]))
        assert found[order[-1]].difference == samples.difference(own, best)

    def test_seeds_of_several_jobs_are_one_setting(self, tmp_path: Path) -> None:
        view = _view(_made(tmp_path / "s", {**ALPHA, "seed": ["0", "8"]}))
        assert [axis.key for axis in view.axes] == ["step.alpha"]
        assert {len(row.group.seeds) for row in view.rows.values()} == {16}

    def test_the_table_of_the_best(self, tmp_path: Path) -> None:
        view = _view(_made(tmp_path / "s", TWO))
        table = best_table(view)
        assert table.header[:5] == (
            "rank",
            "seeds",
            "step.alpha",
            "unroll.horizon",
            "seconds before",
        )
        assert [row[2:4] for row in table.rows] == ranked(view)

    def test_lost_jobs_are_told(self, tmp_path: Path) -> None:
        folder = _made(tmp_path / "s", TWO, {3: "the wheel fell off"})
        view = _view(folder)
        part = sweep_part(view.sweep, [view.comparison])
        assert part.heading == "Sweep s"
        assert "6 jobs" in part.paragraphs[0] and "5 done, 1 failed" in part.paragraphs[0]
        (row,) = part.tables[-1].rows
        assert row == ("3", "step.alpha=0.1 unroll.horizon=10", "failed", "the wheel fell off")
        told = sweep_json(view.sweep, [view.comparison])
        assert told["jobs"][3]["why"] == "the wheel fell off"
        assert told["sections"][0]["ranked"][0]["settings"]["step.alpha"] == "1"


def _along(line: Line2D) -> list[float]:
    """Its heights, one for each point."""
    return np.asarray(line.get_ydata(), dtype=float).tolist()


def _labels(panel: Axes) -> tuple[list[str], list[str]]:
    """Of its columns, and of its rows."""
    across, up = (axis.get_ticklabels() for axis in (panel.xaxis, panel.yaxis))
    return [label.get_text() for label in across], [label.get_text() for label in up]


class TestCharts:
    @pytest.mark.parametrize("width", [WIDE, NARROW])
    def test_a_map_over_two_settings(self, tmp_path: Path, width: float) -> None:
        """The number of every cell, darker where it is better, the best in a frame."""
        view = _view(_made(tmp_path / "s", TWO, {3: "the wheel fell off"}))
        (chart,) = sweep_charts(view)
        panel, *_ = chart.draw(width).axes
        columns, rows = _labels(panel)
        written = {
            (columns[round(t.get_position()[0])], rows[round(t.get_position()[1])]): t.get_text()
            for t in panel.texts
        }
        found = view.estimates(view.judged_by)
        for alpha, horizon in itertools.product(*TWO.values()):
            place = (alpha, horizon)
            wanted = f"{found[place].shown.value:.3g}" if place in found else "failed"
            assert written[place] == wanted
        (mesh,) = panel.collections
        shades = np.ma.filled(np.ma.asarray(mesh.get_array()), np.nan)
        order = [shades[rows.index(h), columns.index(a)] for a, h in ranked(view)]
        assert order == sorted(order) and (order[0], order[-1]) == (0, 1)
        (frame,) = [p for p in panel.patches if p.get_edgecolor() == to_rgba(FRAME)]
        assert isinstance(frame, Rectangle)
        column, row = frame.get_center()
        assert (columns[round(column)], rows[round(row)]) == ranked(view)[0]

    def test_a_curve_over_one_setting(self, tmp_path: Path) -> None:
        view = _view(_made(tmp_path / "s", ALPHA))
        (chart,) = sweep_charts(view)
        panel, *_ = chart.draw(WIDE).axes
        assert panel.get_xscale() == "log"
        found = view.estimates(view.judged_by)
        bars = [along for along in map(_along, panel.lines) if len(along) == 2]
        assert bars == [
            [found[(a,)].shown.low, found[(a,)].shown.high] for a in ALPHA["step.alpha"]
        ]

    @pytest.mark.parametrize("width", [WIDE, NARROW])
    def test_parallel_coordinates_over_more(self, tmp_path: Path, width: float) -> None:
        """A line for each setting, through its values to its rank; the best is broad."""
        view = _view(_made(tmp_path / "s", THREE))
        (chart,) = sweep_charts(view)
        (panel,) = chart.draw(width).axes
        lines = [line for line in panel.lines if len(_along(line)) == 4]
        heights = [[0, 0.5, 1], [0, 1], [0, 1]]
        places = {
            tuple(axis.index(h) for axis, h in zip(heights, _along(line)[:3], strict=True)): line
            for line in lines
        }
        assert len(places) == 12
        best = max(lines, key=lambda line: line.get_linewidth())
        assert best is places[(2, 1, 1)]
        assert _along(best)[3] == 0
        assert max(_along(line)[3] for line in lines) == 1
