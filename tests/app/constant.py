"""A rival for tests: its policies are known beforehand, and cost what they are said to cost."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import torch

from edtorch.learner.learner import Actor
from edtorch.rivals.base import Problem
from edtorch.rivals.ledger import Account
from edtorch.types import Parameters
from sims.base import Outcome


@dataclass(frozen=True)
class Constant:
    """gain: of the policy from its third piece of work on, a piece later for each seed; pieces:
    that there are; price: seconds of each, an episode that fails."""

    gain: float = -0.5
    pieces: int = 6
    price: float = 2.0

    def __post_init__(self) -> None:
        if self.pieces < 1:
            raise ValueError(f"pieces={self.pieces}: expected an integer >= 1")

    def begin(self, problem: Problem) -> Pieces:
        return Pieces(self, problem)


class Pieces:
    """The search: nothing is searched."""

    def __init__(self, settings: Constant, problem: Problem) -> None:
        self._settings = settings
        self._problem = problem
        self._count = 0
        self.accounts = [Account() for _ in problem.seeds]
        self._weight = torch.zeros(len(problem.seeds), *problem.policy.weight.shape).double()

    @property
    def actor(self) -> Actor:
        return self._problem.policy

    @property
    def parameters(self) -> Parameters:
        return {"weight": self._weight.clone()}

    @property
    def done(self) -> list[bool]:
        return [self._count >= self._settings.pieces] * len(self.accounts)

    def advance(self, going: Sequence[bool], pause: Callable[[], None]) -> None:
        pause()
        self._count += 1
        for k, account in enumerate(self.accounts):
            if going[k]:
                account.spend(self._settings.price)
                account.end(Outcome.FAILED, self._settings.price, success=False)
                if self._count >= 3 + k:
                    self._weight[k] = self._settings.gain
