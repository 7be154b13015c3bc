"""What a rival has paid, beside what the learner's own records say of the same episodes."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from edtorch.rewards import QuadraticReward
from edtorch.rivals.ledger import Account, pay
from edtorch.run.episodes import Budget, Episode
from edtorch.run.milestones import first_success
from edtorch.run.scaled_sim import World
from sims.base import Outcome
from sims.linear import LinearSystem


def _add(account: Account, outcome: Outcome, seconds: float, *, success: bool) -> None:
    account.spend(seconds)
    account.end(outcome, seconds, success=success)


ENDS = st.lists(st.tuples(st.sampled_from(list(Outcome)[1:]), st.integers(1, 1000)), max_size=8)


@given(ENDS, st.integers(0, 100), st.booleans())
def test_the_first_success_is_that_of_the_learners_records(
    ends: list[tuple[Outcome, int]], more: int, lasting: bool
) -> None:
    """The second way: episodes kept, and looked through in the end; lasting: whether it is a
    success to reach the time limit."""
    account, kept, start = Account(), [], 0.0
    for number, (outcome, seconds) in enumerate(ends):
        success = outcome is Outcome.SUCCEEDED or (lasting and outcome is Outcome.TIMED_OUT)
        _add(account, outcome, seconds, success=success)
        kept.append(Episode(0, number, start, seconds, outcome, {}, success=success))
        start += seconds
    account.spend(more)
    assert account.first_success == first_success(kept, start + more)
    assert account.episodes == len(ends)
    assert account.failures == sum(outcome is Outcome.FAILED for outcome, _ in ends)
    assert account.seconds == start + more


def test_an_episode_cut_off_neither_fails_nor_succeeds() -> None:
    account = Account()
    _add(account, Outcome.RUNNING, 0.2, success=False)
    assert (account.episodes, account.failures, account.successes) == (1, 0, 0)
    assert not account.first_success.succeeded


@pytest.mark.parametrize(
    ("budget", "within"),
    [
        (Budget(seconds=12), False),
        (Budget(seconds=12.1), True),
        (Budget(episodes=2), False),
        (Budget(episodes=3), True),
        (Budget(successes=1), False),
        (Budget(seconds=100, successes=2), True),
        (Budget(seconds=100, episodes=100, successes=1), False),
    ],
)
def test_whichever_ends_first_ends_it(budget: Budget, within: bool) -> None:
    account = Account()
    _add(account, Outcome.FAILED, 2, success=False)
    _add(account, Outcome.SUCCEEDED, 10, success=True)
    assert account.within(budget) is within


def test_the_time_limit_succeeds_by_the_rules_of_the_domain() -> None:
    """The linear system lasts for 5 ticks; of its reward a return of 1 is never reached."""
    sim = LinearSystem([[1.0]], [[1.0]], time_limit=5.0)
    state, outcome = torch.zeros(3, 1), torch.tensor([int(Outcome.TIMED_OUT)] * 3)
    ticks, one = torch.tensor([5, 3, 5]), torch.eye(1, dtype=torch.float64)
    account, strict = Account(), Account()
    pay(account, World(sim), state, outcome, ticks)
    # The second one was cut off.
    assert (account.episodes, account.successes, account.failures) == (3, 2, 0)
    assert (account.seconds, account.first) == (13.0, (0, 0.0))
    pay(
        strict,
        World(sim, reward=QuadraticReward(one, one), success_return=1.0),
        state,
        outcome,
        ticks,
    )
    assert (strict.episodes, strict.successes, strict.first) == (3, 0, None)
