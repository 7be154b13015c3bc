"""What a checkpoint costs: seconds and bytes, for populations of several sizes.

    python -m benchmarks.checkpoint [--sizes 1 8 256 4096] [--rounds 9] [--json FILE]

experiment=bicycle in kernels; each population saves its state as edtorch-train does, files and
folder synchronised with the disk that has ``runs``, all sizes in turn.  Seconds are those of the
wall, since learning waits for the disk too; the share is that of a save every
``log.checkpoint_wall`` seconds.  The first learners keep a trail for pictures, here as long as it
gets; what further ones add is told apart.
"""

from __future__ import annotations

import argparse
import contextlib
import statistics
import tempfile
import time
from collections.abc import Sequence
from dataclasses import dataclass
from io import StringIO
from pathlib import Path

import torch
from rich.console import Console

from benchmarks.timing import print_table, write_json
from edtorch.app.checkpoints import CHECKPOINTS
from edtorch.app.compose import compose
from edtorch.app.job import Job
from edtorch.app.outputs import Keeper, open_sinks
from edtorch.app.rundir import RunFolder
from edtorch.app.signals import Stop
from edtorch.app.work import planned
from edtorch.run.log import Entry
from edtorch.run.training import WATCHED

ENTRIES = 4
"""In the progress of a run, one every five simulated seconds, before its states are saved."""
TRAIL = 10_000
"""States in a trail of the bicycle that is full, after 1000 seconds."""


class Enough:
    """A sink that asks the run to stop."""

    def __init__(self, stop: Stop) -> None:
        self._stop = stop
        self._count = 0

    def write(self, entry: Entry) -> None:
        """See ``Sink``."""
        self._count += 1
        self._stop.asked = self._count == ENTRIES

    def flush(self) -> Sequence[Path]:
        """See ``Sink``."""
        return ()

    def close(self) -> None:
        """See ``Sink``."""


@dataclass(frozen=True)
class Saving:
    """A job that has learned, and its folder."""

    job: Job
    keeper: Keeper
    folder: Path

    @classmethod
    def of(cls, size: int, folder: Path) -> Saving:
        """The experiment with so many learners; folder: a new one."""
        config = compose(["experiment=bicycle", f"seeds={size}"])
        folder.mkdir()
        run_folder = RunFolder(folder)
        seeds, begin = planned(config)
        run_folder.begin(config, seeds)
        work = begin(folder)
        stop, keeper = Stop(), Keeper(run_folder)
        console = Console(file=StringIO())
        job = Job(work, config, stop, console, keeper.keep, lambda work: None)
        sinks, _ = open_sinks(work, config, folder)
        job.sinks = [*sinks, Enough(stop)]
        with contextlib.suppress(KeyboardInterrupt):
            job.run()
        return cls(job, keeper, folder)

    def seconds(self) -> float:
        """Of one save, with trails as long as they get."""
        began = time.monotonic()
        state = self.job.state()
        trail = state["work"]["training"]["trail"]
        trail["ring"] = torch.ones(TRAIL, *trail["ring"].shape[1:], dtype=trail["ring"].dtype)
        self.keeper.write(self.job, state)
        return time.monotonic() - began

    @property
    def size(self) -> int:
        """Bytes of a checkpoint."""
        return max(self.folder.joinpath(CHECKPOINTS).iterdir()).stat().st_size


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--sizes", type=int, nargs="+", default=[1, 8, 256, 4096])
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    content: dict[str, dict[str, float]] = {}
    Path("runs").mkdir(exist_ok=True)
    with tempfile.TemporaryDirectory(dir="runs") as place:
        jobs = {size: Saving.of(size, Path(place) / str(size)) for size in options.sizes}
        samples = [
            {k: saving.seconds() for k, saving in jobs.items()} for _ in range(options.rounds)
        ]
        every = jobs[options.sizes[0]].job.config.log.checkpoint_wall
        for size, saving in jobs.items():
            seconds = statistics.median(sample[size] for sample in samples)
            content[f"B = {size}"] = {
                "ms": 1e3 * seconds,
                "share_percent": 100 * seconds / (every + seconds),
                "kB": saving.size / 1e3,
            }
        few, many = sorted(options.sizes)[-2:]
        further = (jobs[many].size - jobs[few].size) / (many - few) / 1e3
    columns = ["ms", f"% of {every} s", "kB"]
    rows = {
        name: [f"{row['ms']:.1f}", f"{row['share_percent']:.3f}", f"{row['kB']:.0f}"]
        for name, row in content.items()
    }
    print_table("a save", columns, rows)
    print(f"a learner beyond the first {max(few, WATCHED)}: {further:.2f} kB")
    write_json(options.json, {"saves": content, "kB_of_a_further_learner": further})


if __name__ == "__main__":
    main()
