"""What a user can get wrong: one line with key, value and what was expected, and nothing left."""

from __future__ import annotations

import re
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

Command = Callable[..., Any]
LARGEST = 2**63 - 1
THREE = "{_target_: edtorch.model.features.Identity, inputs: 3}"

# Arguments, and what the line must say.
REFUSED = [
    (["step.alpa=1"], r"step\.alpa=1: unknown key; did you mean step\.alpha\?"),
    (["+step.foo=3"], r"step\.foo=3: unknown key; step has alpha, beta"),
    (["+foo=1"], r"foo=1: unknown key"),
    (["foo=bar"], r"foo=bar: unknown key"),
    (["+domain.new=3"], r"domain\.new=3: unknown key; domain has .*goal_radius"),
    (["+domain.physics.foo=3"], r"domain\.physics\.foo=3: unknown key"),
    (["+domain.integrate.foo=3"], r"domain\.integrate\.foo=3: unknown key"),
    (["unroll.horizon=abc"], r"unroll\.horizon=abc: expected an integer"),
    (["seeds=1.5"], r"seeds=1\.5: expected an integer"),
    (["seeds=null"], r"seeds=null: expected a value"),
    (["step.alpha="], r"step\.alpha=: expected a number"),
    (["log.figures=perhaps"], r"log\.figures=perhaps: expected true or false"),
    (["reward.state=3"], r"reward\.state=3: expected a mapping"),
    (["noise.exploration=-1"], r"noise\.exploration=-1\.0: expected a finite number >= 0"),
    (["noise.exploration=inf"], r"noise\.exploration=inf: expected a finite number"),
    (
        ["noise.exploration_start=-1"],
        r"noise\.exploration_start=-1\.0: expected a finite number >=",
    ),
    (
        ["noise.exploration_start=1", "noise.exploration_decay=0"],
        r"noise\.exploration_decay=0\.0: expected a number > 0",
    ),
    (["schedule.first=0"], r"schedule\.first=0: expected 1 or more ticks"),
    (["schedule.often=-1"], r"schedule\.often=-1\.0: expected a finite number >= 0"),
    (["schedule.every=0"], r"schedule\.every=0: expected 1 or more ticks"),
    (["observation.unwrap=4"], r"observation\.unwrap=4\.0: expected a number in \[0, pi\)"),
    (["observation.delay=-1"], r"observation\.delay=-1: expected an integer >= 0"),
    (
        ["+observation.noise.lean=0.1"],
        r"observation\.noise=\{'lean': 0\.1\}: expected fit=filtered",
    ),
    (
        ["fit=filtered", "+observation.noise.foo=0.1"],
        r"observation\.noise\.foo=0\.1: expected one of lean, lean_rate",
    ),
    (
        ["fit=filtered", "+observation.noise.lean=-1"],
        r"observation\.noise\.lean=-1\.0: expected a finite number >= 0",
    ),
    (["fit=filtered", "fit.prior=0"], r"fit\.prior=0\.0: expected a number > 0"),
    (["fit=filtered", "fit.disturbance=0"], r"fit\.disturbance=0\.0: expected a number > 0"),
    (
        ["fit=filtered", "model.features=pairwise"],
        r"fit: expected model\.features=identity or affine, not Pairwise",
    ),
    (
        ["experiment=bicycle_sensors", "compute.native=on"],
        r"compute\.native=on: there is no kernel for .*; expected auto or off",
    ),
    (["unroll.start=here"], r"unroll\.start=here: expected one of state, origin"),
    (["unroll.direction=up"], r"unroll\.direction=up: expected one of gradient, regulator"),
    (
        ["unroll.direction=regulator", "step=full"],
        r"unroll\.direction=regulator: expected a cost > 0 of every action",
    ),
    (["command.variant=wild"], r"command\.variant=wild: expected one of free, ramp, safe"),
    (["command=ramp", "command.component=x"], r"command\.component=x: expected one of lean, "),
    (["command=ramp", "command.start=0"], r"command\.start=0\.0: expected a number > 0"),
    (["command=safe", "command.share=1.5"], r"command\.share=1\.5: expected a number in \(0, 1\]"),
    (["command=safe", "command.horizon=0"], r"command\.horizon=0: expected at least one step"),
    (["command=ramp", "command.final=-2"], r"command\.final=-2\.0: expected a number > 0"),
    (["+eval.domain.time_limit=-1"], r"eval\.domain\.time_limit=-1: expected"),
    (
        ["experiment=bicycle", "domain=linear"],
        r"angle_to_goal=2\.0: expected one of state_0; experiment=bicycle sets it for another"
        r" domain, experiment=regulation takes any",
    ),
    (["command=safe", "command.decay=0"], r"command\.decay=0\.0: expected a number > 0"),
    (
        ["experiment=figure1", "command=safe", "command.component=state_0"],
        r"command=safe: expected a domain whose state has limits; linear has none",
    ),
    (
        ["command=safe", "domain.start_lean=0.25"],
        r"start_lean=0\.25: expected|has lean=.* expected at most its limit",
    ),
    (["step.alpha=nan"], r"step\.alpha=nan: expected a finite number"),
    (["step.alpha=-1"], r"step\.alpha=-1\.0: expected a number >= 0"),
    (["step.beta=0"], r"step\.beta=0\.0: expected a number > 0"),
    (["fit.rate=-1"], r"fit\.rate=-1\.0: expected a number >= 0"),
    (["domain.goal_radius=0"], r"domain\.goal_radius=0\.0: expected .* above 0"),
    (["domain.noise=-1"], r"domain\.noise=-1\.0: expected .* 0 or more"),
    (["domain.noise=nan"], r"domain\.noise=nan: expected a finite number"),
    (["domain.dt=-0.1"], r"domain\.dt=-0\.1: expected .* above 0"),
    (["+domain.state_scale.lean=-3"], r"domain\.state_scale\.lean=-3\.0: expected .* above 0"),
    (["unroll.horizon=0"], r"unroll\.horizon=0: expected at least one step"),
    (["unroll.discount=0"], r"unroll\.discount=0\.0: expected a number in \(0, 1\]"),
    (["unroll.discount=1.5"], r"unroll\.discount=1\.5: expected a number in \(0, 1\]"),
    (["unroll.dt=0"], r"unroll\.dt=0\.0: expected a number > 0"),
    (["unroll.path=foo"], r"unroll\.path=foo: expected one of auto, closed_form, generic"),
    (
        ["unroll.path=closed_form", "transform=first", "noise=linear"],
        r"unroll\.path=closed_form: .*the noise is neither constant",
    ),
    (["transform=first", "noise=bayesian"], r"noise\._target_=.*fit=least_squares"),
    (["unroll.start_deviation=0.1"], r"unroll\.start_deviation=0\.1: expected 0 with this tr"),
    (
        ["unroll.start_deviation=-1"],
        r"unroll\.start_deviation=-1\.0: expected a finite number >= 0",
    ),
    (["train.seconds=null", "train.successes=null"], r"train\.seconds=null.*expected a number for"),
    (["train.seconds=0"], r"train\.seconds=0\.0: expected a number > 0"),
    (["train.episodes=0"], r"train\.episodes=0: expected an integer >= 1"),
    (["train.successes=-3"], r"train\.successes=-3: expected an integer >= 1"),
    (["seeds=0"], r"seeds=0: expected an integer >= 1"),
    (["seed=-1"], r"seed=-1: expected an integer >= 0"),
    ([f"seed={LARGEST}"], rf"seed={LARGEST}: expected seed \+ seeds <= 2\^63"),
    (["eval.episodes=-1"], r"eval\.episodes=-1: expected an integer >= 0"),
    (["log.every=0"], r"log\.every=0: expected an integer >= 1"),
    (
        ["log.checkpoint=1"],
        r"log\.checkpoint=1: was removed; .*log\.checkpoint_wall=SECONDS",
    ),
    (["log.checkpoint_wall=-1"], r"log\.checkpoint_wall=-1\.0: expected a finite number >= 0"),
    (["log.checkpoints=0"], r"log\.checkpoints=0: expected an integer >= 1"),
    (["compute.threads=0"], r"compute\.threads=0: expected an integer >= 1"),
    (["compute.native=maybe"], r"compute\.native=maybe: expected one of auto, on, off"),
    (
        ["compute.precision=mixed"],
        r"precision=mixed: was removed; everything is .* compute\.native",
    ),
    (
        ["+compute.compile=on"],
        r"compute\.compile=on: was removed; .* compute\.native=auto\|on\|off",
    ),
    (["compute.compile_after=9"], r"compile_after=9: was removed; .* compute\.threads=N"),
    (["compute.device=tpu"], r"compute\.device=tpu: expected one of cpu, cuda"),
    (["compute.device=cuda"], r"compute\.device=cuda: torch .* finds no CUDA device; expected cpu"),
    (["compute.native=on", "unroll.path=generic"], r"native=on: there is no kernel for a value of"),
    (["seeds=1000000000"], r"seeds=1000000000: takes about .* GiB of memory, .* are free"),
    (
        ["domain=foo"],
        r"domain=foo: expected one of bicycle, bicycle_change, .*cardea, .*, slalom, .*, walker$",
    ),
    (["experiment=foo"], r"experiment=foo: expected one of bicycle, .*bicycle_paper"),
    (["model.features=foo"], r"model\.features=foo: expected one of identity, affine"),
    ([f"model.features={THREE}"], r"model\.features\.inputs=3: expected 7"),
    ([f"policy.features={THREE}"], r"policy\.features\.inputs=3: expected 5"),
    (
        ["policy.features={_target_: edtorch.model.features.RandomFourier, count: 5}"],
        r"policy\.features\.lengthscale: no value given",
    ),
    (
        ["policy.features={_target_: torch.nn.Linear, in_features: 3, out_features: 3}"],
        r"policy\.features\.inputs=None: expected 5",
    ),
    (["domain._target_=sims.nope.Foo"], r"domain\._target_=sims\.nope\.Foo: expected the full na"),
    (["domain._target_=sims.bicycle.step"], r"domain\._target_=sims\.bicycle\.step: .* a class"),
    (["domain.integrate._target_=sims.nope"], r"domain\.integrate\._target_=sims\.nope: .*functi"),
    (["fit._target_=edtorch.policy.steps.PlainStep"], r"fit\._target_=.*PlainStep: .*lacks update"),
    (["+reward.state.foo=1"], r"reward\.state\.foo=1\.0: expected one of lean, lean_rate"),
    (["+reward.state.handlebar=-1"], r"reward\.state\.handlebar=-1\.0: expected .* >= 0"),
    (["reward=quadratic"], r"reward\.state=\{\}: expected a weight > 0 for one of lean"),
    (["domain=gymnasium"], r"domain\.env_id=None: expected either an id or an environment"),
    (
        ["domain=linear", "domain.state_matrix=[[1,2]]"],
        r"domain\.state_matrix=\[\[1\.0, 2\.0\]\]: exp",
    ),
    (["foo"], r"foo: expected KEY=VALUE"),
    (["=3"], r"=3: expected KEY=VALUE"),
    (["train=3"], r"train=3: expected KEY=VALUE with the name of an option"),
    (["step=null"], r"step=null: expected KEY=VALUE with the name of an option"),
    (["--config-dir", "/nope"], r"'/nope' not found"),
    (["inverse=learned"], r"inverse=learned: domain bicycle: expected a domain with a goal"),
    (["inverse=kinematic"], r"inverse=kinematic: domain bicycle: expected a domain with a goal"),
    (
        ["inverse=learned", "compute.native=on"],
        r"compute\.native=on: expected auto or off with an inverse model",
    ),
    (["inverse.gain=3"], r"inverse\.gain=3: unknown key; inverse has variant"),
    (["reward.goal=1"], r"reward\.goal=1\.0: expected a domain with a goal, not bicycle"),
    (["eval.minutes=[1,-2]"], r"eval\.minutes\[1\]=-2\.0: expected a number > 0"),
    (
        ["+eval.domain.nose=3"],
        r"eval\.domain\.nose=3: unknown key; did you mean",
    ),
    (["-m", "domain=foo,bicycle"], r"domain=foo: expected one of"),
    (["sweep.name=a"], r"sweep\.name=a: expected -m, for a sweep"),
    (["-m", "sweep.name=a,b"], r"sweep\.name=a,b: expected one value"),
    (["-m", "sweep.name=../a"], r"sweep\.name=\.\./a: expected letters, digits"),
    (["-m", "sweep.name=a", "sweep.retry=3"], r"sweep\.retry=3: expected true or false"),
    (["-m", "sweep.name=a", "domain=foo,bicycle"], r"domain=foo: expected one of"),
]


