"""A learned policy acts alike for one episode, on numpy, and for several, in torch."""

from __future__ import annotations

import pickle
from typing import Any

import numpy as np
import pytest
import torch

from benchmarks.acting import POLICIES, policy
from edtorch.app.acting import LearnedPolicy


def _refuse(*_: Any) -> None:
    raise AssertionError("called")


@pytest.mark.parametrize("name", POLICIES)
def test_numpy_acts_as_torch(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    alone, _, size = policy(POLICIES[name], torch.Generator().manual_seed(0))
    together, _, _ = policy(POLICIES[name], torch.Generator().manual_seed(0))
    # Ticks beyond a plan's horizon, and angles beyond half a turn, are among them.
    walk = np.random.default_rng(0).normal(scale=0.3, size=(150, size)).cumsum(0)
    wanted = [together.predict(np.stack([row, -row]))[0] for row in walk]
    monkeypatch.setattr(LearnedPolicy, "_act", _refuse)
    assert alone.predict(walk[:1]).shape == (1, len(wanted[0]))
    # As a worker process gets it, after its first action.
    alone = pickle.loads(pickle.dumps(alone))
    alone.reset()
    found = np.stack([alone.predict(row) for row in walk])
    np.testing.assert_allclose(found, wanted, rtol=0, atol=1e-12)
    assert np.ptp(found) > 0


def test_episodes_do_not_change_in_number() -> None:
    timed, _, size = policy(POLICIES["timed"], torch.Generator().manual_seed(0))
    first = timed.predict(np.zeros(size))
    with pytest.raises(ValueError, match="2 rows, expected the 1 episodes"):
        timed.predict(np.zeros((2, size)))
    with pytest.raises(ValueError, match=f"has {size + 1} components, expected those of"):
        timed.predict(np.zeros(size + 1))
    timed.reset()
    assert np.array_equal(timed.predict(np.zeros(size)), first)
