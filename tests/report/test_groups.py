"""Which runs belong together, and what the groups are called."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from edtorch.report.groups import BaselineUnknown, Section, sections
from edtorch.report.runs import LeftOut, load_all
from tests.report.folders import learners, search

ABSOLUTE = {"_target_": "edtorch.model.fit.AbsoluteError", "rate": 1.0}
SQUARED = {"_target_": "edtorch.model.fit.SquaredError", "rate": 10.0}


def _sections(
    folder: Path,
    baseline: str | None = None,
    *,
    by_folder: bool = False,
    defaults: dict[str, Any] | None = None,
) -> tuple[list[Section], list[LeftOut]]:
    runs, left_out = load_all([folder])
    assert left_out == []
    return sections(runs, lambda _: defaults or {}, baseline=baseline, by_folder=by_folder)


def _labels(section: Section) -> list[str]:
    return [group.label for group in section.groups]


def _step(alpha: float) -> dict[str, Any]:
    return {"_target_": "edtorch.policy.steps.SaturatedStep", "alpha": alpha}


def test_seeds_of_one_configuration_are_pooled(tmp_path: Path) -> None:
    learners(tmp_path / "a", [5, 6], seed=10)
    learners(tmp_path / "b", [7, 8, 9], seed=0, log={"every": 50})
    (section,), left_out = _sections(tmp_path)
    (group,) = section.groups
    assert left_out == []
    assert group.seeds == [0, 1, 2, 10, 11]
    assert group.per_seed("failures_before_first_success") == [7, 8, 9, 5, 6]


def test_a_folder_of_runs_gives_its_name_to_their_group(tmp_path: Path) -> None:
    """Unless another group has a run in it as well."""
    for seed in (0, 1):
        learners(tmp_path / "apart" / f"seed_{seed}", [5], seed=seed)
        learners(tmp_path / "mixed" / f"seed_{seed}", [5], seed=seed, step=_step(0.3))
    learners(tmp_path / "mixed" / "other", [5], step=_step(0.2))
    (section,), _ = _sections(tmp_path, by_folder=True)
    assert _labels(section) == ["apart", "other", "mixed/seed_0"]


class TestOverlap:
    def test_counted_once_and_named(self, tmp_path: Path) -> None:
        learners(tmp_path / "a", [5, 6, 7])
        learners(tmp_path / "b", [9, 8], seed=2)
        (section,), (named,) = _sections(tmp_path)
        (group,) = section.groups
        assert group.seeds == [0, 1, 2, 3]
        assert group.per_seed("failures_before_first_success") == [5, 6, 7, 8]
        assert named.path == tmp_path / "b"
        assert named.why == f"seed 2: counted once, from {tmp_path / 'a'} (other figures)"

    def test_a_copy(self, tmp_path: Path) -> None:
        learners(tmp_path / "a", [5, 6])
        learners(tmp_path / "b", [5, 6])
        (section,), (named,) = _sections(tmp_path)
        assert [run.path.name for run in section.groups[0].runs] == ["a"]
        assert "all of its seeds: counted once" in named.why
        assert "the same figures" in named.why

    def test_of_searches(self, tmp_path: Path) -> None:
        search(tmp_path / "a", 3, 100)
        search(tmp_path / "b", 3, 100)
        search(tmp_path / "c", 5, 100, seed=1)
        (section,), (named,) = _sections(tmp_path)
        assert section.groups[0].seeds == [0, 1]
        assert named.path.name == "b"


class TestLabels:
    def test_only_what_differs(self, tmp_path: Path) -> None:
        learners(tmp_path / "a", [5], step=_step(0.1), eval={"episodes": 10})
        learners(tmp_path / "b", [5], step=_step(0.3), eval={"episodes": 10})
        (section,), _ = _sections(tmp_path)
        assert _labels(section) == ["step.alpha=0.1", "step.alpha=0.3"]

    def test_whole_numbers_and_others_are_one_setting(self, tmp_path: Path) -> None:
        learners(tmp_path / "a", [5], train={"seconds": 10})
        learners(tmp_path / "b", [6], seed=1, train={"seconds": 10.0})
        assert len(_sections(tmp_path)[0][0].groups) == 1

    def test_true_is_not_one(self, tmp_path: Path) -> None:
        learners(tmp_path / "a", [5], train={"x": True})
        learners(tmp_path / "b", [6], seed=1, train={"x": 1})
        assert _labels(_sections(tmp_path)[0][0]) == ["train.x=true", "train.x=1"]

    def test_an_object_s_settings_are_compared_with_those_of_its_kind(self, tmp_path: Path) -> None:
        """That SquaredError has another rate than AbsoluteError goes without saying."""
        learners(tmp_path / "a", [5], fit=ABSOLUTE)
        learners(tmp_path / "b", [5], fit=SQUARED)
        assert _labels(_sections(tmp_path)[0][0]) == ["fit=AbsoluteError", "fit=SquaredError"]
        learners(tmp_path / "c", [5], fit=SQUARED | {"rate": 3.0})
        labels = _labels(_sections(tmp_path)[0][0])
        assert labels[1:] == ["fit=SquaredError, fit.rate=10", "fit=SquaredError, fit.rate=3"]

    def test_with_many_differences_only_those_from_the_baseline(self, tmp_path: Path) -> None:
        names = ("p", "q", "r", "s")
        base = dict.fromkeys(names, 0)
        learners(tmp_path / "base", [5], train=base)
        for name in names:
            learners(tmp_path / f"cell_{name}", [5], train=base | {name: 1})
        (section,), _ = _sections(tmp_path)
        assert _labels(section) == ["base", *(f"train.{name}=1" for name in names)]
        assert section.groups[2].differing["train.q"] == 1

    def test_folders_if_asked(self, tmp_path: Path) -> None:
        learners(tmp_path / "x" / "run", [5], step=_step(0.1))
        learners(tmp_path / "y" / "run", [5], step=_step(0.3))
        learners(tmp_path / "y" / "other", [5], step=_step(0.5))
        (section,), _ = _sections(tmp_path, by_folder=True)
        assert _labels(section) == ["x/run", "other", "y/run"]

    def test_settings_that_an_old_configuration_lacks(self, tmp_path: Path) -> None:
        learners(tmp_path / "old", [5])
        learners(tmp_path / "new", [6], seed=1, unroll={"reading": "figure"})
        assert len(_sections(tmp_path)[0][0].groups) == 2
        merged, _ = _sections(tmp_path, defaults={"unroll.reading": "figure"})
        assert len(merged[0].groups) == 1


class TestBaseline:
    @pytest.mark.parametrize("name", ["b", "step.alpha=0.3"])
    def test_comes_first(self, tmp_path: Path, name: str) -> None:
        learners(tmp_path / "a", [5], step=_step(0.1))
        learners(tmp_path / "b", [5], step=_step(0.3))
        (section,), _ = _sections(tmp_path, name)
        assert section.groups[0].name == "b"

    def test_unknown(self, tmp_path: Path) -> None:
        learners(tmp_path / "a", [5], step=_step(0.1))
        learners(tmp_path / "b", [5], step=_step(0.3))
        with pytest.raises(BaselineUnknown, match=r"baseline=c: expected one of step\.alpha=0\.1"):
            _sections(tmp_path, "c")


def test_domains_and_searches_are_kept_apart(tmp_path: Path) -> None:
    learners(tmp_path / "a", [5])
    learners(tmp_path / "b", [5], domain="sims.cardea.Cardea")
    search(tmp_path / "c", 3, 100)
    found, left_out = _sections(tmp_path)
    assert left_out == []
    titles = ["Bicycle: learners", "Cardea: learners", "Bicycle: searches"]
    assert [section.title for section in found] == titles
