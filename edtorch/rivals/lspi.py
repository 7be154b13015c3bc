"""Least-squares policy iteration on recorded transitions (Lagoudakis & Parr, JMLR 4, 2003).

Q(s, a) = w_a . phi(s), one block of weights for each of a few actions.  LSTDQ finds the fixed point
of the projected Bellman equation of a policy from any transitions of the world; the policy that is
greedy for it is the next one, on the same transitions, until it stays the same.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from edtorch.linalg import matvec
from edtorch.model.features import FeatureMap
from edtorch.rivals.base import AccountedSearch, Problem
from edtorch.rivals.batch import (
    BatchSettings,
    Transitions,
    action_set,
    check_at_least,
    check_rewards,
    choices,
    collect,
    concatenated,
    rewards,
)
from edtorch.types import Parameters
from sims.base import Spec

OPPOSITE = "~"


@dataclass(frozen=True)
class Lspi(BatchSettings):
    """Further settings of LSPI.

    episodes: how many each seed has made when it finds a policy, in rising order; iterations: of
    policy iteration at most, should it not settle; ridge: added to the diagonal of the mean of
    phi (phi - discount phi')', above 0 so that an action never taken has a value, 0.

    basis: phi, each a product of components of the scaled state by name, [] being 1;
    ``~name`` is the opposite of an angle: half a turn less the angle, with the angle's sign.
    None: all products of up to two components.
    """

    episodes: list[int] = field(default_factory=lambda: [250, 500, 1000, 2500, 5000])
    iterations: int = 30
    ridge: float = 1e-9
    basis: list[list[str]] = field(default_factory=list)

    def __post_init__(self) -> None:
        """Refuse impossible arguments."""
        super().__post_init__()
        check_at_least("iterations", self.iterations, 1)
        if not self.ridge > 0:
            raise ValueError(f"ridge={self.ridge}: expected a number > 0")
        rising = [1, *self.episodes]
        if not self.episodes or any(b < a for a, b in zip(rising, self.episodes, strict=False)):
            raise ValueError(f"episodes={self.episodes}: expected rising integers >= 1")
        if len({tuple(sorted(term)) for term in self.basis}) != len(self.basis):
            raise ValueError(f"basis={self.basis}: expected different products")

    def begin(self, problem: Problem) -> LspiSearch:
        """Raises ValueError, which names the setting, for a problem that it cannot take."""
        return LspiSearch(self, problem)


class Monomials(FeatureMap):
    """phi(x) = products of components of x, of opposites of angles, and 1.

    place ``[k, d]`` int64: the factors of each product, in (x, opposites of x, 1); period ``[n]``,
    0 for what is no angle.
    """

    place: Tensor
    half_turn: Tensor

    def __init__(self, place: Tensor, period: Tensor) -> None:
        super().__init__(len(period), len(place))
        self.register_buffer("place", place, persistent=False)
        self.register_buffer("half_turn", period / 2, persistent=False)

    def forward(self, x: Tensor) -> Tensor:
        """``[*batch, n] -> [*batch, k]``."""
        opposite = x.sign() * self.half_turn - x
        factors = torch.cat([x, opposite, torch.ones_like(x[..., :1])], dim=-1)
        return factors[..., self.place].prod(-1)


def monomials(basis: Sequence[Sequence[str]], spec: Spec, period: Tensor) -> Monomials:
    """The basis by names; see ``Lspi``.  Raises ValueError, which names the setting."""
    names = [q.name for q in spec.state]
    known = {name: place for place, name in enumerate(names)}
    known |= {f"{OPPOSITE}{q.name}": len(names) + k for k, q in enumerate(spec.state) if q.period}
    if not basis:
        terms = [[], *([a] for a in names)]
        terms += [[a, b] for k, a in enumerate(names) for b in names[k:]]
    else:
        terms = [list(term) for term in basis]
    for number, term in enumerate(terms):
        for name in term:
            if name not in known:
                raise ValueError(f"basis[{number}]={term}: expected names of {', '.join(known)}")
    one = 2 * len(names)
    degree = max(1, *(len(term) for term in terms))
    place = [[known[name] for name in term] + [one] * (degree - len(term)) for term in terms]
    return Monomials(torch.tensor(place, device=period.device), period)


@dataclass(frozen=True)
class GreedyLinear:
    """The policy that takes the best of ``actions`` ``[A, m]``, the first among equals."""

    basis: FeatureMap
    actions: Tensor

    def action(self, parameters: Parameters, observation: Tensor, /) -> Tensor:
        """With ``weight`` ``[*batch, A, k]``."""
        values = matvec(parameters["weight"], self.basis(observation))
        return self.actions[values.argmax(-1)]


def lstdq(
    features: Tensor, following: Tensor, reward: Tensor, discount: float, ridge: float
) -> Tensor:
    """Weights ``[k]`` of the value function of a policy.

    features ``[N, k]`` of (s, a), following ``[N, k]`` of (s', pi(s')), zero where nothing follows;
    reward ``[N]``.  They solve (mean of f (f - discount f')' + ridge 1) w = mean of f r
    (LSTDQ, its sums divided by N).
    """
    matrix = features.T @ (features - discount * following) / len(features)
    matrix.diagonal().add_(ridge)
    return torch.linalg.solve(matrix, features.T @ reward / len(features))


@dataclass(frozen=True)
class Solution:
    """weight ``[A, k]``; iterations: how many it took; settled: whether another one would have
    changed nothing."""

    weight: Tensor
    iterations: int
    settled: bool


def policy_iteration(
    basis: FeatureMap,
    data: Transitions,
    choice: Tensor,
    reward: Tensor,
    actions: int,
    settings: Lspi,
    pause: Callable[[], None],
) -> Solution:
    """From the policy that always takes the first action (weights 0) to one that is greedy for its
    own value; choice ``[N]``: number of the action taken; actions: how many there are."""
    here = _blocks(basis(data.state), choice, actions)
    there = basis(data.next_state)
    weight = there.new_zeros(actions, basis.outputs)
    greedy = (there @ weight.T).argmax(-1)
    lasting = ~data.terminated[:, None]
    for iteration in range(1, settings.iterations + 1):
        pause()
        following = _blocks(there, greedy, actions) * lasting
        found = lstdq(here, following, reward, settings.discount, settings.ridge)
        weight = found.unflatten(0, weight.shape)
        before, greedy = greedy, (there @ weight.T).argmax(-1)
        if bool((greedy == before)[~data.terminated].all()):
            return Solution(weight, iteration, True)
    return Solution(weight, settings.iterations, False)


def _blocks(features: Tensor, choice: Tensor, actions: int) -> Tensor:
    """``[N, A k]``: the features ``[N, k]`` in the block of the action chosen, zero elsewhere."""
    spread = features.new_zeros(len(features), actions, features.shape[-1])
    spread[torch.arange(len(features)), choice] = features
    return spread.flatten(1)


class LspiSearch(AccountedSearch):
    """One record and one policy per seed."""

    def __init__(self, settings: Lspi, problem: Problem) -> None:
        super().__init__(problem)
        world = problem.world
        check_rewards(settings, world.spec)
        self._settings = settings
        self._world = world
        self._seeds = list(problem.seeds)
        actions = action_set(settings, world)
        basis = monomials(settings.basis, world.spec, world.period)
        self.actor = GreedyLinear(basis, actions)
        self.solutions: list[Solution | None] = [None for _ in self._seeds]
        self._stage = [0 for _ in self._seeds]
        self._data: list[Transitions | None] = [None for _ in self._seeds]
        self._weight = actions.new_zeros(len(self._seeds), len(actions), basis.outputs)

    @property
    def parameters(self) -> Parameters:
        """See ``Search``."""
        return {"weight": self._weight}

    @property
    def done(self) -> list[bool]:
        """See ``Search``."""
        return [stage == len(self._settings.episodes) for stage in self._stage]

    def state(self) -> dict[str, Any]:
        """See ``Resumable``."""
        return {
            **super().state(),
            "stage": list(self._stage),
            "data": [None if own is None else dict(vars(own)) for own in self._data],
            "solutions": [None if own is None else dict(vars(own)) for own in self.solutions],
        }

    def restore(self, state: Mapping[str, Any]) -> None:
        """See ``Resumable``."""
        super().restore(state)
        self._stage = list(state["stage"])
        self._data = [None if own is None else Transitions(**own) for own in state["data"]]
        self.solutions = [None if own is None else Solution(**own) for own in state["solutions"]]
        for row, solution in enumerate(self.solutions):
            if solution is not None:
                self._weight[row] = solution.weight

    def advance(self, going: Sequence[bool], pause: Callable[[], None]) -> None:
        """As many episodes more as the next policy is to have, and that policy."""
        for row in (row for row, on in enumerate(going) if on):
            data = self._collected(row, pause)
            self._solve(row, data, pause)
            self._data[row] = data
            self._stage[row] += 1

    def _collected(self, row: int, pause: Callable[[], None]) -> Transitions:
        """The transitions of a seed, with those of the episodes of this stage added."""
        stages = [0, *self._settings.episodes]
        stage = self._stage[row]
        fresh = collect(
            self._world,
            self.actor.actions,
            seed=self._seeds[row],
            episodes=range(stages[stage], stages[stage + 1]),
            steps=self._settings.steps,
            account=self.accounts[row],
            pause=pause,
        )
        before = self._data[row]
        return fresh if before is None else concatenated([before, fresh])

    def _solve(self, row: int, data: Transitions, pause: Callable[[], None]) -> None:
        actions = self.actor.actions
        solution = policy_iteration(
            self.actor.basis,
            data,
            choices(actions, data.action),
            rewards(self._settings, self._world.spec, data),
            len(actions),
            self._settings,
            pause,
        )
        self.solutions[row] = solution
        self._weight[row] = solution.weight
