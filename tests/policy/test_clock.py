"""The time of an episode as a component of the state."""

from __future__ import annotations

import torch

from edtorch.policy.clock import EpisodeClock
from edtorch.types import Transition


def test_counts_the_ticks_of_each_episode() -> None:
    clock, observation = EpisodeClock(), torch.arange(6.0).double().view(3, 2)
    memory = clock.initial(observation)
    valid, dt = torch.ones(3, dtype=torch.bool), torch.tensor(0.1)
    happened = Transition(observation, observation[:, :1], observation, dt, valid)
    for _ in range(4):
        memory = clock.follow({}, memory, happened)
    memory = clock.begin(memory, torch.tensor([False, True, False]), observation)
    memory = clock.follow({}, memory, happened)
    found = clock.now({}, memory, observation)
    assert torch.equal(found[:, :2], observation)
    assert found[:, 2].tolist() == [5, 1, 5]
