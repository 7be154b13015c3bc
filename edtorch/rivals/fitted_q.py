"""Fitted Q iteration with extremely randomised trees (Ernst, Geurts & Wehenkel, JMLR 6, 2005).

Q_k is a regression of reward + discount max_a' Q_{k-1}(s', a') on (s, a), over the same recorded
transitions every time; the policy is greedy for the last one.  The trees are scikit-learn's.
"""

from __future__ import annotations

import importlib
import importlib.util
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from types import ModuleType
from typing import Any

import numpy as np
import torch
from torch import Tensor

from edtorch.rivals.base import AccountedSearch, Problem
from edtorch.rivals.batch import (
    BatchSettings,
    Transitions,
    action_set,
    check_at_least,
    check_rewards,
    collect,
    rewards,
)
from edtorch.types import Parameters

ROWS = 65_536
"""Rows that go through the trees at a time, so that memory does not grow with the record."""


@dataclass(frozen=True)
class FittedQ(BatchSettings):
    """Further settings of fitted Q iteration.

    episodes: recorded before anything is learned; iterations: of Q; rebuilt: the number of first
    iterations that build new trees; later ones keep the last splits and update the values at the
    leaves, which makes them a contraction; null: all; every: iterations between evaluations; trees:
    of each regression; smallest: transitions that a node must hold to be split (n_min).  Each split
    is the best of one random cut of every input (K = all).
    """

    episodes: int = 300
    iterations: int = 150
    rebuilt: int | None = None
    every: int = 50
    trees: int = 50
    smallest: int = 4

    def __post_init__(self) -> None:
        """Refuse impossible arguments."""
        super().__post_init__()
        for name in ("episodes", "iterations", "every", "trees"):
            check_at_least(name, getattr(self, name), 1)
        if self.rebuilt is not None:
            check_at_least("rebuilt", self.rebuilt, 1)
        check_at_least("smallest", self.smallest, 2)

    def begin(self, problem: Problem) -> FittedQSearch:
        """Raises ValueError, which names the setting, for a problem that it cannot take."""
        trees()
        return FittedQSearch(self, problem)


def trees() -> ModuleType:
    """scikit-learn's ensembles.  Raises ValueError where it is not installed."""
    if importlib.util.find_spec("sklearn") is None:
        raise ValueError(
            "fitted Q iteration needs scikit-learn: install edtorch with the extra [rivals]"
        )
    return importlib.import_module("sklearn.ensemble")


@dataclass(frozen=True)
class Forest:
    """Regression trees of one output: splits of scikit-learn's trees, and values of their leaves.

    trees: T compiled trees; first ``[T + 1]`` int64: where in ``value`` ``[M]`` (float64) the nodes
    of each begin.
    """

    trees: list[Any]
    first: np.ndarray
    value: np.ndarray

    def leaves(self, inputs: np.ndarray) -> np.ndarray:
        """Places in ``value`` of the leaves ``[T, N]`` for inputs ``[N, d]`` (float32)."""
        # Their own method: the forest's predict checks its inputs for longer than this takes.
        places = [t.apply(inputs) + f for t, f in zip(self.trees, self.first, strict=False)]
        return np.stack(places)

    def predict(self, inputs: np.ndarray) -> np.ndarray:
        """The mean of the trees, ``[N]``."""
        parts = range(0, len(inputs), ROWS)
        pieces = (self.leaves(inputs[k : k + ROWS]) for k in parts)
        return np.concatenate([self.value[places].mean(0) for places in pieces])

    def column(self, name: str) -> np.ndarray:
        """An attribute of all nodes, ``[M]``."""
        return np.concatenate([getattr(tree, name) for tree in self.trees])


def grown(regression: Any) -> Forest:
    """The trees of a fitted scikit-learn forest."""
    trees = [tree.tree_ for tree in regression.estimators_]
    first = np.cumsum([0, *(tree.node_count for tree in trees)])
    return Forest(trees, first, np.concatenate([tree.value[:, 0, 0] for tree in trees]))


