"""``edtorch.learn`` with its default preset on six systems: is each held at its target?

One set of settings for all of them; each system is given its names, its target and its seconds.
Policies are frozen and tried in 50 evaluation episodes per seed.  The settings were chosen on the
seeds 100 to 115; the default here are others.

    python -m studies.regulation --output runs/reference/regulation.json

needs the extra ``[envs]``.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import gymnasium
import numpy as np
import torch
from torch import Tensor

import edtorch
from edtorch.app.rundir import versions
from sims.base import Outcome, Sim
from sims.tasks.cart_pole import CartPole
from sims.tasks.pendulum import UprightPendulum
from sims.tasks.quadrotor import Quadrotor

EPISODES = 50
LINEAR_TICKS = (100, 200, 400)
Result = dict[str, Any]


def _learn(env: Any, seeds: Sequence[int], seconds: float, **more: Any) -> edtorch.Run:
    return edtorch.learn(
        env, seed=seeds[0], seeds=len(seeds), seconds=seconds, progress=False, **more
    )


def _failures(run: edtorch.Run, seeds: Sequence[int]) -> list[int]:
    """While learning, per seed."""
    records = run.episodes
    return [sum(e["seed"] == s and e["outcome"] == "failed" for e in records) for s in seeds]


def _rides(sim: Sim, predict: Callable[[Any], Any], seed: int) -> tuple[Tensor, Tensor]:
    """States ``[T, EPISODES, n]`` to the time limit, and whether an episode failed
    ``[EPISODES]``."""
    generator = torch.Generator().manual_seed(10_000 + seed)
    count = EPISODES
    uniforms = torch.rand(count, sim.spec.reset_dim, generator=generator, dtype=torch.float64)
    state, failed, trail = sim.initial(uniforms), torch.zeros(count, dtype=torch.bool), []
    for _ in range(round(sim.spec.time_limit / sim.spec.dt)):
        action = torch.from_numpy(np.asarray(predict(sim.observe(state).numpy()), dtype=float))
        disturbance = torch.rand(
            count, sim.spec.disturbance_dim, generator=generator, dtype=torch.float64
        )
        state = sim.step(state, action, disturbance)
        failed = failed | (sim.outcome(state) == int(Outcome.FAILED))
        trail.append(state)
    return torch.stack(trail), failed


def _by_return(run: edtorch.Run, least: float) -> Result:
    found = run.evaluate(episodes=EPISODES)
    return {
        "return": found["return"],
        "held": [r is not None and r >= least for r in found["return"]],
    }


def inverted_pendulum(seeds: Sequence[int]) -> Result:
    """InvertedPendulum-v5, 8 s: a return of 1000."""
    names = ["position", "angle", "speed", "rate"]
    target = {"position": 0.0, "angle": 0.0}
    run = _learn("InvertedPendulum-v5", seeds, 8, names=names, target=target)
    return {"failures": _failures(run, seeds)} | _by_return(run, 1000.0)


def cartpole_balance(seeds: Sequence[int]) -> Result:
    """dm_control's cartpole balance, 20 s: a return of at least 990."""
    import shimmy

    gymnasium.register_envs(shimmy)

    def make() -> Any:
        env = gymnasium.make("dm_control/cartpole-balance-v0")
        return gymnasium.wrappers.FlattenObservation(env)

    run = _learn(
        make,
        seeds,
        20,
        dt=0.01,
        time_limit=10.0,
        names=["position", "cos", "sin", "speed", "rate"],
        angles={"angle": ("cos", "sin")},
        target={"position": 0.0, "angle": 0.0},
    )
    return {"failures": _failures(run, seeds)} | _by_return(run, 990.0)


def pendulum(seeds: Sequence[int]) -> Result:
    """Pendulum-v1 near upright, 20 s: within 0.2 rad from 2 s on."""
    run = _learn(
        UprightPendulum,
        seeds,
        20,
        dt=0.05,
        time_limit=10.0,
        names=["cos", "sin", "rate"],
        angles={"angle": ("cos", "sin")},
        target={"angle": 0.0},
    )
    farthest = []
    for seed, policy in zip(seeds, run.policies, strict=True):
        env, most = UprightPendulum(), 0.0
        for episode in range(EPISODES):
            observation, _ = env.reset(seed=10_000 + 100 * seed + episode)
            policy.reset()
            for tick in range(200):
                observation, _, terminated, _, _ = env.step(policy.predict(observation))
                if tick >= 40 or terminated:
                    most = max(most, float(abs(np.arctan2(observation[1], observation[0]))))
                if terminated:
                    break
        farthest.append(most)
    held = [most <= 0.2 for most in farthest]
    return {"failures": _failures(run, seeds), "farthest_rad": farthest, "held": held}