def _options_first(arguments: list[str]) -> list[str]:
    return sorted(arguments, key=lambda a: a != "-m")


def _name(value: object) -> str:
    return " ".join(value)[:60] if isinstance(value, list) else ""


@pytest.mark.parametrize(("arguments", "wanted"), REFUSED, ids=_name)
def test_train_refuses_with_one_line(
    command: Command, workplace: Path, quick: tuple[str, ...], arguments: list[str], wanted: str
) -> None:
    result = command("edtorch-train", *_options_first([*quick, *arguments]))
    assert result.status == 1
    assert result.line.startswith("edtorch-train: ")
    assert re.search(wanted, result.line), result.line
    assert list(workplace.iterdir()) == []


@pytest.mark.parametrize("place", ["/proc/x", "/dev/null/x/y", "/dev/null"])
def test_folder_that_cannot_be_written_to(
    command: Command, workplace: Path, quick: tuple[str, ...], place: str
) -> None:
    result = command("edtorch-train", *quick, f"hydra.run.dir={place}")
    assert result.status == 1
    assert f"hydra.run.dir={place}: expected a folder to write to" in result.line


def test_folder_that_holds_a_run_is_left_alone(
    command: Command, finished: Path, quick: tuple[str, ...]
) -> None:
    before = {p: p.read_bytes() for p in finished.rglob("*") if p.is_file()}
    result = command("edtorch-train", *quick, f"hydra.run.dir={finished}")
    assert result.status == 1
    assert f"hydra.run.dir={finished}: already holds a run" in result.line
    assert {p: p.read_bytes() for p in finished.rglob("*") if p.is_file()} == before


