"""Other people's data by the command: used whole, or refused or warned of in one line."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.recorded import linear_arrays

Command = Callable[..., Any]

LEARN = (
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
    "offline.share=all",
    "unroll.direction=regulator",
    "step=full",
    "seeds=1",
    "eval.episodes=0",
    "log.tensorboard=false",
    "log.figures=false",
    "log.progress=false",
    "offline.data=data.npz",
)


def _summary(folder: Path) -> dict[str, Any]:
    return json.loads((folder / "summary.json").read_text())["offline"]


@pytest.mark.experiment
def test_data_are_used_whole_unless_there_is_a_budget(command: Command, workplace: Path) -> None:
    """Whatever the episodes came to, and however long they are together."""
    ends = np.arange(40) % 4 == 3
    won = {"terminated": ends, "truncated": np.zeros(40, dtype=bool), "succeeded": ends}
    np.savez(workplace / "data.npz", **linear_arrays(dt=1000.0, **won))
    slow = (*LEARN, "domain.dt=1000", "domain.time_limit=1e6")
    found = command("edtorch-train", *slow, "hydra.run.dir=whole")
    assert found.status == 0, found.err
    assert _summary(workplace / "whole")["transitions_used"]["per_seed"] == [40]
    assert "transitions of each learner: 40 learned from\n" in found.out
    found = command("edtorch-train", *slow, "train.successes=2", "hydra.run.dir=cut")
    assert found.status == 0, found.err
    assert "8 learned from; left out: 32 beyond the budget\n" in found.out
    summary = _summary(workplace / "cut")
    assert summary["left_out"]["budget"]["per_seed"] == [32]
    assert summary["transitions_left_out"]["per_seed"] == [32]


def test_seeds_that_are_null(command: Command, workplace: Path) -> None:
    np.savez(workplace / "data.npz", **linear_arrays(meta={"seeds": None}))
    found = command("edtorch-train", *LEARN)
    assert found.status == 1
    assert found.line.startswith("edtorch-train: data.npz: meta.seeds=null: expected a list of")


@pytest.mark.experiment
def test_what_contradicts_itself_is_refused_or_masked_and_the_odd_is_told(
    command: Command, workplace: Path
) -> None:
    """Flat arrays of observations taken for transitions, with a sensor that stands still."""
    arrays = linear_arrays()
    arrays["next_state"] = np.roll(arrays["state"], -1, axis=0)
    arrays["state"][:, 1] = arrays["next_state"][:, 1] = 0.5
    np.savez(workplace / "data.npz", **arrays)
    refused = command("edtorch-train", *LEARN)
    assert refused.status == 1
    assert "data.npz: row 3: the last next_state of episode 0 is the first" in refused.line
    masked = command("edtorch-train", *LEARN, "offline.invalid=mask", "hydra.run.dir=run")
    assert masked.status == 0, masked.err
    odd = "data.npz: state state_1 is 0.5 in all of "
    assert odd in masked.err and odd in (workplace / "run" / "run.log").read_text()
    summary = _summary(workplace / "run")
    (rows,) = summary["left_out"]["masked"]["per_seed"]
    assert 8 <= rows <= 10 and summary["transitions_used"]["per_seed"] == [40 - rows]
    assert len(summary["masked"]) == 1 and summary["warnings"][0].startswith(odd)
