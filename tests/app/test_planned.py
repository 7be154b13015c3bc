"""Searches between trials, from the command line and from Python."""

from __future__ import annotations

import csv
import json
import re
import sys
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch

import edtorch
from edtorch.app.build_planned import build_planned
from edtorch.app.compose import compose
from edtorch.app.errors import ConfigError
from edtorch.app.solved import Solved
from edtorch.app.work import planned
from sims.tasks.cart_pole import CartPole
from sims.tasks.stop_pendulum import HIGH
from tests.app.conftest import Result

SMALL = ("experiment=pendulum_swingup", "search.starts=4", "search.draws=20", "eval.episodes=20")


@pytest.fixture(scope="module")
def solved(tmp_path_factory: pytest.TempPathFactory) -> edtorch.Run:
    folder = tmp_path_factory.mktemp("runs") / "pendulum"
    run = edtorch.learn(preset="pendulum_swingup", seeds=2, overrides=SMALL[1:], progress=False)
    run.save(folder)
    return run


@pytest.mark.experiment
def test_a_pendulum_is_swung_up_after_seconds(solved: edtorch.Run) -> None:
    summary = solved.summary
    assert summary["never_solved"] == []
    assert summary["seconds_to_solved"]["max"] <= 8
    for rates, seconds in zip(
        summary["success_rate_after_trial"], summary["seconds_after_trial"], strict=True
    ):
        assert rates[-1] >= 0.95
        assert all(rate < 0.95 for rate in rates[:-1])
        assert len(rates) == len(seconds)
    assert summary["trials_to_solved"]["per_seed"] == [
        float(len(rates)) for rates in summary["success_rate_after_trial"]
    ]
    assert "rate of angle" in summary["told"]


@pytest.mark.experiment
def test_the_policies_succeed_in_other_episodes(solved: edtorch.Run) -> None:
    rates = solved.evaluate(40)["success_rate"]
    assert all(rate is not None and rate >= 0.9 for rate in rates)


@pytest.mark.experiment
def test_a_seed_alone_is_the_seed_of_a_population(solved: edtorch.Run) -> None:
    alone = edtorch.learn(
        preset="pendulum_swingup", seed=1, seeds=1, overrides=SMALL[1:], progress=False
    )
    for name, p in alone.policies[0].parameters.items():
        assert torch.equal(p, solved.policies[1].parameters[name])


@pytest.mark.experiment
def test_a_saved_policy_acts_as_it_did(solved: edtorch.Run) -> None:
    assert solved.folder is not None
    again = edtorch.load(solved.folder)
    assert again.evaluate(10) == solved.evaluate(10)
    first, second = again.policies[0], solved.policies[0]
    assert first.remembers
    readings = [np.array([3.1, 0.0]), np.array([2.9, -1.0])]
    for reading in readings:
        assert np.array_equal(first.predict(reading), second.predict(reading))
    late = first.predict(readings[0])
    first.reset()
    assert not np.array_equal(first.predict(readings[0]), late)


@pytest.mark.experiment
def test_the_folder_is_complete(solved: edtorch.Run) -> None:
    folder = solved.folder
    assert folder is not None
    found = {path.name for path in folder.iterdir()}
    assert {"config.yaml", "policy.safetensors", "summary.json", "metrics.csv"} <= found
    assert {"episodes.csv", "learning_curve.png", "success.webp"} <= found
    with (folder / "metrics.csv").open() as file:
        rows = list(csv.DictReader(file))
    trials = sum(len(rates) for rates in solved.summary["success_rate_after_trial"])
    assert len(rows) == trials == len(solved.episodes)
    assert all(float(row["imagined"]) <= 1 for row in rows)
    assert json.loads((folder / "summary.json").read_text())["search"] == "PlannedSearch"


