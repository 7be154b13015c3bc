"""Runs that are killed and resumed: are they the same runs as if nothing had happened?

    python -m studies.faults [--output FOLDER] [--keep FOLDER] [--only TABLE/CELL ...] [--jobs N]
        [--runs N] [--seed N] [--quick]

Of each cell of ``faults.yaml`` one run is left alone.  ``RUNS`` more are killed by SIGKILL, once to
three times, at moments drawn uniformly from the time that it took to learn, and go on by
``edtorch-train resume=RUN`` each time.  Every start is a process of its own.  A run that was over
before its first moment, because the machine was less busy, is made again with other moments.

The runs go to ``--output``, where the killed ones stay only if something is wrong with them;
``faults.json`` and its table ``faults.md`` go there too, or to ``--keep``.  What is there is not
made again.  ``--quick``: ten runs, one of each of ten cells.
"""

from __future__ import annotations

import argparse
import json
import random
import shlex
import shutil
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

from edtorch.app.checkpoints import last_checkpoint
from edtorch.app.rundir import json_text, versions
from edtorch.run.files import FileProblem, write_text
from studies.cells import TRAIN, BadCells, Cell, chosen, read_plan, run
from studies.same_runs import differences

RUNS = 5
"""That are killed, of each cell, by default."""
QUICK = {"kernels": 4, "torch": 4, "cardea": 1, "gymnasium": 1}
"""Cells of a quick run, by table: the first ones, each with one run that is killed."""
MOST = 3
"""Kills of a run."""
OFTEN = "log.checkpoint_wall=0.2"
"""Of the runs that are killed alone: no digit depends on when states are saved."""
SAVING = f"from edtorch.app import job; job.CHECKPOINT_SHARE = 0.2; {TRAIN}"
"""Theirs is the command as it is, but for the time that they may take for that: in seconds of
learning there would else be few checkpoints to go on from, and few kills while one is written."""
POLL = 0.005
"""Seconds from one look at a process to the next."""


@dataclass(frozen=True)
class Kill:
    """at_s: seconds of learning until then, evaluations on the way included; tick: of the last
    checkpoint, None where there was none."""

    at_s: float
    tick: int | None


@dataclass
class Fault:
    """A run that was killed.

    seed: of the generator of its moments; learning_s: of the run that was left alone; missed:
    moments after its end; status: of the process that went on to the end; different: what is not as
    in the run that was left alone, None where there is nothing to compare.
    """

    cell: str
    overrides: tuple[str, ...]
    seed: str
    learning_s: float
    computed: str
    kills: list[Kill] = field(default_factory=list)
    missed: list[float] = field(default_factory=list)
    status: int = 0
    different: list[str] | None = None

    @property
    def same(self) -> bool:
        """Whether it is as if nothing had happened."""
        return self.different == []


def moments(generator: random.Random, seconds: float) -> list[float]:
    """When to kill a run that takes so long."""
    count = generator.randint(1, MOST)
    return sorted(generator.uniform(0, seconds) for _ in range(count))


def fault(cell: Cell, number: int, output: Path, seed: int) -> Fault:
    """One more run of a cell, beside the one that was left alone, killed and resumed."""
    whole = cell.folder(output)
    folder = output / "killed" / cell.table / f"{cell.name}_{number}"
    kept = folder.with_suffix(".json")
    name = f"{seed}/{cell.title}/{number}"
    if kept.exists():
        there = _read(kept)
        if (there.overrides, there.seed) == (cell.overrides, name):
            return there
    computed = _content(whole / "run.json")["computed"]
    learning = _content(whole / "summary.json")["wall_s"]
    found = Fault(cell.title, cell.overrides, name, learning, computed)
    generator = random.Random(name)
    while not found.kills and found.status == 0:
        shutil.rmtree(folder, ignore_errors=True)
        _kill_and_resume(found, folder, moments(generator, found.learning_s))
    if found.status == 0:
        found.different = differences(whole, folder)
    write_text(kept, json_text(asdict(found)))
    if found.same:
        shutil.rmtree(folder)
    wrong = f"exit status {found.status}" if found.status else found.different
    print(f"{name}: {'the same' if found.same else wrong}", flush=True)
    return found


def _read(path: Path) -> Fault:
    content = _content(path)
    kills = [Kill(**kill) for kill in content["kills"]]
    return Fault(**{**content, "kills": kills, "overrides": tuple(content["overrides"])})


