"""The Python front door: learn a policy for an environment, and load what a run has saved.

``learn`` composes the configuration that ``edtorch-train`` would and runs the same job, so that the
numbers are the same, digit for digit.
"""

from __future__ import annotations

import contextlib
import logging
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import Any, Literal

import gymnasium
import numpy as np
import torch
from rich.console import Console
from torch import nn

from edtorch.app.arguments import (
    WorldArguments,
    budget_overrides,
    check_kinds,
    domain_settings,
    in_arguments,
    longest,
    reward_of,
    with_prices,
)
from edtorch.app.build_planned import is_planned
from edtorch.app.compose import compose
from edtorch.app.compute import evaluation_mode
from edtorch.app.domain import build_sim
from edtorch.app.errors import EXPECTED, ConfigError, one_line
from edtorch.app.given import Given, with_objects
from edtorch.app.job import Job, Work
from edtorch.app.learned import Run, copied, new_folder, read_records, read_summary
from edtorch.app.outputs import InMemory, write_run
from edtorch.app.policies import frozen_world, stored_policies
from edtorch.app.references import following_reward
from edtorch.app.resume import changed, resume_with
from edtorch.app.rundir import POLICY, SUMMARY, as_settings, read_config
from edtorch.app.settings import Settings
from edtorch.app.signals import Stop
from edtorch.app.trust import check_trust
from edtorch.app.work import planned
from edtorch.run.log import ConsoleSink, StderrHandler
from sims.base import Sim

logger = logging.getLogger("edtorch")

GRADIENT = (
    "unroll.direction=gradient",
    "step=decaying",
    "step.alpha=10",
    "step.beta=0.01",
    "step.decay=5",
)
"""What the preset ``regulation`` does otherwise with a reward or a policy of one's own."""

Env = str | gymnasium.Env[Any, Any] | Callable[[], gymnasium.Env[Any, Any]] | Sim
RewardFunction = Callable[[torch.Tensor, torch.Tensor], torch.Tensor]
Reference = Callable[[float], float] | Sequence[float] | np.ndarray | torch.Tensor


