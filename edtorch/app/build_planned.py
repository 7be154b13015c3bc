"""From a composed configuration to a search between trials."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from torch import Tensor

from edtorch.app.budget import check_ticks, given_budget
from edtorch.app.checks import at_least, check_numbers, check_seeds
from edtorch.app.compute import device_of, evaluation_mode
from edtorch.app.construct import construct, known_keys
from edtorch.app.domain import build_sim, changed_domain
from edtorch.app.errors import ConfigError, under
from edtorch.app.observation import build_deviations
from edtorch.app.policy import policy_card
from edtorch.app.reward import build_reward
from edtorch.app.settings import Settings
from edtorch.app.solved import Solved, build_solved
from edtorch.compiled import numba
from edtorch.errors import Unavailable
from edtorch.model.chain import impact_terms
from edtorch.model.lift import Lift
from edtorch.model.mechanism import Structure
from edtorch.model.stops import Stops
from edtorch.model.strike import Strike
from edtorch.model.told import Told
from edtorch.native.choice import Mode
from edtorch.rewards.squares import squares_of
from edtorch.run.episodes import Budget
from edtorch.run.policy_file import PolicyCard
from edtorch.run.scaled_sim import World
from edtorch.run.trial import look_at_starts
from edtorch.search.hybrid_fit import LearnedHybrid, learn_hybrid
from edtorch.search.problem import SearchProblem, TrialSearch
from edtorch.search.target import wanted_states
from edtorch.search.tick_model import TickModel
from edtorch.types import Parameters, Transition
from sims.base import JudgesStates

STARTS_SEEN = 100
"""Starts that are looked at, to plan from their mean and to imagine from them."""


@dataclass(frozen=True)
class PlannedSetup:
    """The parts of a search between trials.

    ticks: of a trial; trials: at most, None for any number; calm: a new world to evaluate in;
    initial: parameters ``[S, ...]`` before the first improvement; told: prior knowledge, in words.
    """

    name: str
    search: TrialSearch
    problem: SearchProblem
    world: World
    calm: Callable[[], World]
    seeds: list[int]
    budget: Budget
    solved: Solved
    ticks: int
    trials: int | None
    initial: Parameters
    card: PolicyCard
    told: str
    episodes: int
    native: Mode
    threads: int

    def length(self, number: int) -> float:
        """Seconds of a run of a trial at most, by the trial's number."""
        search, whole = self.search, self.ticks * self.world.dt
        random = number < search.random_trials
        asked = search.random if random and search.random is not None else search.trial
        return whole if asked is None else min(asked, whole)

    def fits(self, number: int, seconds: float) -> bool:
        """Whether the budget lets the trial of this number begin, after so many seconds."""
        limit = self.budget.seconds
        return limit is None or seconds + self.longest(number) <= limit + 1e-9

    def longest(self, number: int) -> float:
        """Seconds of all runs of a trial at most."""
        return self.length(number) * self.search.runs(number)


def is_planned(config: Settings) -> bool:
    """Whether policies come from a search between trials, and not from the learner."""
    return config.search.get("_target_") is not None


def build_told(config: Settings, world: World) -> Told:
    """Prior knowledge of the state's components, from the domain and the group ``told``."""
    told = config.told
    with under("told"):
        return Told.of(
            world.spec,
            angles=told.angles,
            rates=told.rates,
            constant=told.constant,
            ignored=told.ignored,
            invariant=told.invariant,
        )


def build_stops(config: Settings, told: Told) -> Stops | None:
    """The stops that are told, None for none.  Raises ConfigError."""
    if not config.told.stops:
        return None
    with under("told"):
        return Stops.of(told, config.told.stops)


def build_strike(config: Settings, told: Told) -> Strike | None:
    """The strike that is told, None for none.  Raises ConfigError."""
    given = config.told.strike
    if not given:
        return None
    known_keys("told.strike", given, {"height", "swap", "counter", "jump"})
    if given.get("counter") is None:
        raise ConfigError(
            "told.strike.counter: no value; expected the component that counts strikes"
        )
    with under("told.strike"):
        return Strike.of(
            told,
            Lift.of(told),
            height=given.get("height"),
            swap=given.get("swap") or {},
            counter=given.get("counter"),
        )


def _jumps(config: Settings) -> bool:
    """Whether rates jump at a strike.  Raises ConfigError."""
    jump = (config.told.strike or {}).get("jump", "learned")
    if jump not in ("learned", "none"):
        raise ConfigError(f"told.strike.jump={jump}: expected learned or none")
    return jump == "learned"


def _hybrid(
    strike: Strike | None,
    jumps: bool,
    models_strikes: bool,
    stops: Stops | None,
    structures: Mapping[str, Structure],
    told: Told,
    world: World,
    noise: Tensor | None,
) -> Callable[[Transition, int], LearnedHybrid] | None:
    """See ``SearchProblem``.  Raises ConfigError."""
    if strike is None:
        return None
    if not models_strikes:
        raise ConfigError(
            "told.strike: expected null with this search; search=population models it"
        )
    if len(structures) != 1 or noise is None:
        raise ConfigError(
            f"told.strike: expected one model (model=chain) and observation.noise, found"
            f" {', '.join(structures)} and {'no' if noise is None else 'known'} noise"
        )
    (structure,) = structures.values()
    with under("told.strike"):
        features = impact_terms(told, structure.lift) if jumps else None
    weight = np.zeros((len(structure.learned), structure.terms.count))
    bounds = world.action_middle.numpy(), world.action_half_range.numpy()

    def learn(transition: Transition, substeps: int) -> LearnedHybrid:
        model = TickModel(structure, weight, world.dt, *bounds, substeps, stops)
        return learn_hybrid(model, strike, features, transition, noise)

    return learn


