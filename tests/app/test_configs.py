"""Everything under conf/: it composes, it builds, and its keys are those of the constructors."""

from __future__ import annotations

import inspect
from dataclasses import fields, replace
from typing import Any

import pytest
import torch
import yaml

from edtorch.app import groups
from edtorch.app.build import Setup, build
from edtorch.app.build_planned import build_planned, is_planned
from edtorch.app.compose import CONF as ROOT
from edtorch.app.compose import compose
from edtorch.app.domain import build_sim
from edtorch.app.random_search import build_search
from edtorch.app.rivals import build_rival
from edtorch.app.schema import defaults
from edtorch.app.settings import Settings, plain
from edtorch.inverse.policy import InversePolicy
from edtorch.report.runs import flat
from edtorch.rivals.random_search import search
from edtorch.run.episodes import Budget
from edtorch.run.evaluation import evaluate
from edtorch.run.training import Training
from edtorch.value.unroll import Horizon
from sims.base import Outcome
from sims.bicycle import Bicycle
from sims.bicycle.slalom import Slalom

EXPERIMENTS = sorted(path.stem for path in (ROOT / "experiment").glob("*.yaml"))
RIVALS = [
    name
    for name in EXPERIMENTS
    if "override /rival" in (ROOT / "experiment" / f"{name}.yaml").read_text()
]
SEARCHES = ("bicycle_random_search", "footnote1")
PLANNED = [
    name
    for name in EXPERIMENTS
    if name == "walker"
    or any(
        word in name
        for word in ("swingup", "tracking", "pendulum", "pendubot", "unicycle", "in_trials")
    )
]
# What makes or needs files is run in test_offline.
LEARNING = [
    name
    for name in EXPERIMENTS
    if name not in ("bicycle_random_falls", "bicycle_offline", *RIVALS, *PLANNED)
]
# The bicycle in other worlds: among the long tests.
VARIANTS = (
    "bicycle_change",
    "bicycle_off_balance",
    "bicycle_spread",
    "bicycle_wind",
    "bicycle_noise3",
)
# What makes a rival's piece of work a short one.
SHORT = {
    "bicycle_adaptive_lqr": ("rival.piece=0.2",),
    "bicycle_fitted_q": ("rival.episodes=3", "rival.iterations=1", "rival.trees=2"),
    "bicycle_lspi": ("rival.episodes=[5]",),
    "bicycle_pegasus": ("rival.scenarios=2", "rival.lengths=2", "rival.horizon=1"),
    "bicycle_ppo": ("rival.steps=64", "rival.rollout=8", "rival.hidden=[8]"),
    "bicycle_reinforce": ("rival.batch=3", "rival.updates=2", "rival.horizon=1"),
    "bicycle_sac": ("rival.steps=110", "rival.hidden=[8]"),
    "bicycle_sarsa": ("rival.every=2.0",),
    "cardea_ppo": ("rival.steps=64", "rival.rollout=8", "rival.hidden=[8]"),
    "cardea_sac": ("rival.steps=110", "rival.hidden=[8]"),
}
OPTIONS = sorted(
    (path.parent.name, path.stem)
    for path in ROOT.glob("*/*.yaml")
    if path.parent.name not in ("experiment", "evaluate")
)
CARDEA = ["domain=cardea", "reward=goal", "fit=ridge"]
SEARCH = ["experiment=pendulum_swingup"]
# What an option needs beside it to be built.
BESIDE = {
    **{("model", name): SEARCH for name in ("auto", "chain", "implicit", "monomials", "products")},
    ("fit", "paths"): SEARCH,
    ("reward", "lifted"): SEARCH,
    ("search", "planned"): SEARCH,
    ("search", "population"): ["experiment=walker"],
    **{
        ("search", name): [
            *("experiment=swingup", "domain=pendulum_swingup", "+reward.state.angle=1"),
            "+reward.action.torque=1",
        ]
        for name in ("gradient", "regulated")
    },
    ("domain", "cardea"): ["reward=quadratic", "+reward.state.tilt=1"],
    ("inverse", "learned"): CARDEA,
    ("inverse", "kinematic"): CARDEA,
    ("reward", "goal"): ["domain=cardea"],
    **{
        ("domain", name): ["reward=quadratic", "+reward.state.angle=1"]
        for name in ("cartpole_swingup", "cartpole_tracking", "pendulum_swingup", "stop_pendulum")
    },
    **{
        ("domain", name): ["reward=quadratic", "+reward.state.angle_1=1"]
        for name in ("pendubot", "double_pendulum", "cart_double_pendulum")
    },
    ("domain", "unicycle"): ["reward=quadratic", "+reward.state.roll=1"],
    ("domain", "walker"): ["reward=quadratic", "+reward.state.torso=1"],
    ("domain", "linear"): ["reward=quadratic", "+reward.state.state_0=1"],
    ("domain", "gymnasium"): [
        "domain.env_id=Pendulum-v1",
        "reward=quadratic",
        "+reward.state.state_0=1",
    ],
    ("reward", "quadratic"): ["+reward.state.lean=1"],
    ("reward", "saturating"): ["reward.width.lean=0.1"],
    ("reward", "nearness"): ["reward.rows=[{lean: 10}]"],
    ("fit", "local"): ["experiment=regulation"],
    ("offline", "recorded"): ["offline.data=transitions.npz", "train.seconds=1"],
}