def _pairs(state: Tensor, actions: Tensor) -> np.ndarray:
    """Every state ``[N, n]`` with every action ``[A, m]``, ``[N A, n + m]`` in float32."""
    rows = state[:, None].expand(-1, len(actions), -1)
    columns = actions.expand(len(state), -1, -1)
    return torch.cat((rows, columns), -1).flatten(0, 1).to(torch.float32).numpy()


class Iteration:
    """Q_0 = 0, and Q_1, Q_2, ... of one record.

    reward ``[N]``; actions ``[A, m]``: those that a policy chooses from; seed: of the trees.
    """

    data: Transitions

    def __init__(
        self, settings: FittedQ, data: Transitions, reward: Tensor, actions: Tensor, seed: int
    ) -> None:
        self._settings = settings
        self._seed = seed
        self.data = data
        self._reward = reward.to(torch.float64).numpy()
        self._here = torch.cat((data.state, data.action), -1).to(torch.float32).numpy()
        # What follows an end is worth nothing, and need not be predicted.
        lasting = ~data.terminated
        self._lasting = lasting.numpy()
        self._there = _pairs(data.next_state[lasting], actions)
        self._actions = len(actions)
        self._next_value = np.zeros(int(lasting.sum()))
        self._made_of: list[tuple[int, np.ndarray]] = []
        self._places: tuple[np.ndarray, np.ndarray] | None = None
        self.count = 0
        self.forest: Forest | None = None

    @property
    def targets(self) -> np.ndarray:
        """What the next Q is to be at each transition, ``[N]``."""
        targets = self._reward.copy()
        targets[self._lasting] += self._settings.discount * self._next_value
        return targets

    def advance(self) -> None:
        """The next Q."""
        building, before = self._settings.rebuilt, (self.count, self._next_value)
        self.count += 1
        if self.forest is None or building is None or self.count <= building:
            self.forest, self._places = self._built(), None
            self._made_of = [before]
            values = self.forest.predict(self._there)
        else:
            self.forest, values = self._renewed(self.forest)
            self._made_of = [self._made_of[0], before]
        self._next_value = values.reshape(-1, self._actions).max(-1)

    def state(self) -> list[dict[str, Any]]:
        """What the last Q was made of, for ``restore``: where its trees were built and, if they
        were, their leaves renewed.  The trees themselves are hundreds of times larger."""
        return [{"count": count, "next_value": value} for count, value in self._made_of]

    def restore(self, state: Sequence[Mapping[str, Any]]) -> None:
        """Make the last Q again, which takes as long as one or two calls of ``advance``."""
        for before in state:
            self.count, self._next_value = before["count"], before["next_value"]
            self.advance()

    def _built(self) -> Forest:
        drawn = np.random.SeedSequence([self._seed, self.count]).generate_state(1)
        regression = trees().ExtraTreesRegressor(
            n_estimators=self._settings.trees,
            min_samples_split=self._settings.smallest,
            random_state=int(drawn[0]),
            n_jobs=1,
        )
        return grown(regression.fit(self._here, self.targets))

    def _renewed(self, forest: Forest) -> tuple[Forest, np.ndarray]:
        """The same trees, at their leaves the means of the targets, and what follows by them."""
        if self._places is None:
            # int32: the leaves of all that can follow are most of the memory.
            whole = [forest.leaves(inputs) for inputs in (self._here, self._there)]
            self._places = whole[0].astype(np.int32), whole[1].astype(np.int32)
        here, there = self._places
        size, targets = len(forest.value), self.targets
        total, count = np.zeros(size), np.zeros(size)
        for places in here:
            total += np.bincount(places, targets, size)
            count += np.bincount(places, minlength=size)
        forest = replace(forest, value=total / np.maximum(count, 1))
        values = np.zeros(there.shape[1])
        for places in there:
            values += forest.value[places]
        return forest, values / len(there)