def build_problem(config: Settings, world: World) -> tuple[TrialSearch, SearchProblem]:
    """The search and its problem in a world.  Raises ConfigError, which names the key."""
    told = build_told(config, world)
    search = construct("search", config.search, "improve", "actor")
    stops = build_stops(config, told)
    model = construct("model", config.model, "structures")
    fit = construct("fit", config.fit, "learn")
    with under("model"):
        structures = model.structures(told)
    ticks = world.limit_ticks
    first = next(iter(structures.values()))
    if world.reward is None:
        raise ConfigError("reward: expected one to plan with")
    with under("reward"):
        squares, action = squares_of(world.reward, first.lift, ticks)
    rows = squares.numpy()
    noise = build_deviations(config.observation, world) if config.observation.noise else None
    problem = SearchProblem(
        names=[q.name for q in world.spec.state],
        scale=torch.tensor([q.scale for q in world.spec.state], dtype=torch.float64),
        structures=structures,
        learn=lambda transitions, trial: fit.learn(structures, transitions, trial, stops),
        rows=rows,
        action=(action * world.action_half_range**2).numpy(),
        middle=world.action_middle,
        half=world.action_half_range,
        period=first.period,
        dt=world.dt,
        starts=lambda seed: look_at_starts(world, seed, STARTS_SEEN),
        judge=_judge(world),
        noise=noise,
        goal=wanted_states(first, rows, world.dt),
        told=told,
        stops=stops,
        hybrid=_hybrid(
            *(build_strike(config, told), _jumps(config), search.models_strikes, stops),
            *(structures, told, world, noise),
        ),
    )
    return search, problem


def _judge(world: World) -> Callable[[Tensor], Tensor] | None:
    """Judges true states ``[*batch, T + 1, n]``, scaled; None where the domain does not."""
    sim = world.sim
    if not isinstance(sim, JudgesStates):
        return None
    scale = torch.tensor([q.scale for q in world.spec.state], dtype=torch.float64)
    return lambda states: sim.judge(states * scale)


def build_planned(config: Settings) -> PlannedSetup:
    """Objects for a search between trials.  Raises ConfigError, which names the key."""
    _check(config)
    try:
        numba()
    except Unavailable as error:
        raise ConfigError(f"search={_name(config)}: its plans are compiled; {error}") from error
    sim = build_sim(config.domain)
    evaluated = changed_domain(config.domain, config.eval.domain, "eval.domain")
    reward = build_reward(config.reward, sim, torch.float64)

    def world_of(sim: Any) -> World:
        return World(sim, torch.float64, None, None, reward, config.eval.success_return)

    world = world_of(sim)
    search, problem = build_problem(config, world)
    for setting, package in search.packages.items():
        try:
            package.module()
        except Unavailable as error:
            raise ConfigError(f"search.{setting}: {error}") from error
    stops = f"stops: {problem.stops.words}" if problem.stops else ""
    strike = "what a strike exchanges, and its height" if problem.hybrid else ""
    told = (problem.told.words, stops, strike, search.prior)
    seeds = [config.seed + k for k in range(config.seeds)]
    with under("search"):
        actor, _ = search.actor(problem)
    budget = given_budget(config.train) or Budget(episodes=10)
    check_ticks(budget, world.dt)
    setup = PlannedSetup(
        name=_name(config),
        search=search,
        problem=problem,
        world=world,
        calm=lambda: world_of(build_sim(evaluated)),
        seeds=seeds,
        budget=budget,
        solved=build_solved(config),
        ticks=world.limit_ticks,
        trials=budget.episodes,
        initial=actor.initial(seeds),
        card=policy_card(sim, actor, seeds),
        told="; ".join(part for part in told if part),
        episodes=config.eval.episodes,
        native=evaluation_mode(config),
        threads=config.compute.threads,
    )
    if not setup.fits(0, 0.0):
        raise ConfigError(
            f"train.seconds={budget.seconds:g}: expected at least the first trial,"
            f" {setup.longest(0):g} s"
        )
    return setup


def _name(config: Settings) -> str:
    return str(config.search._target_).rsplit(".", 1)[-1]


def _check(config: Settings) -> None:
    check_numbers(config)
    check_seeds(config)
    at_least("compute.threads", config.compute.threads, 1)
    at_least("eval.episodes", config.eval.episodes, 1)
    if device_of(config.compute).type != "cpu":
        raise ConfigError(f"compute.device={config.compute.device}: expected cpu with a search")
    if config.train.successes is not None or config.train.until is not None:
        raise ConfigError(
            f"train.successes={config.train.successes}, train.until={config.train.until}: expected"
            " null with a search between trials; it has train.seconds, train.episodes and"
            " eval.solved"
        )
    if config.observation.unwrap is not None or config.observation.delay:
        raise ConfigError(
            f"observation.unwrap={config.observation.unwrap}, observation.delay="
            f"{config.observation.delay}: expected null and 0 with a search between trials"
        )
    if config.log.transitions:
        raise ConfigError("log.transitions=true: expected false with a search between trials")