def test_only_folders_that_are_new_are_removed(
    command: Command, workplace: Path, quick: tuple[str, ...]
) -> None:
    (workplace / "mine").mkdir()
    command("edtorch-train", *quick, "seed=-1", "hydra.run.dir=mine")
    command("edtorch-train", *quick, "seed=-1", "hydra.run.dir=mine/a/b")
    assert [p.name for p in workplace.iterdir()] == ["mine"]
    assert list((workplace / "mine").iterdir()) == []


EVAL_REFUSED = [
    ([], r"run: no value given; set it with run="),
    (["run=nope"], r"run=nope: expected the folder of a run, but it does not exist"),
    (["run=empty"], r"run=empty: expected the folder of a run, but it has no config\.yaml"),
    (["run=good/config.yaml"], r"run=good/config\.yaml: .* but it is a file"),
    (["run=garbled"], r"garbled/config\.yaml: expected the configuration of a training run"),
    (["run=other"], r"other/config\.yaml: expected the configuration of a training run"),
    (["run=cut"], r"cut/policy\.safetensors: not a saved policy"),
    (["run=zeros"], r"zeros/policy\.safetensors: not a saved policy"),
    (["run=good", "policy=nope"], r"policy=nope: no such file"),
    (["run=good", "policy=good"], r"policy=good: no such file"),
    (["run=good", "policy=linear/policy.safetensors"], r"domain linear, expected domain bicycle"),
    (["run=good", "policy=one/policy.safetensors"], r"seeds \[3\], expected seeds \[3, 4\]"),
    (["run=good", "+domain.foo=1"], r"domain\.foo=1: unknown key; domain has .*goal_radius"),
    (["run=good", "+domain.noise=-1"], r"domain\.noise=-1: expected"),
    (["run=good", "domain=3"], r"domain=3: expected a mapping"),
    (["run=good", "episodes=0"], r"episodes=0: expected an integer >= 1"),
    (["run=good", "threads=0"], r"threads=0: expected an integer >= 1"),
    (["run=good", "+foo=1"], r"foo=1: unknown key"),
]


