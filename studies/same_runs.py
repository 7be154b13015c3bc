"""Whether two runs are the same, digit for digit, but for what a clock has measured."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from safetensors.torch import load_file

TIMES = frozenset(
    "wall_s cpu_s cpu_s_of_trial startup_s eval_s figures_s ticks_per_cpu_s compile_cpu_s"
    " steps_per_cpu_s".split()
)
ABOUT = frozenset(("command", "versions"))


def differences(one: Path, other: Path) -> list[str]:
    """What is not the same in two run folders: policies, ``summary.json``, ``metrics.csv``,
    ``episodes.csv``, transitions, scalars of TensorBoard; empty if everything is."""
    parts: dict[str, Callable[[Path], Any]] = {
        "policy.safetensors": _policies,
        "summary.json": _summary,
        "metrics.csv": _rows,
        "episodes.csv": _rows,
        "transitions.part": Path.read_bytes,
    }
    for folder in (one, other):
        if not folder.is_dir():
            raise FileNotFoundError(f"{folder}: expected the folder of a run")
    found = []
    for name, read in parts.items():
        there = [(folder / name).exists() for folder in (one, other)]
        if there == [True, True]:
            same = read(one / name) == read(other / name)
        else:
            same = there == [False, False]
        found += [] if same else [name]
    return found if scalars(one) == scalars(other) else [*found, "TensorBoard"]


def _policies(path: Path) -> dict[str, tuple[torch.dtype, tuple[int, ...], bytes]]:
    return {
        name: (p.dtype, tuple(p.shape), p.numpy().tobytes()) for name, p in load_file(path).items()
    }


def _summary(path: Path) -> str:
    return json.dumps(_timeless(json.loads(path.read_text(encoding="utf-8"))))


def _timeless(content: Any) -> Any:
    if isinstance(content, dict):
        kept = {k: v for k, v in content.items() if k not in TIMES | ABOUT}
        return {key: _timeless(value) for key, value in kept.items()}
    return [_timeless(each) for each in content] if isinstance(content, list) else content


def _rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="", encoding="utf-8") as file:
        return [
            {key: value for key, value in row.items() if key not in TIMES}
            for row in csv.DictReader(file)
        ]


def scalars(folder: Path) -> dict[str, list[tuple[int, float]]]:
    """By tag, the steps and values in the event files of a folder, in order."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    if not list(folder.glob("events.out.tfevents.*")):
        return {}
    read = EventAccumulator(str(folder), size_guidance={"scalars": 0})
    read.Reload()
    return {
        tag: [(event.step, event.value) for event in read.Scalars(tag)]
        for tag in read.Tags()["scalars"]
        if tag.rpartition("/")[2] not in TIMES
    }