def cart_pole(seeds: Sequence[int]) -> Result:
    """A cart-pole under a constant push of 2 N, 20 s: 1 m away, within 2 cm on average."""
    sim = CartPole(push=2.0)
    run = _learn(sim, seeds, 20, target={"position": 1.0, "angle": 0.0})
    offsets, held = [], []
    for seed, policy in zip(seeds, run.policies, strict=True):
        trail, failed = _rides(sim, policy.predict, seed)
        offset = float((trail[-250:, :, 0] - 1).abs().mean(0).max())
        offsets.append(100 * offset)
        held.append(offset <= 0.02 and not bool(failed.any()))
    return {"failures": _failures(run, seeds), "offset_cm": offsets, "held": held}


def quadrotor(seeds: Sequence[int]) -> Result:
    """A quadrotor with 12 states, 30 s: within 10 cm in the last 5 s of 10, at most 4 crashes while
    learning."""
    sim = Quadrotor()
    run = _learn(sim, seeds, 30, target={"x": 0.0, "y": 0.0, "z": 0.0, "yaw": 0.0})
    crashes, distances, held = _failures(run, seeds), [], []
    for seed, policy, crashed in zip(seeds, run.policies, crashes, strict=True):
        trail, failed = _rides(sim, policy.predict, seed)
        distance = float(trail[-250:, :, :3].norm(dim=-1).max())
        distances.append(100 * distance)
        held.append(distance <= 0.1 and crashed <= 4 and not bool(failed.any()))
    return {"failures": crashes, "distance_cm": distances, "held": held}


def _linear(seeds: Sequence[int], model: str, ticks: int) -> Result:
    """An unstable linear system with noise, 20 seeds: episodes of 50 ticks do not diverge (ten
    times the largest start, with the spectral radius of the closed loop beside it)."""
    many = range(seeds[0], seeds[0] + 20)
    F = torch.tensor([[1.01, 0.02], [0.02, 1.01]], dtype=torch.float64)
    G = torch.tensor([[0.0], [0.06]], dtype=torch.float64)
    settings = [
        "domain=linear",
        "domain.state_matrix=[[1.01,0.02],[0.02,1.01]]",
        "domain.action_matrix=[[0.0],[0.06]]",
        f"model={model}",
        "model.features=affine",
    ]
    run = _learn(None, many, ticks, overrides=settings)
    radii, sizes = [], []
    for policy in run.policies:
        rows = np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]])
        actions = np.asarray(policy.predict(rows))
        K = torch.from_numpy(actions[1:] - actions[0]).mT
        radii.append(float(torch.linalg.eigvals(F + G @ K).abs().max()))
    for seed, policy in zip(many, run.policies, strict=True):
        generator = torch.Generator().manual_seed(10_000 + seed)
        state = 2 * torch.rand(EPISODES, 2, generator=generator, dtype=torch.float64) - 1
        for _ in range(50):
            action = torch.from_numpy(np.asarray(policy.predict(state.numpy()), dtype=float))
            noise = 0.1 * torch.randn(EPISODES, 2, generator=generator, dtype=torch.float64)
            state = state @ F.mT + action @ G.mT + noise
        sizes.append(float(state.abs().max()))
    return {"radius": radii, "largest": sizes, "held": [size <= 10.0 for size in sizes]}


SYSTEMS: dict[str, Callable[[Sequence[int]], Result]] = {
    f.__name__: f
    for f in (
        inverted_pendulum,
        cartpole_balance,
        pendulum,
        cart_pole,
        quadrotor,
    )
} | {
    f"linear_{model}_{ticks}": partial(_linear, model=model, ticks=ticks)
    for model in ("derivative", "next_state")
    for ticks in LINEAR_TICKS
}


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the systems, print a line for each, write the results."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("systems", nargs="*", default=list(SYSTEMS), help=", ".join(SYSTEMS))
    parser.add_argument("--seed", type=int, default=0, help="the first one")
    parser.add_argument("--seeds", type=int, default=8, help="how many (linear systems: 20)")
    parser.add_argument("--output", type=Path, help="a JSON file")
    options = parser.parse_args(arguments)
    unknown = [name for name in options.systems if name not in SYSTEMS]
    if unknown:
        parser.error(f"{unknown[0]}: expected one of {', '.join(SYSTEMS)}")
    results: dict[str, Result] = {}
    for name in options.systems:
        began = time.monotonic()
        results[name] = SYSTEMS[name](range(options.seed, options.seed + options.seeds))
        held = results[name]["held"]
        results[name]["wall_s"] = round(time.monotonic() - began, 1)
        print(f"{name}: held by {sum(held)} of {len(held)}", flush=True)
    if options.output is not None:
        about = {"command": f"python -m studies.regulation {' '.join(arguments or sys.argv[1:])}"}
        report = about | {"seed": options.seed, "versions": versions(), "systems": results}
        options.output.write_text(json.dumps(report, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