def _compose(*overrides: str) -> Settings:
    return compose(overrides)


@pytest.mark.experiment
@pytest.mark.parametrize(
    "name",
    [pytest.param(name, marks=pytest.mark.long) if name in VARIANTS else name for name in LEARNING],
)
def test_experiment_runs_three_episodes(name: str) -> None:
    if name.startswith("cardea"):
        pytest.importorskip("pybullet", reason="the extra [cardea] is not installed")
    limits = ("seeds=2", "train.episodes=3", "train.successes=null", "train.seconds=200")
    if not name.startswith("cardea"):
        # For those who never fall.
        world = "domain.sim" if name in ("bicycle_sensors", "walker_paper") else "domain"
        limits += (f"{world}.time_limit=2",)
    setup = build(_compose(f"experiment={name}", *limits))
    training = Training(setup.learner, setup.world, setup.seeds, setup.budget)
    training.advance(10**6)
    assert training.done
    assert [e.number for e in training.episodes if e.row == 0] == [0, 1, 2]
    assert [e.number for e in training.episodes if e.row == 1] == [0, 1, 2]
    assert bool(training.finite.all())
    assert all(bool(p.abs().max() > 0) for p in training.learners.policy.values())


@pytest.mark.experiment
@pytest.mark.parametrize("name", [name for name in RIVALS if name not in SEARCHES])
def test_experiment_of_a_rival_works_a_piece(name: str) -> None:
    if name.startswith("cardea"):
        pytest.importorskip("pybullet", reason="the extra [cardea] is not installed")
    short = ("seeds=2", "compute.native=off", *SHORT.get(name, ()))
    setup = build_rival(_compose(f"experiment={name}", *short))
    begun = setup.rival.begin(setup.problem)
    begun.advance([True, True], lambda: None)
    known = name == "bicycle_lqr"
    assert [account.seconds == 0 for account in begun.accounts] == [known, known]
    assert all(bool(p.isfinite().all()) for p in begun.parameters.values())


@pytest.mark.parametrize("name", SEARCHES)
def test_experiment_of_a_random_search(name: str) -> None:
    setup = build_search(_compose(f"experiment={name}", "rival.policies=5"))
    found = search(
        replace(setup.settings, slots=8, look=64, runs=2),
        setup.world,
        setup.policy,
        seed=setup.seed,
        processes=1,
        native="off",
        report=lambda *told: None,
    )
    assert len(found.policy) == 5 <= found.episodes


@pytest.mark.parametrize(("group", "option"), OPTIONS, ids=str)
def test_option_builds(group: str, option: str) -> None:
    if (group, option) == ("domain", "cardea") or "domain=cardea" in BESIDE.get(
        (group, option), []
    ):
        pytest.importorskip("pybullet", reason="the extra [cardea] is not installed")
    config = _compose(f"{group}={option}", "seeds=2", *BESIDE.get((group, option), []))
    if is_planned(config):
        assert build_planned(config).seeds == [0, 1]
        return
    setup = build(config)
    training = Training(setup.learner, setup.world, setup.seeds, setup.budget)
    assert training.advance(3) == 3
    assert bool(training.finite.all())


@pytest.mark.parametrize("policy", sorted(p.stem for p in (ROOT / "search/policy").iterdir()))
def test_every_policy_of_the_gradient_search_builds(policy: str) -> None:
    """By the improver that takes any; what is written in the files is what is so by default."""
    search = ("search=gradient", f"search/policy={policy}", "search/improver=adam")
    config = _compose("experiment=pendulum_swingup", *search, "search.odd=true")
    setup = build_planned(config)
    assert all(len(p) == config.seeds for p in setup.initial.values())
    for name in ("policy", "improver"):
        node = config.search[name]
        known = defaults({f"search.{name}._target_": node["_target_"]})
        for key in node.keys() - {"_target_"}:
            assert plain(node[key]) == known[f"search.{name}.{key}"]


PARTS = sorted(
    (part, path.stem) for part in ("gait", "optimiser") for path in ROOT.glob(f"search/{part}/*")
)


