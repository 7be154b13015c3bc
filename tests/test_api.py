"""The Python front door: learn, predict, evaluate, save, load."""

from __future__ import annotations

import csv
import json
import os
import signal
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import pytest
import torch
from gymnasium import spaces
from safetensors.torch import load_file

import edtorch
from edtorch import Run
from edtorch.run.training import Training
from sims.base import Outcome
from sims.from_gymnasium import GymnasiumSim
from sims.linear import LinearSystem
from tests.api_envs import Cart
from tests.app.conftest import call

QUICK = ("eval.episodes=2", "log.tensorboard=false", "log.figures=false")


def learn(env: Any = Cart, **more: Any) -> Run:
    settings: dict[str, Any] = {"dt": 0.1, "seconds": 6.0, "overrides": QUICK, "time_limit": 4.0}
    return edtorch.learn(env, progress=False, **(settings | more))


@pytest.fixture(scope="module")
def run() -> Run:
    return learn(seeds=2, seed=3, names=["place", "speed"])


def _same_as_command(run: Run, folder: Path) -> None:
    """Policies and the episodes of learning, digit for digit."""
    saved = load_file(folder / "policy.safetensors")
    for row, policy in enumerate(run.policies):
        for name, p in policy.parameters.items():
            assert torch.equal(p[0], saved[name][row]), name
    with (folder / "episodes.csv").open(newline="") as file:
        rows = list(csv.DictReader(file))
    assert [(int(r["seed"]), float(r["seconds"]), r["outcome"]) for r in rows] == [
        (e["seed"], pytest.approx(e["seconds"], rel=1e-5), e["outcome"]) for e in run.episodes
    ]
    summary = json.loads((folder / "summary.json").read_text())
    for name, value in run.summary.items():
        if isinstance(value, dict) and "per_seed" in value:
            assert summary[name] == value, name


@pytest.mark.oracle
def test_numbers_are_those_of_the_command_for_an_environment(tmp_path: Path) -> None:
    run = edtorch.learn(
        "Pendulum-v1",
        weights={"state_1": 2.0},
        seconds=3,
        seeds=2,
        seed=5,
        overrides=QUICK,
        progress=False,
    )
    call(
        "edtorch-train",
        "experiment=regulation",
        "domain=gymnasium",
        "domain.env_id=Pendulum-v1",
        "+reward.state={state_0: 1.0, state_1: 2.0, state_2: 0.015625}",
        "+reward.action={action_0: 0.25}",
        "train.seconds=3",
        "seeds=2",
        "seed=5",
        *QUICK,
        f"hydra.run.dir={tmp_path / 'run'}",
    )
    _same_as_command(run, tmp_path / "run")


@pytest.mark.oracle
def test_numbers_are_those_of_the_command_for_the_bicycle(tmp_path: Path) -> None:
    quick = (*QUICK, "domain.time_limit=5", "compute.native=off")
    run = edtorch.learn(
        preset="bicycle", seconds=3, seeds=2, seed=1, overrides=quick, progress=False
    )
    call(
        "edtorch-train",
        "experiment=bicycle",
        "train.seconds=3",
        "seeds=2",
        "seed=1",
        *quick,
        f"hydra.run.dir={tmp_path / 'run'}",
    )
    _same_as_command(run, tmp_path / "run")


def _loop(
    policy: edtorch.LearnedPolicy, env: gymnasium.Env[Any, Any], seed: int
) -> tuple[float, int]:
    """An episode as a user would write it: its return and its steps."""
    observation, _ = env.reset(seed=seed)
    policy.reset()
    total, steps, ended = 0.0, 0, False
    while not ended:
        observation, reward, terminated, truncated, _ = env.step(policy.predict(observation))
        total, steps, ended = total + float(reward), steps + 1, terminated or truncated
    return total, steps


