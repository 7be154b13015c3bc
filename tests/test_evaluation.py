"""Fresh episodes: reproducible, and independent of what is evaluated beside them."""

from __future__ import annotations

from edtorch.evaluation import evaluate
from edtorch.interact import Training
from edtorch.records import Budget
from edtorch.world import World
from sims.bicycle import Bicycle
from tests.systems import bicycle_training


def run(training: Training) -> Training:
    while not training.done:
        training.advance(100)
    return training


def test_evaluation_is_fresh_reproducible_and_independent_of_its_company() -> None:
    training = run(bicycle_training([0, 1], Budget(seconds=1.0)))
    policy, parameters = training.learner.policy, training.learners.policy

    def lengths(seeds: list[int], episodes: int) -> list[list[float]]:
        rows = {name: p[seeds] for name, p in parameters.items()}
        world = World(Bicycle())
        result = evaluate(policy, rows, world, seeds, episodes)
        assert [len(own) for own in result] == [episodes] * len(seeds)
        return [[e.seconds for e in own] for own in result]

    both = lengths([0, 1], 6)
    assert lengths([1], 6) == [both[1]]
    assert [own[:3] for own in both] == lengths([0, 1], 3)
    assert len(set(both[0])) > 1


def test_no_evaluation_at_all() -> None:
    training = bicycle_training([0, 1], Budget(seconds=1.0))
    policy, parameters = training.learner.policy, training.learners.policy
    assert evaluate(policy, parameters, World(Bicycle()), [0, 1], 0) == [[], []]