@pytest.mark.long
@pytest.mark.experiment
def test_a_tip_follows_a_wave_after_seconds() -> None:
    small = ("search.starts=4", "search.keep=2", "search.draws=20", "eval.episodes=20")
    run = edtorch.learn(preset="cartpole_tracking", overrides=small, progress=False)
    assert run.summary["seconds_to_solved"]["max"] <= 14
    assert (run.evaluate(20)["tip_rms_m"][0] or 1) <= 0.03
    assert run.episodes[0]["seconds"] == pytest.approx(4)


@pytest.mark.experiment
def test_a_stationary_policy_holds_for_longer_than_its_plan(tmp_path: Path) -> None:
    run = edtorch.learn(
        preset="pendulum_swingup",
        trial=8,
        random=4,
        horizon=4,
        overrides=[*SMALL[1:], "search.policy=stationary"],
        progress=False,
    )
    assert all(each["seconds"] == pytest.approx(8) for each in run.episodes[1:])
    assert run.summary["seconds_to_solved"]["max"] <= 20
    assert run.episodes[0]["seconds"] == pytest.approx(4)
    again = edtorch.load(run.save(tmp_path / "pendulum"))
    assert again.evaluate(10) == run.evaluate(10)
    assert not again.policies[0].remembers


@pytest.mark.experiment
def test_a_pole_is_held_by_the_regulator_of_its_model() -> None:
    run = edtorch.learn(
        CartPole(time_limit=4.0),
        preset="swingup",
        target={"angle": 0.0, "position": 0.0},
        weights={"force": 0.01},
        overrides=[
            *("search=regulated", "search.held={angle: 0.0, position: 0.0}", "eval.episodes=10"),
            *(
                "train.episodes=8",
                "model.degree=1",
                "told.angles=[angle]",
            ),
        ],
        progress=False,
    )
    assert run.summary["never_solved"] == []
    assert run.evaluate(10)["failure_rate"] == [0.0]
    assert run.summary["told"].endswith("held: angle 0, position 0")


@pytest.mark.long
@pytest.mark.experiment
def test_the_preset_regulation_takes_a_model_of_a_mechanism() -> None:
    """What the target names is held: there, and not beside it, the action is small."""
    run = edtorch.learn(
        CartPole(time_limit=4.0),
        target={"angle": 0.0, "position": 0.1},
        seconds=6,
        overrides=["model=auto", "told.angles=[angle]", "eval.episodes=10"],
        progress=False,
    )
    assert run.summary["search"] == "RegulatedSearch"
    assert run.evaluate(10)["failure_rate"] == [0.0]
    at_target, beside = (run.policies[0].predict([x, 0.0, 0.0, 0.0])[0] for x in (0.1, 0.0))
    assert abs(at_target) < 0.1 * abs(beside)


@pytest.mark.parametrize(
    ("rate", "mean_return", "found", "holds"),
    [
        (None, None, (1.0, 9.0), False),
        (0.95, None, (0.95, -9.0), True),
        (0.95, None, (0.94, 9.0), False),
        (None, -200.0, (0.0, -199.0), True),
        (0.5, -200.0, (0.6, -201.0), False),
    ],
)
def test_when_a_task_counts_as_solved(
    rate: float | None, mean_return: float | None, found: tuple[float, float], holds: bool
) -> None:
    assert Solved(rate, mean_return, 100).holds(*found) is holds


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (
            ["search.starts=0"],
            "search.starts=0, straight=0, programmed=0: expected one of them above 0",
        ),
        (
            ["search.ramp=5"],
            "search.ramp=5.0: expected seconds from 0.1 to 4, the length of a plan",
        ),
        (
            ["search.horizon=2"],
            "search.horizon=2: expected the length of a trial, 4 s, with policy=timed",
        ),
        (["search.horizon=5"], "search.horizon=5.0: expected seconds from 0.1 to 4, the length of"),
        (["search.policy=linear"], "search.policy=linear: expected one of timed, stationary"),
        (
            ["search.policy=stationary", "reward.rows=[{rate: 1, reference: [1, 2]}]"],
            "search.policy=stationary: expected a reward without a reference",
        ),
        (["search.abort=-1"], "search.abort=-1.0: expected a number > 0, or null"),
        (["search.gains=best"], "search.gains=best: expected one of plain, covariance, both"),
        (["+eval.solved.return=3"], "eval.solved.return=3"),
        (["eval.solved.rate=2"], "eval.solved.rate=2: expected a share"),
        (["told.invariant=[speeed]"], "told.invariant='speeed': no component"),
        (["told.constant=[angle]"], "told.rates: 'rate' is the rate of 'angle'"),
        (["model=derivative"], "lacks structures"),
        (["fit=least_squares"], "lacks learn"),
        (["rival=lqr"], "expected one of the two"),
        (["train.successes=2"], "train.successes=2"),
        (
            ["~reward.rows", "reward=saturating", "+reward.width.angle=1"],
            "expected a quadratic reward",
        ),
        (
            ["reward.rows=[{tip: 1}]"],
            "reward.rows[0].tip=1: expected one of constant, sin angle",
        ),
        (["log.transitions=true"], "log.transitions=true"),
        (
            ["train.seconds=2", "train.episodes=null"],
            "train.seconds=2: expected at least the first trial, 4 s",
        ),
    ],
)
def test_refuses_with_one_line(
    command: Callable[..., Result], arguments: list[str], words: str
) -> None:
    result = command("edtorch-train", *SMALL, *arguments)
    assert result.status != 0
    assert words in result.line


