"""Groups beside their baseline: the numbers of a report, on runs made by hand."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

from edtorch.report.charts import charts
from edtorch.report.comparison import (
    SUCCEEDED,
    ZERO_FAILURES,
    Comparison,
    as_json,
    compare,
    quantile,
)
from edtorch.report.document import overview
from edtorch.report.domain import Domain, domain_of
from edtorch.report.groups import sections
from edtorch.report.runs import load_all
from edtorch.report.samples import Sample
from edtorch.report.tables import as_text
from sims.base import Words
from sims.bicycle import Bicycle
from tests.report.folders import learners, search, spread, write

BICYCLE = domain_of(Bicycle().spec)
ARM = Domain("arm", Words("crash", "crashes", "reach", "reaches"), (), survival=False)


def _compare(folder: Path, domain: Domain = BICYCLE) -> Comparison:
    runs, left_out = load_all([folder], lambda _: domain)
    assert left_out == []
    (section,), _ = sections(runs, lambda _: {}, baseline=None, by_folder=True)
    return compare(section)


class TestZeroFallRate:
    def test_of_seeds_that_rode_without_a_fall(self, tmp_path: Path) -> None:
        """One whose budget ended before it fell or rode has shown nothing."""
        learners(tmp_path / "run", [0, 0, 0, 3], never=[2])
        (row,) = _compare(tmp_path).rows
        share = row.shares[ZERO_FAILURES].proportion
        assert (share.count, share.total) == (2, 4)
        assert row.shares[SUCCEEDED].proportion.count == 3

    def test_beside_the_baseline(self, tmp_path: Path) -> None:
        learners(tmp_path / "a", [0] * 12 + [1] * 8)
        learners(tmp_path / "b", [0] * 20, eval={"episodes": 3})
        base, other = _compare(tmp_path).rows
        assert base.shares[ZERO_FAILURES].p is None
        # z = 0.4 / sqrt(0.8 * 0.2 * 2 / 20) = 3.162
        assert other.shares[ZERO_FAILURES].p == pytest.approx(0.00157, rel=0.01)


class TestLearners:
    def test_estimates(self, tmp_path: Path) -> None:
        learners(tmp_path / "a", [1, 2, 3, 40])
        learners(tmp_path / "b", [0, 0, 1, 1], eval={"episodes": 3})
        base, other = _compare(tmp_path).rows
        falls = base.estimates["failures_before_first_success"]
        assert falls.middle is not None
        assert (falls.median.value, falls.middle.value, falls.worst) == (2.5, 2.5, 40)
        assert falls.difference is None and falls.better is None
        beside = other.estimates["failures_before_first_success"]
        assert beside.difference is not None and beside.better is not None
        assert beside.difference.value == -2
        # Of the 16 pairs the other falls less often in 14 and as often in 2.
        assert beside.better.value == 15 / 16

    def test_more_is_better_of_a_goal_rate(self, tmp_path: Path) -> None:
        learners(tmp_path / "a", [1, 1], more={"goal_rate": spread([0.5, 0.5])})
        learners(tmp_path / "b", [1, 1], eval={"episodes": 3})
        rate = _compare(tmp_path).rows[1].estimates["goal_rate"]
        assert rate.better is not None and rate.difference is not None
        assert (rate.better.value, rate.better.low, rate.better.high) == (1, 1, 1)
        assert rate.difference.value == 0.5

    def test_few_censored(self, tmp_path: Path) -> None:
        learners(tmp_path / "a", [1, 2, 3, 4], never=[0])
        falls = _compare(tmp_path).rows[0].estimates["failures_before_first_success"]
        assert falls.censored == 1
        assert falls.middle is not None
        assert falls.middle.value == 3.5
        assert falls.worst == math.inf

    def test_many_censored(self, tmp_path: Path) -> None:
        """Only the Kaplan-Meier median; where that is not reached, a bound."""
        learners(tmp_path / "a", [1, 2, 3, 4])
        learners(tmp_path / "b", [1, 2, 9, 9], never=[2, 3], eval={"episodes": 3})
        row = _compare(tmp_path).rows[1]
        falls = row.estimates["failures_before_first_success"]
        assert falls.middle is None and falls.difference is None
        assert falls.median.value == math.inf
        assert falls.at_least == 5.5
        assert falls.as_json()["median"]["value"] is None
        # What comes after the first ride is of those that had one.
        assert len(row.estimates["failures_after_first_success"].sample) == 2

    def test_none_rode(self, tmp_path: Path) -> None:
        learners(tmp_path / "a", [3, 4], never=[0, 1], more={"goal_time_s": spread([None, None])})
        found = _compare(tmp_path)
        assert "failures_after_first_success" not in found.rows[0].estimates
        assert "goal_time_s" not in [q.name for q in found.quantities]

    def test_a_family_of_tasks(self, tmp_path: Path) -> None:
        final = {"minutes": 4.0, "crash_rate": spread([0.1, 0.3]), "success_rate": spread([1, 0.5])}
        learners(tmp_path / "a", [3, 4], more={"final": final})
        found = _compare(tmp_path, ARM)
        # In such an old summary the time limit counted as a success; here it is none.
        assert [q.name for q in found.quantities] == ["failure_rate", "success_rate"]
        assert [q.brief for q in found.quantities] == ["crash rate", "reach rate"]
        assert found.rows[0].shares == {}

    def test_a_method_that_does_not_learn(self, tmp_path: Path) -> None:
        """It has no experience in which it could have failed or succeeded."""
        idle = {"simulated_seconds": [0.0, 0.0]}
        learners(tmp_path / "a", [3, 4], more={"simulated_seconds": [9.0, 9.0]})
        learners(tmp_path / "lqr", [0, 0], never=[0, 1], more=idle, rival={"name": "lqr"})
        learner, lqr = _compare(tmp_path).rows
        assert learner.group.learns and not lqr.group.learns
        assert "failures_before_first_success" in learner.estimates
        assert set(lqr.estimates) == {"goal_rate", "goal_time_s"} and lqr.shares == {}
        table = overview(_compare(tmp_path))
        cells = dict(zip(table.header, table.rows[1], strict=True))
        assert cells["rode"] == "does not learn" and cells["falls before"] == "-"

    def test_where_nothing_can_fail_or_succeed(self, tmp_path: Path) -> None:
        domain = Domain("Pendulum-v1", return_of="environment")
        returns, seconds = spread([-150.0, -170.0]), spread([10.0, 10.0])
        summary = {
            "seeds": [0, 1],
            "domain": domain.as_json(),
            "failure_rate": spread([0.0, 0.0]),
            "return": returns,
            "episode_s": seconds,
            "training": {"failure_rate": spread([0.0, 0.0]), "return": returns},
            "simulated_seconds": [60.0, 60.0],
        }
        write(tmp_path / "run", {"domain": {"_target_": "sims.x.X", "env_id": "P-v1"}}, summary)
        found = _compare(tmp_path)
        assert found.section.title == "P-v1: learners"
        names = [quantity.name for quantity in found.quantities]
        assert names == ["return", "episode_s", "training.return"]
        assert overview(found).header == ("group", "seeds", "return", "CPU s per seed")
        text = as_text(overview(found)) + "".join(chart.title for chart in charts(found))
        assert not re.search("fall|ride|rode|goal|succe|fail", text)

    def test_cpu_seconds_are_of_all_runs(self, tmp_path: Path) -> None:
        learners(tmp_path / "a", [3, 4])
        learners(tmp_path / "b", [3, 4, 5], seed=9)
        assert _compare(tmp_path).rows[0].cpu_s == 10


class TestSearches:
    def test_are_pooled(self, tmp_path: Path) -> None:
        search(tmp_path / "a", 3, 100)
        search(tmp_path / "b", 5, 200, seed=1)
        (row,) = _compare(tmp_path).rows
        share = row.shares["goal"].proportion
        assert (share.count, share.total) == (8, 300)

    def test_beside_the_baseline(self, tmp_path: Path) -> None:
        search(tmp_path / "a", 60, 200)
        search(tmp_path / "b", 80, 200, rival={"runs": 3})
        assert _compare(tmp_path).rows[1].shares["goal"].p == pytest.approx(0.0360, abs=1e-4)


def test_quantile_is_a_value_that_occurs() -> None:
    ranked = Sample.of([float(k) for k in range(1, 21)]).ranked
    assert [quantile(ranked, q) for q in (0.05, 0.5, 0.95, 1.0)] == [1, 10, 19, 20]


def test_json_names_runs_and_seeds(tmp_path: Path) -> None:
    learners(tmp_path / "a", [3, 4], seed=7)
    (group,) = as_json(_compare(tmp_path))["groups"]
    assert group["seeds"] == [7, 8]
    (run,) = group["runs"]
    assert run["command"] == "edtorch-train seed=7"
    assert run["versions"] == {"torch": "2.13.0"}
