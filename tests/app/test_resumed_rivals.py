"""Rivals and random search that go on from a state leave what they would have left without a break:
entries, policies and summary, CPU times apart."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import pytest

from edtorch.app.compose import compose
from edtorch.app.job import Job, Work
from edtorch.app.random_search import RandomPolicies, build_search
from edtorch.app.rivals import Rivals, build_rival
from edtorch.run.log import Entry
from tests.app.test_random_search import SMALL as SEARCH
from tests.app.test_sarsa import SMALL as SARSA
from tests.states import read_back

PEGASUS = (
    "experiment=bicycle_pegasus",
    "seeds=2",
    "domain.time_limit=0.5",
    "rival.gradients=3",
    "rival.scenarios=2",
    "rival.lengths=2",
    "rival.horizon=0.5",
    "eval.episodes=3",
    "compute.native=off",
)
NOWHERE = Path("nowhere")


class _Broken(Exception):
    """The process is gone."""


class _Job:
    """What work needs of a job; breaks off where the entries are such."""

    def __init__(self, ends: Callable[[list[Entry]], bool]) -> None:
        self._ends = ends
        self.entries: list[Entry] = []

    def take(self, entry: Entry) -> None:
        self.entries.append(entry)

    def pause(self) -> None:
        if self._ends(self.entries):
            raise _Broken

    def whole(self) -> None:
        self.pause()

    def keep(self) -> None:
        """The test takes the state itself."""

    @contextlib.contextmanager
    def evaluation(self) -> Iterator[None]:
        yield


def _never(entries: list[Entry]) -> bool:
    return False


def _run(work: Work, ends: Callable[[list[Entry]], bool] = _never) -> list[Entry]:
    job = _Job(ends)
    with contextlib.suppress(_Broken):
        work.run(cast(Job, job))
    return job.entries


def _without_times(figures: Any) -> Any:
    """Nested figures without those of CPU and wall."""
    if isinstance(figures, dict):
        return {k: _without_times(v) for k, v in figures.items() if "cpu_s" not in k}
    return [_without_times(v) for v in figures] if isinstance(figures, list) else figures


def _assert_the_same(found: Work, wanted: Work) -> None:
    assert _without_times(found.summary()) == _without_times(wanted.summary())
    assert (found.ticks, found.seconds, found.card) == (wanted.ticks, wanted.seconds, wanted.card)
    assert found.parameters.keys() == wanted.parameters.keys()
    for name, values in found.parameters.items():
        assert values.equal(wanted.parameters[name]), name


def _columns(work: Work, entries: list[Entry]) -> list[Any]:
    """Of ``metrics.csv``, and for TensorBoard."""
    kept = [place for place, name in enumerate(work.columns) if name != "cpu_s"]
    rows = [[row[place] for place in kept] for entry in entries for row in entry.rows]
    return [rows, [(entry.step, entry.scalars) for entry in entries]]


@pytest.mark.experiment
@pytest.mark.parametrize("arguments", [PEGASUS, SARSA], ids=["pegasus", "sarsa"])
def test_rivals_go_on_after_every_piece(arguments: tuple[str, ...]) -> None:
    def begun() -> Rivals:
        return Rivals(build_rival(compose(arguments)))

    wanted = begun()
    told = _run(wanted)
    wanted.evaluate(cast(Job, None))
    found, entries = begun(), []
    for _ in told:
        entries += _run(found, lambda own: len(own) == 1)
        state = read_back(found.state())
        assert state["pieces"] == len(entries)
        found = begun()
        found.restore(state, NOWHERE)
    assert _run(found) == []
    found.evaluate(cast(Job, None))
    assert _columns(found, entries) == _columns(wanted, told)
    assert len(told) > 1
    _assert_the_same(found, wanted)


@pytest.mark.experiment
def test_cpu_seconds_are_added_up() -> None:
    begun = Rivals(build_rival(compose(PEGASUS)))
    _run(begun, lambda own: len(own) == 2)
    before = begun.summary()["cpu_s"]
    found = Rivals(build_rival(compose(PEGASUS)))
    found.restore(read_back(begun.state()), NOWHERE)
    assert found.summary()["cpu_s"] == before > 0
    _run(found)
    assert found.summary()["cpu_s"] > before


def test_what_holds_no_state_can_only_begin_anew() -> None:
    """The rival of these tests, which is nobody's own, has no ``state``."""
    arguments = (
        *("domain=linear", "domain.state_matrix=[[1.5]]", "domain.action_matrix=[[1.0]]"),
        *("model=next_state", "reward=quadratic", "+reward.state.s0=1"),
        "rival={_target_: tests.app.constant.Constant}",
    )
    assert Rivals(build_rival(compose(arguments))).state() is None


@pytest.mark.parametrize("rounds", [1, 2])
def test_random_search_goes_on_after_every_round(rounds: int) -> None:
    def begun() -> RandomPolicies:
        return RandomPolicies(build_search(compose(SEARCH)))

    def counted(work: Work) -> int:
        state = work.state()
        assert state is not None
        (shard,) = state["shards"]
        return 0 if shard is None else shard["found"]["count"]

    wanted, first, found = begun(), begun(), begun()
    told = _run(wanted)
    entries = _run(first, lambda _: counted(first) == rounds)
    assert first.summary() == {}
    found.restore(read_back(first.state()), NOWHERE)
    entries += _run(found)
    _assert_the_same(found, wanted)
    assert [row[1:] for entry in entries for row in entry.rows][-1] == told[-1].rows[-1][1:]
    steps = [entry.scalars["search/steps"] for entry in entries]
    assert steps == sorted(set(steps))


def test_random_search_keeps_the_number_of_its_processes() -> None:
    """A machine with other cores would make other steps beside those that are needed."""
    state = RandomPolicies(build_search(compose([*SEARCH, "rival.processes=3"]))).state()
    found = RandomPolicies(build_search(compose(SEARCH)))
    found.restore(read_back(state), NOWHERE)
    assert found.state() == state