def test_a_loop_of_ones_own_gives_the_episodes_of_evaluate(run: Run) -> None:
    found = run.evaluate(3)
    for row, (policy, seeds) in enumerate(zip(run.policies, run.env_seeds(3), strict=True)):
        episodes = [_loop(policy, Cart(), seed) for seed in seeds]
        assert found["return"][row] == sum(total for total, _ in episodes) / 3
        assert found["episode_seconds"][row] == pytest.approx(sum(n for _, n in episodes) * 0.1 / 3)


def test_a_loop_with_angles_gives_the_episodes_of_evaluate() -> None:
    run = edtorch.learn(
        "Pendulum-v1",
        names=["cos", "sin", "rate"],
        angles={"theta": ("cos", "sin")},
        rates={"rate": "theta"},
        seconds=2,
        overrides=(*QUICK, "observation.unwrap=1.0"),
        progress=False,
    )
    assert run.policy.remembers
    (seeds,) = run.env_seeds(1)
    total, steps = _loop(run.policy, gymnasium.make("Pendulum-v1"), seeds[0])
    assert run.evaluate(1)["return"] == [total] and steps == 200


def test_predictions_are_within_bounds_and_rows_are_alike(run: Run) -> None:
    observations = np.random.default_rng(0).normal(size=(5, 2)) * 4
    together = run.policy.predict(observations)
    assert together.shape == (5, 1) and together.dtype == np.float32
    assert np.abs(together).max() == 2.0
    alone = np.stack([run.policy.predict(row) for row in observations])
    assert np.array_equal(together, alone)