def test_refuses_a_budget_below_the_runs_of_the_first_trial(command: Callable[..., Result]) -> None:
    result = command("edtorch-train", "experiment=walker", "train.seconds=30")
    assert result.status != 0
    assert "train.seconds=30: expected at least the first trial, 40 s" in result.line


def test_what_is_to_be_followed_is_for_planners_alone(command: Callable[..., Any]) -> None:
    wave = "{amplitude: 1, period: 1}"
    result = command(
        "edtorch-train", "reward=lifted", f"reward.rows=[{{lean: 1, reference: {wave}}}]"
    )
    assert result.status != 0
    assert "search=planned follows one" in result.line


@pytest.mark.experiment
def test_a_stop_is_found_and_planned_through(command: Callable[..., Result]) -> None:
    small = ("seeds=1", "train.episodes=1", "search.starts=3", "search.straight=0")
    result = command(
        "edtorch-train", "experiment=stop_pendulum", *small, "search.draws=10", "eval.episodes=5"
    )
    assert result.status == 0
    assert "stops: lower learned, upper learned" in result.err
    level = re.search(r"after trial 1: told.stops.upper.at=null: learned at ([\d.]+)", result.err)
    assert level is not None and float(level[1]) == pytest.approx(2 * np.pi - HIGH, abs=0.02)
    assert "told.stops.lower: no transition crosses it; not modelled yet" in result.err


@pytest.mark.experiment
def test_a_budget_that_holds_no_other_trial_is_said(
    command: Callable[..., Result], workplace: Path
) -> None:
    world = ("domain.sim.time_limit=1", "domain.sim.hold_from=0.8", "search.starts=2")
    told = (*world, "search.draws=10", "train.episodes=null", "+eval.solved.mean_return=1000")
    result = command(
        "edtorch-train",
        "experiment=pendulum_swingup",
        *("seeds=2", "train.seconds=1.7"),
        *told,
        "eval.episodes=2",
    )
    assert result.status == 0, result.err
    expected = (
        "2 of 2 seeds end with up to 0.7 of train.seconds=1.7 left: another trial may take 1 s"
    )
    assert expected in result.out + result.err


def test_a_level_that_readings_contradict_is_an_error(command: Callable[..., Result]) -> None:
    result = command(
        "edtorch-train", "experiment=stop_pendulum", "seeds=1", "told.stops.lower.at=3.3"
    )
    assert result.status == 1
    line = result.err.splitlines()[-1]
    assert re.search(r"told\.stops\.lower\.at=3\.3: \d+ of 80 readings lie beyond it, by", line)