def learn(
    env: Env | None = None,
    *,
    preset: str = "regulation",
    target: Mapping[str, float] | None = None,
    weights: Mapping[str, float] | None = None,
    reward: RewardFunction | None = None,
    policy: nn.Module | None = None,
    seconds: float | None = None,
    episodes: int | None = None,
    seeds: int = 1,
    seed: int = 0,
    dt: float | None = None,
    names: Sequence[str] | None = None,
    action_names: Sequence[str] | None = None,
    angles: Any = None,
    rates: Mapping[str, str] | None = None,
    overrides: Sequence[str] = (),
    progress: bool = True,
    save: str | Path | None = None,
    time_limit: float | None = None,
    scale: Mapping[str, float] | None = None,
    termination: Literal["failure", "success"] | None = None,
    trial: float | None = None,
    random: float | None = None,
    horizon: float | None = None,
    reference: Mapping[str, Reference] | None = None,
) -> Run:
    """Let ``seeds`` learners, with the seeds ``seed``, ``seed + 1``, ..., learn to control ``env``.

    Arguments:

    - ``env``: the id of a Gymnasium environment (also ``"module:Id"``), a factory of environments
      without arguments, an environment, or a ``sims.base.Sim``.  None where the preset names a
      domain.
    - ``preset``: an experiment by name (``conf/experiment``); ``overrides``: further settings as on
      the command line, ``"unroll.horizon=20"``.
    - ``target``: wanted values by component, in physical units; other components have weight 0,
      but for rates, which are damped with ``0.01 / scale**2``, as actions are by presets that
      plan.  Without a target all components are wanted at zero.  ``weights``: of squared
      deviations by component, and of squared actions.
    - ``reward``: instead of both, a function or module of torch tensors in physical units: states
      ``[*batch, n]`` and actions ``[*batch, m]`` to ``[*batch]``.  A difference of angles is for
      it to wrap, or for ``angles`` to have wrap elsewhere.
    - ``policy``: a module from scaled states to scaled actions instead of a linear policy.  With
      it, or with a reward, the preset ``regulation`` climbs the value's gradient by steps that
      decay: Riccati's direction is for linear policies and quadratic rewards.
    - ``seconds``, ``episodes``: the budget of each learner, simulated; the preset's if neither is
      given.
    - ``dt``: seconds per step, where the environment does not state them; ``time_limit``: of an
      episode, s; ``names``, ``action_names``: of the components; ``scale``: typical sizes by name.
    - ``angles``: names of components in radians, or by name ``"deg"`` or the names of a pair
      (cosine, sine), which becomes one angle.  It lies within half a turn of its target, else of 0,
      or of ``around`` in ``{"name": {"unit": "rad", "around": 3.14}}``.
    - ``rates``: by name of a rate the component that it is the rate of.
    - ``termination``: what it means that the environment terminates an episode, where neither its
      ``info["is_success"]`` nor its registered threshold tells: by default a failure.
    - ``trial``: for presets that learn between trials (``swingup``, ``tracking``), seconds of one:
      ``time_limit``; ``random``: of the first one, whose actions are random; ``horizon``: of a
      plan.
    - ``reference``: values to follow by component, each a function of the seconds since the start
      of an episode, or values, one a tick, in physical units (``tracking``).
    - ``progress``: whether to print on the way; ``save``: a folder for ``Run.save``.

    Ctrl-C ends learning after the tick; the run then holds what there is.  Raises ValueError with
    one line for whatever is wrong with the arguments.
    """
    stop, began = Stop(), time.monotonic()
    console = Console(quiet=not progress)
    own = reward is not None or policy is not None
    with _refusing():
        limit = longest(time_limit, trial)
        world = WorldArguments(dt, limit, names, action_names, angles, rates, scale, termination)
        if env is None and preset == "regulation" and not _names_domain(overrides):
            raise ConfigError(
                "env=None: expected an environment, which preset=regulation does not name"
            )
        searched = {"random": random, "horizon": horizon}
        told = dict(target=target, weights=weights, reference=reference, overrides=overrides)
        check_kinds(told | searched | world.kinds())
        config = compose(
            [
                f"experiment={preset}",
                f"seed={seed}",
                f"seeds={seeds}",
                f"log.progress={str(progress).lower()}",
                *budget_overrides(seconds, episodes),
                *(f"search.{k}={v}" for k, v in searched.items() if v is not None),
                *(GRADIENT if own and preset == "regulation" else ()),
                *overrides,
            ]
        )
        config = _with_world(config, env, world, target)
        config = _with_reward(config, env, target, weights, reward, reference)
        if policy is not None:
            config = with_objects(config, {"policy": {"given": Given(policy)}})
        _check_copies(config, seeds)
        _, begin = planned(config)
        if save is not None:
            new_folder(Path(save))
        memory = InMemory()
        with _threads(config.compute.threads), stop.listening(ending=False), _messages(progress):
            work = begin(None)
            console.print(_first_line(work, preset, seconds, episodes), soft_wrap=True)
            job = Job(work, config, stop, console, memory.keep, lambda work: None)
            job.sinks.append(memory)
            if config.log.progress:
                job.sinks.append(ConsoleSink(console))
            job.timing.startup_s = time.monotonic() - began
            interrupted = _interrupted(job)
        run = Run(
            seeds=work.card.seeds,
            actor=work.actor,
            parameters=work.parameters,
            observer=work.observer,
            world=work.world,
            records=work.episodes,
            summary=job.summary(),
            write=lambda folder: write_run(job, memory, folder, interrupted=interrupted),
            interrupted=interrupted,
            native=evaluation_mode(config),
            go_on=partial(_resumed, config),
        )
    if save is not None:
        run.save(save)
    return run


def load(
    folder: str | Path,
    *,
    env: Env | None = None,
    reward: RewardFunction | None = None,
    policy: nn.Module | None = None,
    trust: bool | Sequence[str] = False,
) -> Run:
    """The run in a folder that ``Run.save`` or ``edtorch-train`` has written.

    Only numbers, text and settings are read, nothing is unpickled.  ``env``, ``reward`` and
    ``policy`` (untrained, for its shape) replace those of the run; they
    must be given where the run was given objects that have no importable
    name (lambdas, classes of a script).  ``trust``: names of packages other than edtorch's that
    the settings may import code from, True for any.  Raises ValueError with one line.
    """
    path = Path(folder)
    with _refusing():
        content = Settings(read_config(path))
        if env is not None:
            content = _replaced_env(content, env)
        if reward is not None:
            content = with_objects(content, {"reward": {"given": Given(reward)}})
        if policy is not None:
            content = with_objects(content, {"policy": {"given": Given(policy)}})
        # Before the settings are checked, which imports the classes that they name.
        check_trust(content, trust)
        return _loaded(path, as_settings(path, content))


def _loaded(path: Path, config: Settings) -> Run:
    """The run in a folder; config: its own, in which objects may stand."""
    world = frozen_world(config, path / POLICY)
    stored = stored_policies(config, path / POLICY, world)
    summary = read_summary(path / SUMMARY)
    run = Run(
        seeds=stored.seeds,
        actor=stored.actor,
        parameters=stored.parameters,
        observer=stored.observer,
        world=lambda: frozen_world(config, path / POLICY),
        records=read_records(path / "episodes.csv", stored.seeds),
        summary=summary,
        write=copied(path),
        interrupted=not summary,
        native=evaluation_mode(config),
        go_on=partial(_resumed, config),
    )
    run.folder = path
    return run


