"""What a rival has paid, beside what the learner's own records say of the same episodes."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from edtorch.report.statistics import first_success
from edtorch.rivals.ledger import Account
from edtorch.run.episodes import RIDES, Budget, Episode
from sims.base import Outcome

ENDS = st.lists(st.tuples(st.sampled_from(list(Outcome)[1:]), st.integers(1, 1000)), max_size=8)


@given(ENDS, st.integers(0, 100))
def test_the_first_success_is_that_of_the_learners_records(
    ends: list[tuple[Outcome, int]], more: int
) -> None:
    """The second way: episodes kept, and looked through in the end."""
    account, kept, start = Account(), [], 0.0
    for number, (outcome, seconds) in enumerate(ends):
        account.add(outcome, seconds)
        kept.append(Episode(0, number, start, seconds, outcome, {}, success=outcome in RIDES))
        start += seconds
    account.spend(more)
    assert account.first_success == first_success(kept, start + more)
    assert account.episodes == len(ends)
    assert account.falls == sum(outcome is Outcome.FAILED for outcome, _ in ends)
    assert account.seconds == start + more


def test_an_episode_cut_off_is_neither_fall_nor_ride() -> None:
    account = Account()
    account.add(Outcome.RUNNING, 0.2)
    assert (account.episodes, account.falls, account.rides) == (1, 0, 0)
    assert not account.first_success.succeeded


@pytest.mark.parametrize(
    ("budget", "within"),
    [
        (Budget(seconds=12), False),
        (Budget(seconds=12.1), True),
        (Budget(episodes=2), False),
        (Budget(episodes=3), True),
        (Budget(rides=1), False),
        (Budget(seconds=100, rides=2), True),
        (Budget(seconds=100, episodes=100, rides=1), False),
    ],
)
def test_whichever_ends_first_ends_it(budget: Budget, within: bool) -> None:
    account = Account()
    account.add(Outcome.FAILED, 2)
    account.add(Outcome.SUCCEEDED, 10)
    assert account.within(budget) is within
