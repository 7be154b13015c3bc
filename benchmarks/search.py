"""How fast random policies are tried: simulator steps per CPU second, and whole small searches.

The episodes of ``edtorch.rivals`` beside scalar code (numba: one episode after the other, as a
careful C programmer would write it), interleaved in one process on one thread, so that ratios hold
on a busy machine.  Compiling is left out of the speeds.

    python -m benchmarks.search [--lanes 1 16] [--policies 5000] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TypeVar

import numba  # pyright: ignore[reportMissingImports]
import torch

from benchmarks.search_peer import ride, search_serially
from edtorch.app.compose import compose
from edtorch.app.random_search import SearchSetup, build_search
from edtorch.rivals.episodes import Episodes
from edtorch.rivals.native_episodes import EPISODE_LANES, NativeEpisodes
from edtorch.rivals.random_search import RandomSearch, episode_key, policy_weights, search
from edtorch.run.hashing import uniform
from sims.base import Outcome

Result = TypeVar("Result")
RIDES_ON = 341
"""With seed 0, a policy that rides to the goal: its episodes last 36,000 ticks."""


def setup_of(policies: int) -> SearchSetup:
    """Footnote 1, five features."""
    return build_search(compose(["experiment=footnote1", f"rival.policies={policies}"]))


def cpu_s(work: Callable[[], Result]) -> tuple[float, Result]:
    """CPU seconds of one call, and its result."""
    began = time.process_time()
    result = work()
    return time.process_time() - began, result


def inner_loop(setup: SearchSetup, lanes: list[int], rounds: int) -> dict[str, dict[str, float]]:
    """Million steps per CPU second of rides to the goal, and CPU seconds to compile."""
    ids = torch.full((max(lanes),), RIDES_ON)
    weights = policy_weights(setup.settings, setup.policy, setup.seed, ids)
    keys = episode_key(setup.seed, ids, torch.arange(len(ids)))
    world, limit = setup.world, setup.world.limit_ticks
    start = world.initial(uniform(keys, torch.zeros_like(ids), world.uniforms))
    weight, (first, second) = weights[0].numpy(), keys[0].tolist()
    works: dict[str, Callable[[], int]] = {
        "numba, scalar": lambda: int(ride(weight, first, second, limit)[1])
    }
    cost: dict[str, float] = {"numba, scalar": cpu_s(works["numba, scalar"])[0]}

    def ridden(episodes: Episodes, count: int) -> int:
        before = episodes.steps
        for _ in episodes.pieces(weights[:count], keys[:count], start[:count]):
            pass
        return episodes.steps - before

    for count in lanes:
        name = f"edtorch, {count} lanes"
        cost[name], episodes = cpu_s(
            partial(NativeEpisodes, world, setup.policy, None, limit, lanes=count)
        )
        works[name] = partial(ridden, episodes, count)
    samples: dict[str, list[float]] = {name: [] for name in works}
    for _ in range(rounds):
        for name, work in works.items():
            seconds, steps = cpu_s(work)
            samples[name].append(steps / seconds / 1e6)
    return {
        name: {"million_steps_per_cpu_s": statistics.median(values), "first_call_s": cost[name]}
        for name, values in samples.items()
    }


def whole_search(setup: SearchSetup, settings: RandomSearch) -> dict[str, dict[str, float]]:
    """CPU seconds, compiling left out, and what was found: the same by both."""
    ids = torch.arange(settings.policies)
    weights = policy_weights(settings, setup.policy, setup.seed, ids).numpy()
    keys = episode_key(setup.seed, ids[:, None], torch.arange(settings.runs)).numpy()
    found = search(
        settings,
        setup.world,
        setup.policy,
        seed=setup.seed,
        processes=1,
        native="on",
        report=lambda *told: None,
    )
    search_serially(weights[:1], keys[:1])
    serial_s, (outcome, ticks) = cpu_s(lambda: search_serially(weights, keys))
    goal = int((outcome == int(Outcome.SUCCEEDED)).all(-1).sum())
    own_s = found.cpu_s - found.compile_s
    return {
        "edtorch": {"cpu_s": own_s, "goal": int(found.goal.sum()), "steps": found.steps},
        "numba, scalar": {"cpu_s": serial_s, "goal": goal, "steps": int(ticks.sum())},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description="How fast random policies are tried.")
    parser.add_argument("--lanes", type=int, nargs="+", default=[1, EPISODE_LANES])
    parser.add_argument("--policies", type=int, default=5000)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    setup = setup_of(options.policies)
    inner = inner_loop(setup, options.lanes, options.rounds)
    peer = inner["numba, scalar"]["million_steps_per_cpu_s"]
    print(f"{'inner loop':28}{'M steps/CPU s':>16}{'of numba':>10}{'first call, s':>15}")
    for name, row in inner.items():
        speed = row["million_steps_per_cpu_s"]
        print(f"{name:28}{speed:16.2f}{speed / peer:10.2f}{row['first_call_s']:15.2f}")
    whole = whole_search(setup, setup.settings)
    print(f"\n{f'{options.policies} policies, 30 runs':28}{'CPU s':>16}{'goal':>10}{'M steps':>15}")
    for name, row in whole.items():
        print(f"{name:28}{row['cpu_s']:16.2f}{row['goal']:10.0f}{row['steps'] / 1e6:15.2f}")
    ratio = whole["edtorch"]["cpu_s"] / whole["numba, scalar"]["cpu_s"]
    print(f"edtorch / numba: {ratio:.2f}")
    if options.json is not None:
        content = {
            "inner_loop": inner,
            "search": whole,
            "policies": options.policies,
            "torch": torch.__version__,
            "numba": numba.__version__,
            "python": platform.python_version(),
            "machine": platform.processor() or platform.machine(),
            "threads": 1,
        }
        options.json.write_text(json.dumps(content, indent=1) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