def test_a_stop_by_an_unknown_action_is_one_line(command: Callable[..., Result]) -> None:
    stop = "told.stops={floor: {of: {angle: 1}, column: push}}"
    result = command("edtorch-train", "experiment=stop_pendulum", stop)
    assert result.status != 0
    assert "told.stops.floor.column=push: expected one of torque" in result.line


@pytest.mark.parametrize(
    ("experiment", "override", "begins"),
    [
        ("stop_pendulum", "told.stops.lower.column=torq", "told.stops.lower.column=torq: expected"),
        ("stop_pendulum", "told.stops.lower.of={angel: 1}", "told.stops.lower.of: 'angel' is no"),
        ("stop_pendulum", "told.ignored=[angel]", "told.ignored='angel': no component"),
        (
            "stop_pendulum",
            "told.stops={a: {of: {angle: 1}, column: torque, at: 1},"
            " b: {of: {angle: -1}, column: torque, at: 0}}",
            "told.stops.a.at=1, told.stops.b.at=0: no room between these stops",
        ),
        ("walker", "told.strike.counter=foo", "told.strike.counter: 'foo' is unknown"),
        (
            "walker",
            "+search.gait.joints.torso.drives.foo=1",
            "search.gait.joints.torso.drives.foo: expected names of",
        ),
        ("walker", "+search.gait.phase.foo=1", "search.gait.phase.foo: expected positions"),
        ("walker", "search.always=[{cos foo: 1}]", "search.always[0].cos foo=1.0: expected one of"),
        (
            "walker search/gait=linear",
            "+search.gait.about.phase.foo=1",
            "search.gait.about.phase.foo: expected positions",
        ),
        ("walker", "told.ignored=[]", "model=chain: 'steps' is learned and is no rate"),
    ],
)
def test_messages_begin_with_the_key_as_it_is_typed(
    experiment: str, override: str, begins: str
) -> None:
    with pytest.raises(ConfigError) as error:
        build_planned(compose([*f"experiment={experiment}".split(), override]))
    assert str(error.value).startswith(begins)


def test_stops_that_a_learner_does_not_use_are_said(caplog: pytest.LogCaptureFixture) -> None:
    stop = "told.stops={floor: {of: {lean: 1}, column: torque}}"
    for told, said in (([stop], ["told.stops: not used"]), ([], [])):
        caplog.clear()
        with caplog.at_level("WARNING", "edtorch"):
            planned(compose(["experiment=bicycle", *told]))
        assert [message[:20] for message in caplog.messages] == said


def test_a_strike_is_refused_by_searches_that_do_not_model_it() -> None:
    strike = "told.strike={height: {angle: 1.0}, swap: {}, counter: rate}"
    with pytest.raises(ConfigError, match=r"told\.strike: expected null with this search"):
        build_planned(compose(["experiment=stop_pendulum", strike]))


def test_an_unknown_jump_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"told\.strike\.jump=up: expected learned or none"):
        build_planned(compose(["experiment=walker", "+told.strike.jump=up"]))


@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("told.strike.counter=null", "told.strike.counter: no value; expected the component that"),
        ("told.strike.swap.stance_hip=swing_knee", "told.strike.swap: 'swing_knee' is given 2"),
        ("search.gait=null", "search.gait=null: expected a part"),
        ("search.optimiser=null", "search.optimiser=null: expected a part"),
        ("search.noise=-1", "search.noise=-1.0: expected a number >= 0"),
        ("search.narrow=0", "search.narrow=0.0: expected a number > 0"),
        ("search.rough.policies=0", "search.rough.policies=0: expected an integer >= 1"),
        ("search.rough.long=0", "search.rough.long=0: expected an integer >= 1"),
        ("search.rough.seconds=-1", "search.rough.seconds=-1.0: expected a number > 0"),
        ("search.fine.short_seconds=0", "search.fine.short_seconds=0.0: expected a number > 0"),
        ("search.fine.short=-1", "search.fine.short=-1: expected an integer >= 0"),
        ("search.fine.enough=7", "search.fine.enough=7.0: expected a number in [0, 1]"),
        ("search.firm.push=-1", "search.firm.push=-1.0: expected a number >= 0"),
        ("search.firm.friction=0", "search.firm.friction=0.0: expected a number > 0"),
    ],
)
def test_what_a_walk_cannot_be_searched_for_with_is_refused(argument: str, words: str) -> None:
    with pytest.raises(ConfigError, match=re.escape(words)):
        build_planned(compose(["experiment=walker", argument]))


