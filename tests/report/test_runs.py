"""Which folders are runs, and what is said of those that cannot be used."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from edtorch.report.runs import Unusable, find, flat, load_all, load_run
from tests.report.folders import learners, search

REFERENCE = Path(__file__).parents[2] / "runs" / "reference"


def _names(paths: list[Path]) -> list[str]:
    return [path.name for path in paths]


class TestFind:
    def test_at_any_depth_jobs_by_number(self, tmp_path: Path) -> None:
        for name in ("sweep/10", "sweep/9", "sweep/deep/er/0", ".hidden/run"):
            learners(tmp_path / name, [1])
        found, left_out = find([tmp_path])
        assert _names(found) == ["9", "10", "0"]
        assert left_out == []

    def test_each_once_in_the_order_given(self, tmp_path: Path) -> None:
        a, b = learners(tmp_path / "a", [1]), learners(tmp_path / "b", [1])
        assert find([b, tmp_path, a])[0] == [b, a]

    def test_a_run_is_not_looked_into(self, tmp_path: Path) -> None:
        run = learners(tmp_path / "run", [1])
        learners(run / "inside", [1])
        assert find([tmp_path])[0] == [run]

    def test_a_folder_without_a_run_is_named(self, tmp_path: Path) -> None:
        (tmp_path / "empty").mkdir()
        found, left_out = find([tmp_path / "empty"])
        assert found == []
        assert left_out[0].path == tmp_path / "empty"
        assert "holds no run" in left_out[0].why


def _edit(name: str, change: Callable[[dict[str, Any]], object]) -> Callable[[Path], None]:
    def edit(run: Path) -> None:
        content = json.loads((run / name).read_text())
        change(content)
        (run / name).write_text(json.dumps(content))

    return edit


def _replace(name: str, text: str) -> Callable[[Path], None]:
    def replace(run: Path) -> None:
        (run / name).write_text(text)

    return replace


def _status(text: str) -> Callable[[Path], None]:
    return _replace("status.json", text)


BROKEN = {
    "running": (_status('{"status": "running", "why": null}'), r"unfinished: .* says running$"),
    "failed": (
        _status('{"status": "failed", "why": "OSError: disk full"}'),
        r"says failed: OSError: disk full$",
    ),
    "no summary": (lambda run: (run / "summary.json").unlink(), r"unfinished: .*no summary\.json"),
    "no config": (lambda run: (run / "config.yaml").unlink(), r"has no config\.yaml"),
    "half a summary": (_replace("summary.json", '{"seeds": [0, 1'), r"summary\.json is not JSON"),
    "bytes": (
        lambda run: (run / "summary.json").write_bytes(b"\xff\xfe\x00"),
        r"summary\.json is not UTF-8",
    ),
    "a summary that is a list": (_replace("summary.json", "[]"), r"expected an object"),
    "nested without end": (_replace("summary.json", "[" * 100_000), r"summary\.json is not JSON"),
    "NaN": (_replace("summary.json", '{"seeds": [NaN]}'), r"NaN is no JSON"),
    "bad status": (_status("{"), r"status\.json is not JSON"),
    "config is no YAML": (_replace("config.yaml", "a: [1"), r"config\.yaml is not YAML"),
    "config in circles": (_replace("config.yaml", "a: &a {b: *a}"), r"config\.yaml is not YAML"),
    "config is a text": (_replace("config.yaml", "hello"), r"expected a mapping"),
    "config without a domain": (_replace("config.yaml", "seed: 0"), r"domain\._target_"),
    "no seeds": (_edit("summary.json", lambda s: s.update(seeds=[])), r"seeds: expected"),
    "a seed twice": (_edit("summary.json", lambda s: s.update(seeds=[1, 1])), r"seeds: expected"),
    "no falls": (
        _edit("summary.json", lambda s: s.pop("falls_before_first_ride")),
        r"failures_before_first_success\.per_seed: expected a number per seed",
    ),
    "falls unknown": (
        _edit("summary.json", lambda s: s["falls_before_first_ride"].update(per_seed=[1, None])),
        r"failures_before_first_success\.per_seed: expected a number per seed",
    ),
    "a seed short": (
        _edit("summary.json", lambda s: s["goal_rate"].update(per_seed=[1.0])),
        r"goal_rate\.per_seed: expected 2 figures",
    ),
    "words for figures": (
        _edit("summary.json", lambda s: s["goal_rate"].update(per_seed=["a", "b"])),
        r"goal_rate\.per_seed: expected numbers or null",
    ),
    "a stranger never rode": (
        _edit("summary.json", lambda s: s.update(never_rode=[99])),
        r"never_succeeded: expected some of its seeds",
    ),
    "an evaluation a seed short": (
        _edit(
            "summary.json",
            lambda s: s.update(evaluations=[{"minutes": 1, "x": {"per_seed": [1]}}]),
        ),
        r"evaluations\[0\]\.x\.per_seed: expected 2 figures",
    ),
    "an evaluation of no time": (
        _edit("summary.json", lambda s: s.update(evaluations=[{"x": {"per_seed": [1, 2]}}])),
        r"evaluations: expected figures, each with minutes",
    ),
    "an invalid final": (
        _edit("summary.json", lambda s: s.update(final=3)),
        r"final: expected",
    ),
    "beyond all numbers": (_replace("summary.json", '{"cpu_s": 1e999}'), r"1e999 is no JSON"),
    "a whole number beyond all": (
        _replace("summary.json", f'{{"cpu_s": 1{"0" * 400}}}'),
        r"summary\.json is not JSON",
    ),
    "invalid versions": (
        _edit("summary.json", lambda s: s.update(versions=[1])),
        r"versions: expected dict or nothing",
    ),
    "something else": (
        _replace("summary.json", '{"loss": 3}'),
        r"expected the figures of learners",
    ),
}


@pytest.mark.parametrize("name", BROKEN)
def test_what_cannot_be_used_is_named_and_the_rest_is(tmp_path: Path, name: str) -> None:
    damage, why = BROKEN[name]
    good, bad = learners(tmp_path / "good", [1, 2]), learners(tmp_path / "bad", [1, 2])
    damage(bad)
    with pytest.raises(Unusable, match=why):
        load_run(bad)
    runs, left_out = load_all([tmp_path])
    assert [run.path for run in runs] == [good]
    assert [item.path for item in left_out] == [bad]


@pytest.mark.parametrize("share", [{"count": 3, "total": 2}, {"count": "3", "total": 9}])
def test_shares_that_are_none(tmp_path: Path, share: dict[str, Any]) -> None:
    run = search(tmp_path / "run", 1, 10)
    _edit("summary.json", lambda s: s.update(goal=share))(run)
    with pytest.raises(Unusable, match="goal: expected a count out of a total"):
        load_run(run)


def test_every_committed_result_is_usable() -> None:
    runs, left_out = load_all([REFERENCE])
    assert left_out == []
    assert {run.path for run in runs} == {path.parent for path in REFERENCE.rglob("summary.json")}
    assert {run.is_search for run in runs} == {True, False}


def test_flat() -> None:
    assert flat({"a": {"b": 1, "c": {}}, "d": [1]}) == {"a.b": 1, "d": [1]}