@pytest.fixture(scope="module")
def shelf(
    finished: Path, tmp_path_factory: pytest.TempPathFactory, quick_runs: Callable[..., None]
) -> Path:
    """Run folders, most of them spoilt."""
    shelf = tmp_path_factory.mktemp("shelf")
    for name in ("good", "garbled", "other", "cut", "zeros"):
        shutil.copytree(finished, shelf / name)
    (shelf / "empty").mkdir()
    (shelf / "garbled" / "config.yaml").write_text("a: [b\n")
    (shelf / "other" / "config.yaml").write_text("name: something else\n")
    policy = (finished / "policy.safetensors").read_bytes()
    (shelf / "cut" / "policy.safetensors").write_bytes(policy[:50])
    (shelf / "zeros" / "policy.safetensors").write_bytes(bytes(200))
    linear = ("domain=linear", "reward=quadratic", "+reward.state.state_0=1")
    quick_runs("seed=3", *linear, f"hydra.run.dir={shelf / 'linear'}")
    quick_runs("seed=3", "seeds=1", f"hydra.run.dir={shelf / 'one'}")
    return shelf


@pytest.mark.parametrize(("arguments", "wanted"), EVAL_REFUSED, ids=_name)
def test_eval_refuses_with_one_line(
    command: Command,
    shelf: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    wanted: str,
) -> None:
    monkeypatch.chdir(shelf)
    before = sorted(shelf.rglob("*"))
    result = command("edtorch-eval", *arguments)
    assert result.status == 1
    assert result.line.startswith("edtorch-eval: ")
    assert re.search(wanted, result.line), result.line
    assert sorted(shelf.rglob("*")) == before


@pytest.mark.long
def test_as_processes(
    start: Command, workplace: Path, quick: tuple[str, ...], patience: float
) -> None:
    """The same from outside; with debug=true there is a traceback."""
    bad = (*quick, "noise.exploration=-1")
    plain = start("edtorch-train", *bad, "hydra.run.dir=plain/run")
    debug = start("edtorch-train", *bad, "hydra.run.dir=debug/run", "debug=true")
    eval_ = start("edtorch-eval", "run=nope")
    _, err = plain.communicate(timeout=patience)
    assert plain.returncode == 1
    assert err == "edtorch-train: noise.exploration=-1.0: expected a finite number >= 0\n"
    _, err = debug.communicate(timeout=patience)
    assert debug.returncode != 0
    assert "Traceback" in err and "exploration.deviation=-1.0: expected a finite number >=" in err
    out, err = eval_.communicate(timeout=patience)
    assert eval_.returncode == 1
    assert (out, len(err.splitlines())) == ("", 1)
    assert list(workplace.iterdir()) == []