def _content(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8"))


def _kill_and_resume(found: Fault, folder: Path, at: Sequence[float]) -> None:
    """A run from its beginning, killed at these moments, but for those after its end."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    arguments = [*found.overrides, OFTEN, "log.progress=false", f"hydra.run.dir={folder}"]
    lived = 0.0
    with folder.with_suffix(".log").open("w", encoding="utf-8") as log:
        for count, moment in enumerate(at):
            process = _start(arguments, log)
            if not _killed(process, folder, moment - lived):
                found.missed += at[count:]
                break
            tick, lived = _reached(folder)
            found.kills.append(Kill(moment, tick))
            arguments = [f"resume={folder}"]
        else:
            process = _start(arguments, log)
        found.status = process.wait()


def _start(arguments: Sequence[str], log: Any) -> subprocess.Popen[bytes]:
    command = [sys.executable, "-c", SAVING, *arguments]
    return subprocess.Popen(command, stdout=log, stderr=log)


def _killed(process: subprocess.Popen[bytes], folder: Path, seconds: float) -> bool:
    """Kill it so long after it has begun to learn; False: it has ended before."""
    # What a process does last before it begins to learn is to open an event file of its own.
    while not list(folder.glob(f"events.out.tfevents.*.{process.pid}.*")):
        if process.poll() is not None:
            return False
        time.sleep(POLL)
    try:
        process.wait(max(0.0, seconds))
    except subprocess.TimeoutExpired:
        process.kill()
    return process.wait() < 0


def _reached(folder: Path) -> tuple[int | None, float]:
    """The tick of the last checkpoint, and what learning and evaluating had taken until then."""
    try:
        found = last_checkpoint(folder)
    except FileProblem:
        return None, 0.0  # the process that is to go on will say it
    if found is None:
        return None, 0.0
    timing = found.state["timing"]
    return found.state["work"]["training"]["clock"], timing["wall_s"] + timing["eval_s"]


def table(faults: Sequence[Fault]) -> str:
    """Counts for each table of cells, in Markdown."""
    lines = [
        "| | runs | kills | before the first save, at tick 0 | resumed | the same digits |",
        "|---|---|---|---|---|---|",
    ]
    for name in dict.fromkeys(each.cell.partition("/")[0] for each in faults):
        some = [each for each in faults if each.cell.startswith(f"{name}/")]
        ticks = [kill.tick for each in some for kill in each.kills]
        counts = [
            len(some),
            len(ticks),
            f"{ticks.count(None)}, {ticks.count(0)}",
            sum(each.status == 0 for each in some),
            sum(each.same for each in some),
        ]
        lines.append(f"| {name} | {' | '.join(map(str, counts))} |")
    return "\n".join(lines) + "\n"


def _without_overrides(found: Fault) -> dict[str, Any]:
    return {name: value for name, value in asdict(found).items() if name != "overrides"}


def cells_of(output: Path, only: Sequence[str] | None, *, quick: bool) -> list[Cell]:
    """The cells of the study.  Raises BadCells."""
    text = Path(__file__).with_suffix(".yaml").read_text(encoding="utf-8")
    cells = read_plan(text, output).cells
    if quick:
        tables = {name: [cell for cell in cells if cell.table == name] for name in QUICK}
        cells = [cell for name, count in QUICK.items() for cell in tables[name][:count]]
    return chosen(cells, only)


def main() -> None:
    """The runs that are left alone, then the others, then the results."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--output", type=Path, default=Path("runs/faults"))
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="where the results go")
    parser.add_argument("--only", nargs="+", metavar="TABLE/CELL")
    parser.add_argument("--jobs", type=int, default=1, help="runs at a time, a core each")
    parser.add_argument("--runs", type=int, default=RUNS, help="to kill, of each cell")
    parser.add_argument("--seed", type=int, default=0, help="of the moments")
    parser.add_argument("--quick", action="store_true", help="ten runs, for a test")
    options = parser.parse_args()
    output: Path = options.output
    try:
        cells = cells_of(output, options.only, quick=options.quick)
        failed = run(cells, output, options.jobs)
    except BadCells as error:
        sys.exit(f"faults: {error}")
    if failed:
        sys.exit(f"faults: {failed} of {len(cells)} runs that are left alone failed")
    due = [(cell, k) for cell in cells for k in range(1 if options.quick else options.runs)]
    pool = ThreadPoolExecutor(options.jobs)
    try:
        faults = list(pool.map(lambda one: fault(one[0], one[1], output, options.seed), due))
    finally:
        pool.shutdown(cancel_futures=True)  # after Ctrl-C no further run starts
    content = {
        "command": shlex.join(["python", "-m", "studies.faults", *sys.argv[1:]]),
        "versions": versions(),
        "moments": "random.Random(seed), Python's Mersenne Twister",
        "cells": {cell.title: cell.overrides for cell in cells},
        "runs": [_without_overrides(each) for each in faults],
    }
    keep: Path = options.keep or output
    keep.mkdir(parents=True, exist_ok=True)
    write_text(keep / "faults.json", json_text(content))
    write_text(keep / "faults.md", table(faults))
    print(table(faults))
    if wrong := sum(not each.same for each in faults):
        sys.exit(f"faults: {wrong} of {len(faults)} runs are not as if nothing had happened")


if __name__ == "__main__":
    main()