@pytest.mark.parametrize(
    ("argument", "words"),
    [
        ("+search.held.tip=1", "search.held.tip=1.0: expected one of angle, rate"),
        ("search.random_size=2", "search.random_size=2.0: expected a number in (0, 1]"),
        ("search.random_trials=0", "search.random_trials=0: expected an integer >= 1"),
    ],
)
def test_refuses_impossible_regulators(
    command: Callable[..., Result], argument: str, words: str
) -> None:
    what = (
        *("experiment=swingup", "domain=pendulum_swingup", "+reward.state.angle=1"),
        "+reward.action.torque=1",
    )
    result = command("edtorch-train", *what, "search=regulated", argument)
    assert result.status != 0
    assert words in result.line


def test_a_regulator_needs_actions_that_cost_something(command: Callable[..., Result]) -> None:
    what = ("experiment=swingup", "domain=pendulum_swingup", "+reward.state.angle=1")
    result = command("edtorch-train", *what, "search=regulated")
    assert result.status != 0
    assert "every action has a weight > 0 (reward.action.NAME)" in result.line


def test_models_of_a_search_are_no_models_of_a_learner(command: Callable[..., Any]) -> None:
    result = command("edtorch-train", "model=implicit")
    assert result.status != 0
    assert "search=planned" in result.line


def test_paths_by_ipopt_need_casadi(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "casadi", None)
    with pytest.raises(ConfigError, match=r"search\.programmed=2: casadi cannot be imported"):
        build_planned(compose([*SMALL, "search.programmed=2"]))


def test_only_a_population_by_evolution_needs_cmaes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "cmaes", None)
    said = r"search\.optimiser: cmaes cannot be imported .*pip install 'edtorch\[population\]'"
    with pytest.raises(ConfigError, match=said):
        build_planned(compose(["experiment=walker"]))
    build_planned(compose(["experiment=walker", "search/optimiser=differences"]))


@pytest.mark.experiment
def test_a_target_out_of_reach_is_said(command: Callable[..., Result]) -> None:
    """Half a second takes the pendulum nowhere."""
    short = ("domain.sim.time_limit=0.5", "domain.sim.hold_from=0.4", "train.episodes=1")
    result = command("edtorch-train", *SMALL, *short, "seeds=1", "hydra.run.dir=out")
    told = re.search(
        r"in any of 20 imagined trials; after 0.5 s .* by angle (\S+), rate \S+$",
        result.out + result.err,
        re.MULTILINE,
    )
    assert told is not None and 1 < float(told[1]) <= 3.2


@pytest.mark.experiment
@pytest.mark.parametrize("judge", ["", "eval.success_return=-200"])
def test_a_rate_that_nothing_tells_is_said(command: Callable[..., Result], judge: str) -> None:
    """Pendulum-v1 has a return, and no success or failure."""
    few = ("search.starts=1", "search.restarts=1", "eval.episodes=2", "train.episodes=1")
    asked = ("eval.solved.rate=0.9", "eval.solved.mean_return=null", *filter(None, [judge]))
    result = command("edtorch-train", "experiment=gym_pendulum", *few, *asked, "hydra.run.dir=out")
    assert ("eval.solved.rate=0.9: nothing says whether" in result.out + result.err) != bool(judge)


@pytest.mark.experiment
def test_paths_by_ipopt_are_planned_from() -> None:
    pytest.importorskip("casadi")
    overrides = [*SMALL[1:], "search.starts=0", "search.programmed=1", "train.episodes=2"]
    run = edtorch.learn(preset="pendulum_swingup", seeds=1, overrides=overrides, progress=False)
    assert run.summary["never_solved"] == []