def _resumed(config: Settings, path: Path, changes: Mapping[str, Any], progress: bool) -> Run:
    """See ``Run.resume``."""
    stop, began, console = Stop(), time.monotonic(), Console(quiet=not progress)
    with _refusing():
        config = changed(path, config, {**changes, "log.progress": progress})
        with (
            _threads(config.compute.threads),
            stop.listening(ending=False),
            contextlib.suppress(KeyboardInterrupt),
        ):
            resume_with(path, config, stop, began, console)
        return _loaded(path, config)


@contextlib.contextmanager
def _refusing() -> Iterator[None]:
    """What a caller can cause leaves as a ValueError of one line, in words of the arguments."""
    try:
        yield
    except EXPECTED as error:
        raise ValueError(in_arguments(one_line(error))) from None


@contextlib.contextmanager
def _threads(count: int) -> Iterator[None]:
    """Meanwhile torch uses so many threads, as ``edtorch-train`` does: digits depend on it."""
    before = torch.get_num_threads()
    torch.set_num_threads(count)
    try:
        yield
    finally:
        torch.set_num_threads(before)


@contextlib.contextmanager
def _messages(progress: bool) -> Iterator[None]:
    """Messages go to stderr, without progress only warnings."""
    handler, before = StderrHandler(), (logger.level, logger.propagate)
    handler.setLevel(logging.INFO if progress else logging.WARNING)
    logger.setLevel(logging.INFO)
    logger.propagate = False
    logger.addHandler(handler)
    try:
        yield
    finally:
        logger.removeHandler(handler)
        logger.setLevel(before[0])
        logger.propagate = before[1]


def _names_domain(overrides: Sequence[str]) -> bool:
    return any(each.lstrip("+").startswith("domain") for each in overrides)


def _first_line(work: Work, preset: str, seconds: float | None, episodes: int | None) -> str:
    line = f"{work.title}: preset {preset}"
    if work.budget is None:
        return line
    chosen = "" if seconds is not None or episodes is not None else " (the budget of the preset)"
    budget = work.budget.in_words(work.world().spec.words.successes)
    return f"{line}, at most {budget} each{chosen}"


def _interrupted(job: Job) -> bool:
    """Learn and evaluate; returns whether that was interrupted."""
    try:
        job.run()
        job.evaluate()
    except KeyboardInterrupt:
        return True
    finally:
        for sink in job.sinks:
            sink.close()
    return False


def _with_world(
    config: Settings, env: Env | None, world: WorldArguments, target: Mapping[str, float] | None
) -> Settings:
    if env is not None:
        return with_objects(config, {"domain": domain_settings(env, world, target or {})})
    told = world.given()
    for name in set(told) - {"dt", "time_limit"}:
        raise ConfigError(f"{name}={told[name]}: expected none without env")
    if not told:
        return config
    domain = config.domain
    # What wraps another simulator (sims.sensing.Sensed) has the times of that one.
    if "sim" in domain and "time_limit" not in domain:
        told = {"sim": {**domain.sim, **told}}
    return with_objects(config, {"domain": {**domain, **told}})


def _with_reward(
    config: Settings,
    env: Env | None,
    target: Mapping[str, float] | None,
    weights: Mapping[str, float] | None,
    reward: RewardFunction | None,
    reference: Mapping[str, Reference] | None,
) -> Settings:
    if reward is not None:
        for name, value in (("target", target), ("weights", weights), ("reference", reference)):
            if value is not None:
                raise ConfigError(f"{name}={value}: expected none with a reward of your own")
        return with_objects(config, {"reward": {"given": Given(reward)}})
    if reference is not None:
        node = following_reward(build_sim(config.domain), reference, target, weights)
        return with_objects(config, {"reward": node})
    if env is None and target is None and weights is None:
        return config
    sim = build_sim(config.domain)
    node = reward_of(sim, target, with_prices(sim, weights) if is_planned(config) else weights)
    return with_objects(config, {"reward": {**config.reward, **node}})


def _check_copies(config: Settings, seeds: int) -> None:
    """Refuse several seeds, or evaluation on the way, for the only copy of an environment."""
    if getattr(build_sim(config.domain), "most_rows", None) is None:
        return
    wanted = f"seeds={seeds}" if seeds > 1 else f"eval.minutes={list(config.eval.minutes)}"
    if seeds > 1 or config.eval.minutes:
        raise ConfigError(
            f"{wanted}: needs copies of the environment, which has no spec to be rebuilt from; give"
            " a factory, a function without arguments that returns a new environment"
        )


def _replaced_env(config: Settings, env: Env) -> Settings:
    node = domain_settings(env, WorldArguments(), {})
    if "given" in node or "given" in config.domain:
        return with_objects(config, {"domain": node})
    kept = {k: v for k, v in config.domain.items() if k not in ("env", "env_id", "_target_")}
    return with_objects(config, {"domain": {**node, **kept}})