@pytest.mark.parametrize(
    ("observation", "message"),
    [
        (np.zeros(3), "expected 2 numbers"),
        (np.zeros((1, 1, 2)), r"expected \[n\] or \[k, n\]"),
        ([0.0, float("nan")], "expected finite numbers"),
        ("still", "observation='still': expected numbers"),
        ({"angle": 0.0}, "expected numbers"),
        ([[0.0, 1.0], [2.0]], "expected numbers"),
    ],
)
def test_observations_that_are_refused(run: Run, observation: Any, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        run.policy.predict(observation)


def test_figures_and_episodes(run: Run) -> None:
    found = run.evaluate(4)
    assert {"return", "success_rate", "failure_rate", "episode_seconds"} <= set(found)
    assert all(len(values) == 2 for values in found.values())
    assert found == run.evaluate(4)
    assert {e["seed"] for e in run.episodes} == {3, 4}
    ended = [e for e in run.episodes if e["outcome"] == Outcome.FAILED.name.lower()]
    assert all(e["success"] is False for e in ended)
    assert run.plot().axes
    for episodes in (0, 1.5):
        with pytest.raises(ValueError, match=f"episodes={episodes}: expected an integer"):
            run.evaluate(episodes)  # pyright: ignore[reportArgumentType]


def test_the_policy_is_the_best_in_other_episodes_than_those_reported(run: Run) -> None:
    assert run.policy in run.policies
    assert run.policy is run.policy


def test_saved_and_loaded(run: Run, tmp_path: Path) -> None:
    folder = run.save(tmp_path / "mine")
    assert json.loads((folder / "status.json").read_text())["status"] == "done"
    assert (folder / "metrics.csv").read_text().count("\n") > 2
    loaded = edtorch.load(folder, trust=["tests"])
    assert loaded.evaluate(2) == run.evaluate(2)
    assert [e["seed"] for e in loaded.episodes] == [e["seed"] for e in run.episodes]
    assert loaded.summary | {"figures_s": 0} == run.summary | {"figures_s": 0}
    again = loaded.save(tmp_path / "again")
    assert edtorch.load(again, env=Cart).seeds == [3, 4]
    with pytest.raises(ValueError, match="expected a new or empty folder"):
        run.save(folder)
    with pytest.raises(ValueError, match=r"code of 'tests' would be imported; expected trust="):
        edtorch.load(folder)
    result = call("edtorch-eval", f"run={folder}", "episodes=1", "trust=[tests]")
    assert result.status == 0, result.err


def test_lasting_is_a_success_once_an_episode_of_the_run_has_failed(
    run: Run, tmp_path: Path
) -> None:
    assert run.evaluate(1)["success_rate"] == [None, None]
    folder = run.save(tmp_path / "mine")
    path = folder / "episodes.csv"
    path.write_text(path.read_text() + "4,9,5,1,failed,-1,0\n")
    assert edtorch.load(folder, env=Cart).evaluate(1)["success_rate"] == [1, 1]
    assert call("edtorch-eval", f"run={folder}", "episodes=1", "trust=[tests]").status == 0
    (written,) = folder.glob("eval_*.json")
    assert json.loads(written.read_text())["success_rate"]["per_seed"] == [1, 1]


def test_local_objects_must_be_given_again(tmp_path: Path) -> None:
    run = learn(lambda: Cart(), save=tmp_path / "mine")
    with pytest.raises(ValueError, match=r"env: was an object, .*<lambda>; expected it"):
        edtorch.load(tmp_path / "mine")
    loaded = edtorch.load(tmp_path / "mine", env=lambda: Cart())
    assert loaded.evaluate(2) == run.evaluate(2)


def test_a_sim_is_an_environment(tmp_path: Path) -> None:
    sim = LinearSystem([[1.01]], [[0.1]], dt=0.1, time_limit=3.0)
    run = learn(sim, dt=None, time_limit=None, target={"state_0": 0.0}, save=tmp_path / "mine")
    assert run.policy.predict([0.5]).shape == (1,)
    with pytest.raises(ValueError, match="domain: was an object"):
        edtorch.load(tmp_path / "mine")
    assert edtorch.load(tmp_path / "mine", env=sim).evaluate(2) == run.evaluate(2)
    with pytest.raises(ValueError, match=r"dt=0.1: expected none with a Sim"):
        learn(sim, time_limit=None)


def test_one_environment_without_a_spec_learns_and_is_evaluated_alone() -> None:
    single, made = learn(Cart()), learn(Cart)
    assert single.evaluate(3) == made.evaluate(3)
    with pytest.raises(ValueError, match=r"seeds=2: needs copies .* give a factory"):
        learn(Cart(), seeds=2)


def test_an_environment_with_a_spec_is_rebuilt() -> None:
    env = gymnasium.make("Pendulum-v1")
    run = learn(env, dt=None, time_limit=None, seconds=1, seeds=2)
    assert len(run.policies) == 2


@pytest.mark.parametrize("trouble", ["raise", "nan", "shape"])
def test_faulty_environments_lose_episodes(trouble: str) -> None:
    run = learn(lambda: Cart(trouble=trouble))
    assert run.episodes == []
    assert run.policy.predict([0.1, 0.0]).shape == (1,)


def test_an_environment_that_never_steps_is_refused() -> None:
    with pytest.raises(ValueError, match="none of its first 10 steps succeeded: RuntimeError"):
        learn(lambda: Cart(trouble="raise", first=1))


def test_an_interruption_returns_what_there_is(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    advance, handler = Training.advance, signal.getsignal(signal.SIGINT)

    def interrupted(training: Training, ticks: int) -> int:
        if training.clock >= 64:
            os.kill(os.getpid(), signal.SIGINT)
        return advance(training, ticks)

    with monkeypatch.context() as patch:
        patch.setattr(Training, "advance", interrupted)
        run = learn(seconds=1000.0)
    assert run.interrupted and run.policy.predict([0.0, 0.0]).shape == (1,)
    assert signal.getsignal(signal.SIGINT) is handler
    assert len(run.evaluate(2)["return"]) == 1
    folder = run.save(tmp_path / "mine")
    assert json.loads((folder / "status.json").read_text())["status"] == "interrupted"
    assert edtorch.load(folder, env=Cart).interrupted


def test_the_first_line_tells_the_budget(capsys: pytest.CaptureFixture[str]) -> None:
    edtorch.learn(Cart, dt=0.1, time_limit=4.0, overrides=(*QUICK, "train.seconds=2"))
    first = capsys.readouterr().out.splitlines()[0]
    assert first == (
        "Cart, 1 learners: preset regulation, at most 2 simulated s each (the budget of the preset)"
    )


class Discrete(Cart):
    def __init__(self) -> None:
        super().__init__()
        self.action_space = spaces.Discrete(2)


class Nested(Cart):
    def __init__(self) -> None:
        super().__init__()
        self.observation_space = spaces.Dict({"a": spaces.Box(-1, 1, (2,))})


class Camera(Cart):
    def __init__(self) -> None:
        super().__init__()
        self.observation_space = spaces.Box(0, 255, (8, 8, 3), np.uint8)


class Unbounded(Cart):
    def __init__(self) -> None:
        super().__init__()
        self.action_space = spaces.Box(-np.inf, np.inf, (1,), np.float32)


def _broken() -> Cart:
    raise FileNotFoundError("no model.xml")


@pytest.mark.parametrize(
    ("env", "arguments", "message"),
    [
        (Discrete, {}, "discrete actions are not supported"),
        (Nested, {}, "supported are vectors; wrap it in gymnasium.wrappers.FlattenObservation"),
        (Camera, {}, "images are not supported; wrap it in gymnasium.wrappers.TransformObs"),
        (Unbounded, {}, "scale=None: expected a scale for action_0, which has no bounds"),
        (Cart, {"dt": None}, "dt=None: expected the seconds per step, Cart does not say them"),
        (Cart, {"names": ["place"]}, "names=['place']: expected 2 different ones"),
        (Cart, {"target": {"height": 1.0}}, "target.height=1.0: expected one of state_0"),
        (Cart, {"target": {"state_0": "up"}}, "target.state_0=up: expected a finite number"),
        (Cart, {"weights": {"x": 1.0}}, "weights.x=1.0: expected one of state_0"),
        (Cart, {"seconds": -1}, "seconds=-1"),
        (Cart, {"preset": "ballet"}, "preset=ballet: expected one of"),
        (Cart, {"overrides": ("unroll.horizont=3",)}, "unroll.horizont"),
        (Cart, {"reward": lambda s, a: s}, "reward: gives (3, 2) for states of shape (3, 2)"),
        (Cart, {"reward": lambda s, a: 1.0}, "reward: gives float"),
        (Cart, {"reward": abs}, "reward: TypeError"),
        (Cart, {"rates": {"state_1": "x"}}, "rates.state_1=x: 'x' is not one of"),
        (_broken, {}, "env=_broken: the factory raised FileNotFoundError: no model.xml"),
        (dict, {}, "expected a factory of gymnasium.Env, it gave a dict"),
        (3, {}, "env=3: expected an environment, or a factory"),
        ("NoSuchThing-v1", {}, "expected a Gymnasium environment"),
        ("Pendulum-v1", {"target": {"state_0": 2.0}}, "expected a value within the bounds"),
    ],
)
def test_refusals_are_one_line(env: Any, arguments: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as refusal:
        learn(env, **arguments)
    assert message in str(refusal.value)
    assert "\n" not in str(refusal.value)


def test_a_unbounded_action_with_a_scale_learns() -> None:
    assert learn(Unbounded, scale={"action_0": 2.0}).policy.predict([0.0, 0.0]).shape == (1,)


def test_what_states_its_step() -> None:
    assert GymnasiumSim("Pendulum-v1").spec.dt == 0.05


def test_without_an_environment_the_preset_must_name_one() -> None:
    with pytest.raises(ValueError, match="env=None: expected an environment, which preset=regul"):
        edtorch.learn(None, seconds=2)


def test_a_budget_below_a_tick_is_refused() -> None:
    with pytest.raises(ValueError, match=r"seconds=0\.001: expected at least one tick"):
        edtorch.learn(preset="bicycle", seconds=0.001)


def test_a_pair_that_is_no_cosine_and_sine_is_refused() -> None:
    """An angle of position and speed would mean nothing."""
    with pytest.raises(ValueError, match=r"angles=\(angle, rate\): expected cosine and sine"):
        edtorch.learn(
            "InvertedPendulum-v5",
            names=["position", "angle", "speed", "rate"],
            angles={"wrong": ("angle", "rate")},
            seconds=1,
            progress=False,
        )
