"""What learning from recorded data costs by how it is recorded: clocks, and lengths of episodes.

    python -m benchmarks.offline [--rounds 3] [--json FILE]

Jittering time stamps against constant ones, 64 learners, 20 episodes of 30 rows each, drawn by
bootstrap; 2,000 episodes of 2 rows against 10 of 400, 100 learners of all rows, a snapshot of
every simulated second; and 2,000 that end by themselves, which each learner lists.  Reading,
learning and the summary are measured, without the imports.
"""

from __future__ import annotations

import argparse
import tempfile
from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rich.console import Console

from benchmarks.timing import interleaved, print_table, write_json
from edtorch.app.compose import compose
from edtorch.app.job import Job
from edtorch.app.offline import RecordedLearners, build_offline
from edtorch.app.signals import Stop
from tests.recorded import linear_arrays

SETTINGS = (
    "domain=linear",
    "domain.dt=0.01",
    "domain.time_limit=1",
    "domain.state_matrix=[[1,0.02],[0,1]]",
    "domain.action_matrix=[[0],[0.06]]",
    "fit=least_squares",
    "reward=quadratic",
    "reward.state.state_0=1",
    "reward.action.action_0=0.1",
    "offline=recorded",
    "unroll.direction=regulator",
    "step=full",
    "eval.episodes=0",
    "log.every=1",
)


def failures(episodes: int, rows: int) -> dict[str, Any]:
    """Episodes that end by themselves, which are counted and listed."""
    arrays = linear_arrays(episodes, rows)
    return arrays | {"terminated": arrays["truncated"], "truncated": arrays["terminated"]}


def learn(overrides: Sequence[str]) -> None:
    config = compose([*SETTINGS, *overrides])
    work = RecordedLearners(build_offline(config), config)
    job = Job(work, config, Stop(), Console(quiet=True), lambda job: None, lambda work: None)
    job.run()
    job.summary()


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    stamps = np.diff(np.arange(601) * 0.01)
    content: dict[str, object] = {}
    with tempfile.TemporaryDirectory() as folder:
        for title, beside, files in (
            (
                "clocks",
                ["seeds=64", "offline.share=bootstrap"],
                {
                    "constant": linear_arrays(20, 30),
                    "jittering": linear_arrays(20, 30, stamps),
                    "random": linear_arrays(
                        20, 30, np.random.default_rng(0).uniform(0.008, 0.012, 600)
                    ),
                },
            ),
            (
                "episodes",
                ["seeds=100", "offline.share=all"],
                {
                    "10": linear_arrays(10, 400),
                    "2000": linear_arrays(2000, 2),
                    "2000 failures": failures(2000, 2),
                },
            ),
        ):
            works = {}
            for name, arrays in files.items():
                path = Path(folder) / f"{name}.npz"
                np.savez(path, **arrays)
                works[name] = partial(learn, [*beside, f"offline.data={path}"])
            seconds = interleaved(works, rounds=options.rounds, patience=100.0)
            first = next(iter(seconds.values()))
            print_table(
                title,
                ["CPU s", "ratio"],
                {k: [f"{v:.3g}", f"{v / first:.2f}"] for k, v in seconds.items()},
            )
            content[title] = seconds
    write_json(options.json, content)


if __name__ == "__main__":
    main()