@pytest.mark.parametrize("part, option", PARTS)
def test_every_part_of_the_population_builds(part: str, option: str) -> None:
    """What is written in the files is what is so by default."""
    config = _compose("experiment=walker", f"search/{part}={option}")
    assert all(len(p) == config.seeds for p in build_planned(config).initial.values())
    written = flat({"search": {part: plain(config.search[part])}})
    known = defaults({key: value for key, value in written.items() if key.endswith("_target_")})
    assert all(known[key] == written[key] for key in known.keys() & written.keys())


def test_every_option_is_known_here() -> None:
    """Groups in ``conf`` and in the schema are the same."""
    assert {group for group, _ in OPTIONS} == {*groups.GROUPS}


# Their files state choices, not defaults.
CHOICES = {"reward", "train"}
VARIANTS = {
    f"bicycle_{name}"
    for name in ("change", "gyroscopic", "off_balance", "sensors", "spread", "wind")
} | {"cartpole_tracking"}


@pytest.mark.parametrize(("group", "option"), OPTIONS, ids=str)
def test_the_files_repeat_the_defaults_of_the_constructors(group: str, option: str) -> None:
    if group in CHOICES or option in VARIANTS:
        return
    if option == "cardea":
        pytest.importorskip("pybullet", reason="the extra [cardea] is not installed")
    text = (ROOT / group / f"{option}.yaml").read_text(encoding="utf-8")
    written = flat({group: yaml.safe_load(text) or {}})
    known = defaults(written)
    for key, value in written.items():
        if key in known and value != "???" and not key.endswith("_target_"):
            assert float(value) == known[key] if isinstance(known[key], float) else True, key
            assert value == known[key] or isinstance(known[key], float), key


def test_the_bicycle_of_the_file_is_that_of_the_constructor() -> None:
    assert build(_compose("domain=bicycle")).world.sim == Bicycle()
    assert build_sim(_compose("domain=slalom").domain) == Slalom()


# What the fields of a group without a class are handed to, and what else that gets.
DIRECT = [
    (groups.TrainGroup, Budget, set[str]()),
    (groups.UnrollGroup, Horizon, {"steps", "unit"}),
    (groups.InverseGroup, InversePolicy, {"layout"}),
]


@pytest.mark.parametrize(("group", "constructor", "handed_in"), DIRECT)
def test_fields_are_those_of_the_constructor(
    group: type, constructor: Any, handed_in: set[str]
) -> None:
    accepted = set(inspect.signature(constructor).parameters) - handed_in
    assert accepted <= {f.name for f in fields(group)}


def _first_falls(setup: Setup) -> list[float]:
    zero = setup.learner.initial(setup.seeds).policy
    evaluated = evaluate(setup.learner.policy, zero, setup.world, setup.seeds, 5)
    assert all(e.outcome is Outcome.FAILED for own in evaluated for e in own)
    return [e.seconds for own in evaluated for e in own]


def test_settings_of_the_domain_reach_the_world() -> None:
    calm = build(_compose("seeds=2", "domain.noise=0.001"))
    rough = build(_compose("seeds=2", "domain.noise=0.05"))
    assert min(_first_falls(calm)) > max(_first_falls(rough))
    scaled = build(_compose("+domain.state_scale.lean=0.5"))
    assert [q.scale for q in scaled.world.spec.state if q.name == "lean"] == [0.5]
    euler = build(_compose("domain.integrate._target_=sims.bicycle.explicit_euler"))
    assert _first_falls(euler) != _first_falls(build(_compose()))
    quick = build(_compose("domain.physics.v=5.0"))
    assert isinstance(quick.world.sim, Bicycle)
    assert quick.world.sim.physics.v == 5.0


def test_the_paper_s_settings() -> None:
    """bicycle_paper is section 4 of the paper."""
    config = _compose("experiment=bicycle_paper")
    assert config.fit._target_ == "edtorch.model.fit.AbsoluteError"
    assert (config.fit.rate, config.step.alpha, config.step.beta) == (1.0, 0.1, 1.0)
    assert (config.exploration.deviation, config.unroll.horizon, config.unroll.dt) == (
        0.05,
        30,
        0.051,
    )
    assert dict(config.reward.state) == {"angle_to_goal": 1.0, "lean": 10.0}


def test_the_random_features_are_those_of_the_seed() -> None:
    random = (
        "policy.features={_target_: edtorch.model.features.RandomFourier, count: 4, lengthscale: 1}"
    )
    policies = [build(_compose(random, f"seed={s}")).learner.policy for s in (1, 1, 2)]
    buffers = [
        dict(p.named_buffers())["features.frequency"]
        for p in policies
        if isinstance(p, torch.nn.Module)
    ]
    assert buffers[0].equal(buffers[1])
    assert not buffers[0].equal(buffers[2])
