"""What compiling costs: the first time, and from the disk.

Each figure is that of a process of its own, CPU and wall seconds, from an empty cache, then from
the program on disk.

    python -m benchmarks.compile [--json FILE]
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.timing import print_table, write_json

CASES = {
    "mean only, one by one": ("8", ""),
    "mean only, 32 lanes": ("256", ""),
    "with covariance, one by one": ("8", "covariance"),
    "with covariance, 32 lanes": ("256", "covariance"),
}


def one(size: str, covariance: str) -> dict[str, float]:
    """In this process: CPU and wall seconds from a population to its first compiled ticks."""
    import torch

    from benchmarks.bicycle import native_training

    torch.set_num_threads(1)
    cpu, wall = time.process_time(), time.monotonic()
    children = os.times().children_user + os.times().children_system
    native_training(int(size), covariance=bool(covariance)).advance(16)
    after = os.times().children_user + os.times().children_system
    return {
        "cpu_s": time.process_time() - cpu + after - children,
        "wall_s": time.monotonic() - wall,
    }


def in_a_process(case: tuple[str, str], folder: Path) -> dict[str, float]:
    """``one`` in a process of its own, with its caches in ``folder``."""
    place = {"EDTORCH_CACHE": str(folder)}
    command = [sys.executable, "-m", "benchmarks.compile", "--one", *case]
    done = subprocess.run(
        command, env=os.environ | place, check=True, capture_output=True, text=True
    )
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--one", nargs=2, help=argparse.SUPPRESS)
    parser.add_argument("--json", type=Path)
    options = parser.parse_args()
    if options.one:
        print(json.dumps(one(*options.one)))
        return
    table: dict[str, dict[str, dict[str, float]]] = {}
    with tempfile.TemporaryDirectory() as folder:
        for name, case in CASES.items():
            table[name] = {"cold": in_a_process(case, Path(folder))}
            table[name]["from disk"] = in_a_process(case, Path(folder))
    columns = ["cold", "from disk"]
    print("CPU s (wall s) to the first compiled ticks")
    print_table(
        "",
        columns,
        {
            name: [
                f"{row[c]['cpu_s']:.1f} ({row[c]['wall_s']:.1f})" if c in row else "-"
                for c in columns
            ]
            for name, row in table.items()
        },
    )
    write_json(options.json, {"seconds": table})


if __name__ == "__main__":
    main()
