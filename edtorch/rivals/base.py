"""What a rival is: settings that begin a search for policies, and a search that pays as it goes.

A rival is one file with a frozen dataclass of settings, which ``conf/rival/`` names.  The command
drives every one of them alike: it asks for a piece of work, tries the policies that there are then
in fresh episodes, which cost no experience, and stops the seeds that have used up their budget.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

from torch import Tensor

from edtorch.compiled.compilation import CompileMode
from edtorch.learner.learner import Actor
from edtorch.policy.policies import LinearPolicy
from edtorch.rewards import QuadraticReward
from edtorch.rivals.ledger import Account
from edtorch.run.scaled_sim import World
from edtorch.types import Parameters


@dataclass(frozen=True)
class Problem:
    """What there is to solve.

    world: the sim in scaled units, for any number of episodes at a time; policy: the template of a
    linear policy that the configuration names, for rivals that search among such; reward: the
    shaping reward, scaled; seeds: one search each, which depends on nothing but its seed;
    compile: whether to compile.
    """

    world: World
    policy: LinearPolicy
    reward: QuadraticReward
    seeds: Sequence[int]
    compile: CompileMode


@runtime_checkable
class Search(Protocol):
    """One search per seed, begun and under way."""

    accounts: list[Account]
    """What each seed has paid."""

    @property
    def actor(self) -> Actor:
        """What acts with the parameters below: no exploration."""
        ...

    @property
    def parameters(self) -> Parameters:
        """The policies of now, each tensor ``[S, ...]``."""
        ...

    @property
    def done(self) -> list[bool]:
        """Of each seed, whether the rival itself is at its end, whatever the budget."""
        ...

    def advance(self, going: Sequence[bool], pause: Callable[[], None]) -> None:
        """A piece of work for each seed that is ``going``, as long as one likes policies to be
        tried after; ``pause`` is called every second or so, and what it raises ends the search."""
        ...


class LinearSearch:
    """What searches for a linear policy share: accounts, and ``_weight`` ``[S, ...]``."""

    _weight: Tensor

    def __init__(self, problem: Problem) -> None:
        self._policy = problem.policy
        self.accounts = [Account() for _ in problem.seeds]

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
    """A search whose parameters are only a reference to what its policies are made of."""

    def stored(self) -> Parameters:
        """All that they are made of, to be saved instead."""
        ...


class Rival(Protocol):
    """The settings of a rival."""

    def begin(self, problem: Problem) -> Search:
        """Raises ValueError, which names the setting, for a problem that it cannot take."""
        ...
