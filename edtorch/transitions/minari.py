"""Minari data sets: ``main_data.hdf5`` with a group ``episode_K`` for each episode.

observations ``[T + 1, k]`` (or a group of such), actions ``[T, m]``, terminations and truncations
``[T]``; ``metadata.json`` beside it says how many episodes there are.
"""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from edtorch.run.files import FileProblem
from edtorch.transitions.arrays import components, flags
from edtorch.transitions.candidates import Candidates
from edtorch.transitions.columns import FileColumn
from sims.base import Spec

MAIN = "main_data.hdf5"
EPISODE = "episode_"


def from_minari(
    path: Path,
    content: Mapping[str, Any],
    spec: Spec,
    state: Sequence[FileColumn],
    action: Sequence[FileColumn],
) -> Candidates:
    """A transition for each action, of ``spec.dt`` seconds.  Raises FileProblem."""
    names = [name for name in content if name.startswith(EPISODE)]
    for name in names:
        if not name.removeprefix(EPISODE).isdigit():
            raise FileProblem(f"{path}: {name}: expected {EPISODE} and a number")
    names.sort(key=lambda name: int(name.removeprefix(EPISODE)))
    _check_metadata(path.with_name("metadata.json"), len(names))
    episodes = [_episode(f"{path}: {name}", content[name], spec, state, action) for name in names]
    states, actions, next_states, terminated = (
        np.concatenate(parts) for parts in zip(*episodes, strict=True)
    )
    rows = len(states)
    return Candidates(
        states,
        actions,
        next_states,
        np.full(rows, spec.dt),
        np.repeat(np.arange(len(episodes)), [len(each[0]) for each in episodes]),
        terminated,
        unusable={},
        broken=np.zeros(rows, dtype=bool),
    )


def _episode(
    where: str, group: Any, spec: Spec, state: Sequence[FileColumn], action: Sequence[FileColumn]
) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """State, action, next state and whether it terminates, of T rows."""
    wanted = ("observations", "actions", "terminations", "truncations")
    lacking = [name for name in wanted if name not in group]
    if lacking:
        raise FileProblem(f"{where}: lacks {', '.join(lacking)}")
    seen = components(f"{where}/observations", group["observations"], spec.state, state)
    actions = components(f"{where}/actions", group["actions"], spec.action, action)
    rows = len(actions)
    if len(seen) != rows + 1:
        raise FileProblem(
            f"{where}/observations: has {len(seen)} rows, expected {rows + 1}, actions and one"
        )
    ends = {name: flags(f"{where}/{name}", group[name], rows) for name in wanted[2:]}
    for name, array in ends.items():
        if array[:-1].any():
            row = int(array.argmax())
            raise FileProblem(
                f"{where}/{name}: row {row} is true, expected that of the last row, {rows - 1},"
                " only"
            )
    return seen[:-1], actions, seen[1:], ends["terminations"]


def _check_metadata(path: Path, episodes: int) -> None:
    """Refuse half of a data set."""
    if not path.exists():
        return
    try:
        content = json.loads(path.read_text(encoding="utf-8"))
    except ValueError as error:
        raise FileProblem(f"{path}: is not JSON ({error})") from error
    if not isinstance(content, Mapping):
        raise FileProblem(f"{path}: expected a JSON object")
    told = content.get("total_episodes", episodes)
    if told != episodes:
        raise FileProblem(f"{path}: total_episodes={told}: expected {episodes}, as in {MAIN}")
