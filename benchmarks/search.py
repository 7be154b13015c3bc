"""How fast random policies are tried: simulator steps per CPU second, and whole small searches.

The tile of ``edtorch.rivals`` beside compiled scalar code (numba, extra ``[bench]``: one episode
after the other, as a careful C programmer would write it), interleaved in one process on one
thread, so that ratios hold on a busy machine.  Compiling is left out of the speeds.

    python -m benchmarks.search [--slots 256 512 1024] [--policies 2000] [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path

import numba  # pyright: ignore[reportMissingImports]
import torch

from benchmarks.search_peer import ride, search_serially
from edtorch.app.compose import compose
from edtorch.app.random_search import SearchSetup, build_search
from edtorch.rivals.episodes import Tile
from edtorch.rivals.random_search import RandomSearch, episode_key, policy_weights, search
from sims.base import Outcome

LOOK = 128
RIDES_ON = 341
"""With seed 0, a policy that rides to the goal: its episodes last 36,000 ticks."""


def setup_of(policies: int) -> SearchSetup:
    """Footnote 1, five features."""
    return build_search(compose(["experiment=footnote1", f"rival.policies={policies}"]))


def cpu_s(work: Callable[[], object]) -> float:
    """CPU seconds of one call."""
    began = time.process_time()
    work()
    return time.process_time() - began


def full_tile(setup: SearchSetup, slots: int, mode: str) -> Tile:
    """Every slot rides, for long."""
    tile = Tile(
        setup.world, setup.policy, slots=slots, look=LOOK, mode="on" if mode == "on" else "off"
    )
    ids = torch.full((slots,), RIDES_ON)
    weights = policy_weights(setup.settings, setup.policy, setup.seed, ids)
    tile.place(torch.arange(slots), weights, episode_key(setup.seed, ids, torch.arange(slots)))
    return tile


def inner_loop(setup: SearchSetup, sizes: list[int], rounds: int) -> dict[str, dict[str, float]]:
    """Million steps per CPU second, and CPU seconds of the first call."""
    weights = policy_weights(
        setup.settings, setup.policy, setup.seed, torch.tensor([RIDES_ON])
    ).numpy()
    key = episode_key(setup.seed, torch.tensor([RIDES_ON]), torch.tensor([0])).numpy()
    works: dict[str, Callable[[], object]] = {
        "numba, scalar": lambda: ride(weights[0], key[0, 0], key[0, 1], 20_000)
    }
    steps = {"numba, scalar": 20_000}
    for mode, word in (("on", "compiled"), ("off", "eager")):
        for slots in sizes:
            name = f"tile, {word}, {slots} slots"
            tile = full_tile(setup, slots, mode)
            calls = 8 if mode == "on" else 1
            works[name] = lambda tile=tile, calls=calls: [tile.advance() for _ in range(calls)]
            steps[name] = slots * LOOK * calls
    first: dict[str, float] = {}
    samples: dict[str, list[float]] = {name: [] for name in works}
    with torch.inference_mode():
        for name, work in works.items():
            first[name] = cpu_s(work)
        for _ in range(rounds):
            for name, work in works.items():
                samples[name].append(steps[name] / cpu_s(work) / 1e6)
    return {
        name: {"million_steps_per_cpu_s": statistics.median(values), "first_call_s": first[name]}
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
        mode="on",
        report=lambda progress: None,
    )
    began = time.process_time()
    outcome, ticks = search_serially(weights, keys)
    serial_s = time.process_time() - began
    goal = int((outcome == int(Outcome.SUCCEEDED)).all(-1).sum())
    tile_s = found.cpu_s - found.compile_s
    return {
        "tile": {"cpu_s": tile_s, "goal": int(found.goal.sum()), "steps": found.steps},
        "numba, scalar": {"cpu_s": serial_s, "goal": goal, "steps": int(ticks.sum())},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description="How fast random policies are tried.")
    parser.add_argument("--slots", type=int, nargs="+", default=[256, 512, 1024])
    parser.add_argument("--policies", type=int, default=5000)
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    setup = setup_of(options.policies)
    inner = inner_loop(setup, options.slots, options.rounds)
    peer = inner["numba, scalar"]["million_steps_per_cpu_s"]
    print(f"{'inner loop':28}{'M steps/CPU s':>16}{'of numba':>10}{'first call, s':>15}")
    for name, row in inner.items():
        speed = row["million_steps_per_cpu_s"]
        print(f"{name:28}{speed:16.2f}{speed / peer:10.2f}{row['first_call_s']:15.2f}")
    whole = whole_search(setup, setup.settings)
    print(f"\n{f'{options.policies} policies, 30 runs':28}{'CPU s':>16}{'goal':>10}{'M steps':>15}")
    for name, row in whole.items():
        print(f"{name:28}{row['cpu_s']:16.2f}{row['goal']:10.0f}{row['steps'] / 1e6:15.2f}")
    ratio = whole["tile"]["cpu_s"] / whole["numba, scalar"]["cpu_s"]
    print(f"tile / numba: {ratio:.2f}")
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
