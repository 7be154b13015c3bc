"""CPU seconds to start, beyond those of ``import torch``: importing edtorch, help, a refused key.

Processes of the kinds take turns, so that all of them meet the machine alike; the medians are
compared.

    python -m benchmarks.startup --rounds 7
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

TRAIN = "import sys; from edtorch.app.train import main; sys.argv[0] = 'edtorch-train'; main()"
KINDS: dict[str, tuple[str, tuple[str, ...]]] = {
    "import torch": ("import torch", ()),
    "import edtorch": ("import edtorch", ()),
    "edtorch-train --help": (TRAIN, ("--help",)),
    "edtorch-train, a wrong key": (TRAIN, ("step.alpa=1",)),
    "edtorch-train, a wrong value": (TRAIN, ("domain.noise=-1",)),
}
BASE = "import torch"
WITHIN = {"import edtorch": 0.7, "edtorch-train --help": 1.5, "edtorch-train, a wrong key": 1.5}
"""CPU seconds beyond the base that are allowed."""


def cpu_seconds(code: str, arguments: tuple[str, ...], folder: Path) -> float:
    """User and system time of a process that runs ``code``."""
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    with (folder / "output").open("w") as output:
        process = subprocess.Popen(
            [sys.executable, "-c", code, *arguments],
            cwd=folder,
            env=environment,
            stdout=output,
            stderr=output,
        )
        _, _, usage = os.wait4(process.pid, 0)
        process.returncode = 0
    return usage.ru_utime + usage.ru_stime


def measure(rounds: int) -> dict[str, float]:
    """Medians by kind, after a round that fills the caches of files."""
    found: dict[str, list[float]] = {kind: [] for kind in KINDS}
    with tempfile.TemporaryDirectory() as folder:
        for count in range(rounds + 1):
            for kind, (code, arguments) in KINDS.items():
                seconds = cpu_seconds(code, arguments, Path(folder))
                if count:
                    found[kind].append(seconds)
    return {kind: statistics.median(seconds) for kind, seconds in found.items()}


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--rounds", type=int, default=7)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    medians = measure(options.rounds)
    print(f"{'':32}{'CPU s':>8}{'beyond':>9}{'allowed':>9}")
    for kind, seconds in medians.items():
        beyond = seconds - medians[BASE]
        print(f"{kind:32}{seconds:8.2f}{beyond:9.2f}{WITHIN.get(kind, float('nan')):9.1f}")
    if options.json is not None:
        options.json.write_text(json.dumps(medians, indent=1) + "\n")


if __name__ == "__main__":
    main()
