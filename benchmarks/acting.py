"""What one action of a frozen policy costs: the goal is 100 us.

    python -m benchmarks.acting [--rounds 7] [--json FILE]

The policies that searches between trials leave, of random parameters: a plan with gains by tick,
knots at its states, monomials of the lift, radial functions, a network, a gait's curves, a
regulator; and the bicycle's, linear in the state.

Microseconds of ``LearnedPolicy.predict`` (units, checks and bounds included), which is on numpy for
one state (``edtorch.law``); of the actor alone on tensors; and, where roll-outs of the policy are
compiled, of a tick of one, the model included.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
import torch

from benchmarks.timing import Work, interleaved, print_table, write_json
from edtorch.app.acting import LearnedPolicy
from edtorch.app.build import build
from edtorch.app.build_planned import build_planned, is_planned
from edtorch.app.compose import compose
from edtorch.app.policy import build_actor
from edtorch.search.imagination import Futures, Knots, imagine, imagine_knots
from edtorch.search.plan import Plan
from tests.planning import HANGING, swing_up, swing_up_cost

ADAM = ("experiment=pendulum_swingup", "search=gradient", "search/improver=adam")
POLICIES = {
    "timed": ["experiment=cartpole_swingup"],
    "knots": ["experiment=cartpole_swingup", "search.policy=stationary"],
    "monomials": ["experiment=pendulum_swingup", "search=gradient", "search.odd=true"],
    "radial": [*ADAM, "search/policy=rbf"],
    "network": [*ADAM, "search/policy=mlp"],
    "phase": ["experiment=walker"],
    "regulator": ["experiment=cartpole_swingup", "search=regulated", "search.held={angle: 0.0}"],
    "linear": ["experiment=bicycle"],
}
ROLL_OUTS = 100


def policy(overrides: list[str], generator: torch.Generator) -> tuple[LearnedPolicy, Work, int]:
    """One of random parameters, its actor alone, and the size of an observation."""
    config = compose([*overrides, "seeds=1"])
    if is_planned(config):
        setup = build_planned(config)
        world = setup.world
        actor, memory = setup.search.actor(setup.problem)
        shapes = {name: tuple(p.shape[1:]) for name, p in setup.initial.items()}
    else:
        world = build(config).world
        (actor, shapes), memory = build_actor(config, world), None
    parameters = {
        name: torch.randn(1, *shape, generator=generator, dtype=world.dtype)
        for name, shape in shapes.items()
    }
    reading = torch.full((1, len(world.spec.state)), 0.1, dtype=world.dtype)
    state = reading
    if memory is not None:
        state = memory.now(parameters, memory.initial(reading), reading)

    @torch.inference_mode()
    def act() -> object:
        return actor.action(parameters, state)

    return LearnedPolicy(world, actor, parameters, memory), act, reading.shape[-1]


def predicting(acting: LearnedPolicy, observation: np.ndarray) -> Work:
    """An action, again and again."""
    return lambda: acting.predict(observation)


def rolling(generator: np.random.Generator) -> tuple[dict[str, Work], int]:
    """Compiled roll-outs in the model of a cart-pole, many at a time, and their ticks in all."""
    model, (n, m) = swing_up(), (4, 1)
    cost = swing_up_cost(model)
    ticks = cost.ticks
    weight = np.tile(model.weight, (ROLL_OUTS, 1, 1))
    start = HANGING + 0.1 * generator.standard_normal((ROLL_OUTS, n))
    futures = Futures(weight, start, np.zeros((ROLL_OUTS, ticks, n)))
    gain = 0.1 * generator.standard_normal((ticks, m, n))
    state, raw = np.tile(HANGING, (ticks + 1, 1)), np.zeros((ticks, m))
    plan = Plan(state, raw, gain, 0.0)
    knots = Knots(state[:-1], raw, gain, np.ones(ticks), np.ones(n), 0.1)
    works: dict[str, Work] = {
        "timed, a tick of a compiled roll-out": lambda: imagine(model, cost, plan, futures),
        "knots, a tick of a compiled roll-out": lambda: imagine_knots(model, cost, knots, futures),
    }
    return works, ROLL_OUTS * ticks


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    generator = torch.Generator().manual_seed(0)
    works: dict[str, Work] = {}
    for name, overrides in POLICIES.items():
        acting, act, size = policy(overrides, generator)
        observation = np.full(size, 0.1)
        works[f"{name}, predict"] = predicting(acting, observation)
        works[f"{name}, actor alone"] = act
    compiled, ticks = rolling(np.random.default_rng(0))
    seconds = interleaved({**works, **compiled}, rounds=options.rounds)
    content = {f"us of {k}": 1e6 * s / (ticks if k in compiled else 1) for k, s in seconds.items()}
    print_table("", [""], {name: [f"{value:.3g}"] for name, value in content.items()})
    write_json(options.json, content)


if __name__ == "__main__":
    main()