class GreedyForest:
    """The policies that take the best of ``actions`` ``[A, m]``, the first among equals.

    Forests differ in size and are large: the parameters say ``which`` one, and here they are.
    """

    def __init__(self, actions: Tensor, forests: list[Forest | None]) -> None:
        self._actions = actions
        self._forests = forests

    def action(self, parameters: Parameters, observation: Tensor, /) -> Tensor:
        """With ``which`` ``[*batch]``; a policy without a forest takes the first action."""
        chosen = torch.zeros(len(observation), dtype=torch.int64)
        which = parameters["which"]
        for number in which.unique().tolist():
            forest = self._forests[number]
            if forest is not None:
                own = which == number
                values = forest.predict(_pairs(observation[own], self._actions))
                best = values.reshape(-1, len(self._actions)).argmax(-1)
                chosen[own] = torch.from_numpy(best)
        return self._actions[chosen]


class FittedQSearch(AccountedSearch):
    """One record and one Q per seed."""

    def __init__(self, settings: FittedQ, problem: Problem) -> None:
        super().__init__(problem)
        check_rewards(settings, problem.world.spec)
        self._settings = settings
        self._world = problem.world
        self._seeds = list(problem.seeds)
        self._actions = action_set(settings, problem.world)
        self._forests: list[Forest | None] = [None for _ in self._seeds]
        self._iterations: list[Iteration | None] = [None for _ in self._seeds]
        self.actor = GreedyForest(self._actions, self._forests)

    @property
    def parameters(self) -> Parameters:
        """See ``Search``: which of the actor's forests."""
        return {"which": torch.arange(len(self._seeds))}

    def stored(self) -> Parameters:
        """The forests themselves (``edtorch.rivals.base.Storing``): the nodes of all trees of all
        seeds one after the other, ``first`` ``[S, T]`` of each tree; left and right are counted
        from there, and -1 at a leaf; at most the threshold goes left.  Nothing before there are
        any."""
        forests = [forest for forest in self._forests if forest is not None]
        if not forests:
            return {}
        sizes = np.cumsum([0, *(len(forest.value) for forest in forests)])
        starts = [forest.first[:-1] + size for forest, size in zip(forests, sizes, strict=False)]
        kinds = {
            "feature": np.int8,
            "threshold": np.float64,
            "children_left": np.int32,
            "children_right": np.int32,
        }
        columns = {
            name: np.concatenate([forest.column(name) for forest in forests]).astype(kind)
            for name, kind in kinds.items()
        }
        columns["value"] = np.concatenate([f.value for f in forests]).astype(np.float32)
        stored = {name: torch.from_numpy(column) for name, column in columns.items()}
        return {**stored, "first": torch.from_numpy(np.stack(starts)), "actions": self._actions}

    @property
    def done(self) -> list[bool]:
        """See ``Search``."""
        return [
            own is not None and own.count >= self._settings.iterations for own in self._iterations
        ]

    def state(self) -> dict[str, Any]:
        """See ``Resumable``."""
        own = [
            None if one is None else {"data": dict(vars(one.data)), "made_of": one.state()}
            for one in self._iterations
        ]
        return {**super().state(), "iterations": own}

    def restore(self, state: Mapping[str, Any]) -> None:
        """See ``Resumable``; takes as long as one iteration or two."""
        super().restore(state)
        for row, own in enumerate(state["iterations"]):
            if own is not None:
                iteration = self._on(row, Transitions(**own["data"]))
                iteration.restore(own["made_of"])
                self._iterations[row], self._forests[row] = iteration, iteration.forest

    def advance(self, going: Sequence[bool], pause: Callable[[], None]) -> None:
        """The record first, then some iterations of Q."""
        for row in (row for row, on in enumerate(going) if on):
            iteration = self._iterations[row] or self._begun(row, pause)
            self._iterations[row] = iteration
            last = min(iteration.count + self._settings.every, self._settings.iterations)
            while iteration.count < last:
                iteration.advance()
                pause()
            self._forests[row] = iteration.forest

    def _begun(self, row: int, pause: Callable[[], None]) -> Iteration:
        data = collect(
            self._world,
            self._actions,
            seed=self._seeds[row],
            episodes=range(self._settings.episodes),
            steps=self._settings.steps,
            account=self.accounts[row],
            pause=pause,
        )
        return self._on(row, data)

    def _on(self, row: int, data: Transitions) -> Iteration:
        """Q_0 of a seed with this record."""
        reward = rewards(self._settings, self._world.spec, data)
        return Iteration(self._settings, data, reward, self._actions, self._seeds[row])
