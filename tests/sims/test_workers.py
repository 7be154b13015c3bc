"""Processes that die: what can be computed again is, what cannot is named."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator

import pytest
import torch

from sims.workers import Workers
from tests.sims.mortal import DEADLY, squares

pytestmark = pytest.mark.oracle  # processes take a second each to start


@pytest.fixture
def workers() -> Iterator[Workers[int, int]]:
    workers = Workers(squares, 2)
    yield workers
    workers.close()


def kill(process: int) -> None:
    """End a process and wait until nothing is left of it."""
    os.kill(process, signal.SIGKILL)
    for _ in range(500):
        try:
            with open(f"/proc/{process}/stat", encoding="ascii") as stat:
                if stat.read().rsplit(")", 1)[1].split()[0] == "Z":
                    return
        except OSError:
            return
        time.sleep(0.01)
    raise AssertionError("the process goes on")


def test_rows_keep_their_order(workers: Workers[int, int]) -> None:
    for count in (1, 2, 5):
        assert workers.map(range(count)) == [k * k for k in range(count)]
    assert len(workers.processes()) == 2


def test_a_deadly_row_is_given_up_and_nothing_else(workers: Workers[int, int]) -> None:
    with pytest.warns(RuntimeWarning, match="rows are computed again"):
        assert workers.map([3, DEADLY, 4, 5]) == [9, None, 16, 25]
    assert workers.map([1, 2]) == [1, 4]


@pytest.mark.long
def test_cardea_goes_on_after_a_death() -> None:
    pytest.importorskip("pybullet", reason="the extra [cardea] is not installed: no PyBullet")
    from sims.base import Outcome
    from sims.cardea import Cardea, Trouble, cardea

    alone, shared = Cardea(), Cardea(workers=2)
    generator = torch.Generator().manual_seed(0)
    state = alone.initial(torch.rand(5, 2, generator=generator, dtype=torch.float64))
    action = torch.zeros(5, 5).double()
    noise = torch.rand(5, 5, generator=generator, dtype=torch.float64)
    expected = alone.step(state, action, noise)
    assert torch.equal(shared.step(state, action, noise), expected)

    processes = cardea.workers(2)
    kill(processes.processes()[0])
    with pytest.warns(RuntimeWarning, match="worker process died"):
        again = shared.step(state, action, noise)
    assert torch.equal(again, expected)
    assert shared.lost(again).tolist() == [False] * 5
    processes.close()

    lost = expected.clone()
    lost[1, 25] = int(Trouble.LOST)
    assert shared.outcome(lost)[1] == Outcome.FAILED
    assert shared.lost(lost).tolist() == [False, True, False, False, False]
