"""What a program is named by, and where it is kept."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest
import torch
from torch import Tensor

from edtorch.compiled.program import cache_folder, program_name
from edtorch.learner.learner import Learner
from edtorch.run.episodes import Budget
from edtorch.run.scaled_sim import World
from edtorch.run.tick import Tick
from edtorch.types import replace
from sims.bicycle import Bicycle
from tests.compiling import training_and_tick

A, B = torch.zeros(3, 4, 6), torch.zeros(3, 5, 6)


def key(tick: Tick, tensor: Tensor = A) -> str:
    return program_name(tick, [tick.world.sim], [tensor])


def test_a_program_is_named_by_all_that_it_depends_on() -> None:
    budget = Budget(seconds=1.0)
    tick, same = training_and_tick([1], budget)[1], training_and_tick([2], budget)[1]
    # What a sim has computed for later says nothing new.
    assert same.world.sim.spec.name == "bicycle"
    assert key(tick) == key(same)
    longer = training_and_tick([1], Budget(seconds=99.0))[1]
    assert key(tick) == key(longer)
    assert isinstance(tick.learner, Learner)
    others = [
        training_and_tick([1], budget, kind="rich")[1],
        replace(tick, most_successes=1),
        replace(tick, learner=replace(tick.learner, exploration=0.1)),
        replace(tick, world=World(Bicycle(noise=0.01))),
        replace(tick, world=World(Bicycle(), torch.float32)),
    ]
    names = {key(tick), *map(key, others), key(tick, A.double()), key(tick, B)}
    assert len(names) == len(others) + 3


def test_equal_strings_need_not_be_one_object() -> None:
    one, other = "".join(["le", "an"]), "".join(["le", "an"])
    assert one is not other
    names = {program_name(pair, [], []) for pair in ((one, one), (one, other))}
    assert len(names) == 1


def test_where_programs_are_kept(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("EDTORCH_CACHE", "/somewhere")
    assert str(cache_folder()) == "/somewhere"
    monkeypatch.delenv("EDTORCH_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", "/caches")
    assert str(cache_folder()) == "/caches/edtorch"


def test_a_program_has_one_name_in_all_processes() -> None:
    # Whatever order sets of strings come out in.
    code = (
        "from tests.compiling import training_and_tick as made;"
        "from edtorch.compiled.program import program_name;"
        "from edtorch.run.episodes import Budget;"
        "print(program_name(made([1], Budget(seconds=1.0))[1], [], []))"
    )
    names = {
        subprocess.run(
            [sys.executable, "-c", code],
            env=os.environ | {"PYTHONHASHSEED": seed},
            capture_output=True,
            text=True,
            check=True,
        ).stdout
        for seed in ("1", "2", "3")
    }
    assert len(names) == 1
