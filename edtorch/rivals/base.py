"""What a rival is: settings that begin a search for policies, and a search that pays as it goes.

A rival is one file with a frozen dataclass of settings, which ``conf/rival/`` names.  The command
drives every one of them alike: it asks for a piece of work, tries the policies that there are then
in fresh episodes, which cost no experience, and stops the seeds that have used up their budget.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Protocol, cast, runtime_checkable

from torch import Tensor

from edtorch.learner.learner import Actor
from edtorch.native.choice import Mode
from edtorch.policy.policies import LinearPolicy
from edtorch.rewards import QuadraticReward, Reward
from edtorch.rivals.ledger import Account
from edtorch.run.scaled_sim import World
from edtorch.types import Parameters


@dataclass(frozen=True)
class Problem:
    """The problem that a rival solves.

    world: the sim in scaled units, for any number of episodes at a time; policy: the configured
    linear policy, a template for rivals that search linear policies; reward: the shaping reward,
    scaled, weights of squares alone unless the rival ``takes_any_reward``; seeds: one search each,
    which depends on its seed alone; native: whether kernels are used.
    """

    world: World
    policy: LinearPolicy
    reward: Reward
    seeds: Sequence[int]
    native: Mode

    @property
    def weights(self) -> QuadraticReward:
        """The reward of a rival that does not take any."""
        return cast(QuadraticReward, self.reward)


@runtime_checkable
class Search(Protocol):
    """One running search per seed."""

    accounts: list[Account]
    """Cost of each seed so far."""

    @property
    def actor(self) -> Actor:
        """The policy that takes the parameters below, without exploration."""
        ...

    @property
    def parameters(self) -> Parameters:
        """The current policies, each tensor ``[S, ...]``."""
        ...

    @property
    def done(self) -> list[bool]:
        """For each seed, whether the method has ended, regardless of the budget."""
        ...

    def advance(self, going: Sequence[bool], pause: Callable[[], None]) -> None:
        """Work for each seed that is ``going``, up to the next evaluation of the policies.

        ``pause`` is called about every second; an exception from it ends the search.
        """
        ...


@runtime_checkable
class Resumable(Protocol):
    """A search that holds its state.

    A new search of the same settings and problem does, once it has been given the state, what the
    first one would have done from there, digit by digit.
    """

    def state(self) -> dict[str, Any]:
        """Everything that its future depends on, between two calls of ``advance``, as
        ``edtorch.run.state_file`` takes it; the next call may change its tensors."""
        ...

    def restore(self, state: Mapping[str, Any]) -> None:
        """Go on from such a state."""
        ...


class AccountedSearch:
    """Common part of searches that are ``Resumable``: the accounts."""

    def __init__(self, problem: Problem) -> None:
        self.accounts = [Account() for _ in problem.seeds]

    def state(self) -> dict[str, Any]:
        """See ``Resumable``; of the accounts."""
        return {"accounts": [account.state() for account in self.accounts]}

    def restore(self, state: Mapping[str, Any]) -> None:
        """See ``Resumable``; the accounts."""
        self.accounts = [Account.of(own) for own in state["accounts"]]


class LinearSearch(AccountedSearch):
    """Common part of searches for a linear policy: ``_weight`` ``[S, ...]``."""

    _weight: Tensor

    def __init__(self, problem: Problem) -> None:
        super().__init__(problem)
        self._policy = problem.policy

    def state(self) -> dict[str, Any]:
        """See ``Resumable``."""
        return {**super().state(), "weight": self._weight}

    def restore(self, state: Mapping[str, Any]) -> None:
        """See ``Resumable``."""
        super().restore(state)
        self._weight = state["weight"].clone()

    @property
    def actor(self) -> Actor:
        """The policy, without exploration."""
        return self._policy

    @property
    def parameters(self) -> Parameters:
        """Weights ``[S, m, k]``, scaled."""
        own = self._policy.weight
        return {"weight": self._weight.reshape(-1, *own.shape).to(own.dtype, copy=True)}


@runtime_checkable
class Storing(Protocol):
    """A search whose parameters are only references to the data of its policies."""

    def stored(self) -> Parameters:
        """That data, to be saved instead."""
        ...


class Rival(Protocol):
    """The settings of a rival; ``takes_any_reward = True`` if it does, and not weights alone."""

    def begin(self, problem: Problem) -> Search:
        """Raises ValueError, which names the setting, for an unsuitable problem."""
        ...
