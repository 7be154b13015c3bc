"""Fresh episodes: reproducible, and independent of what is evaluated beside them."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from edtorch.run.episodes import Budget
from edtorch.run.evaluation import evaluate, evaluate_controller
from edtorch.run.random import Purpose, Streams, stream_key
from edtorch.run.scaled_sim import World
from edtorch.run.training import Training
from sims.base import Lasting, Sim
from sims.bicycle import Bicycle
from sims.sensing import Sensed
from tests.systems import bicycle_training


class OneByOne(Bicycle):
    """A simulator of few rows."""

    rows_at_once = 3


BICYCLE = Bicycle()


def run(training: Training) -> Training:
    while not training.done:
        training.advance(100)
    return training


def test_evaluation_is_fresh_reproducible_and_independent_of_its_company() -> None:
    training = run(bicycle_training([0, 1], Budget(seconds=1.0)))
    policy, parameters = training.learner.policy, training.learners.policy

    def lengths(seeds: list[int], episodes: int, sim: Bicycle = BICYCLE) -> list[list[float]]:
        rows = {name: p[seeds] for name, p in parameters.items()}
        world = World(sim)
        result = evaluate(policy, rows, world, seeds, episodes)
        assert [len(own) for own in result] == [episodes] * len(seeds)
        return [[e.seconds for e in own] for own in result]

    both = lengths([0, 1], 6)
    assert lengths([1], 6) == [both[1]]
    assert [own[:3] for own in both] == lengths([0, 1], 3)
    assert lengths([0, 1], 6, OneByOne()) == both
    assert len(set(both[0])) > 1


def test_only_the_first_ticks() -> None:
    training = bicycle_training([0, 1], Budget(seconds=1.0))
    policy, parameters = training.learner.policy, training.learners.policy
    whole: list[Tensor] = []
    begun: list[Tensor] = []
    given = policy, parameters, World(DRAWN), [0, 1], 2
    found = evaluate(*given, watch=whole.append)
    assert evaluate(*given, watch=begun.append, ticks=5) == [[], []]
    assert min(e.seconds for own in found for e in own) > 5 * DRAWN.spec.dt
    assert len(begun) == 5 and all(map(torch.equal, begun, whole[:5]))


def test_no_evaluation_at_all() -> None:
    training = bicycle_training([0, 1], Budget(seconds=1.0))
    policy, parameters = training.learner.policy, training.learners.policy
    assert evaluate(policy, parameters, World(Bicycle()), [0, 1], 0) == [[], []]


DRAWN = Bicycle(spread=0.3, time_limit=0.5)


@pytest.mark.parametrize(
    ("learned_in", "tried_in"),
    [
        (DRAWN, DRAWN),
        (Sensed(DRAWN, {"lean": 0.01}, 1), Sensed(DRAWN, {"lean": 0.01}, 1)),
        # Other weather and other starts, the same bicycle.
        (Bicycle(spread=0.3, gust=10.0), DRAWN),
        (DRAWN, Bicycle(spread=0.3, gust=10.0, start_lean=0.1, time_limit=0.5)),
    ],
    ids=["drawn", "sensed", "no wind", "wind"],
)
def test_a_policy_is_tried_in_the_world_of_its_seed(learned_in: Sim, tried_in: Sim) -> None:
    seeds, episodes = [4, 7, 9], 2
    training = Training(
        bicycle_training([0], Budget(episodes=1)).learner,
        World(learned_in),
        seeds,
        Budget(seconds=1.0),
    )
    assert isinstance(learned_in, Lasting) and isinstance(tried_in, Lasting)
    lasting = list(learned_in.lasting)
    assert lasting == list(tried_in.lasting)
    born = training.worlds.world[:, lasting]
    rows = training.learners.policy
    watched: list[Tensor] = []
    evaluate(training.learner.policy, rows, World(tried_in), seeds, episodes, watch=watched.append)
    assert torch.equal(watched[0][:, lasting], born.repeat_interleave(episodes, dim=0))
    assert torch.equal(watched[-1][:, lasting], watched[0][:, lasting])
    # Its episodes are as different as ever.
    headings = watched[0][:, 5]
    assert len(set(headings.tolist())) == len(headings)


def test_a_world_without_anything_that_lasts_starts_as_ever() -> None:
    world = World(Bicycle(time_limit=0.02))
    keys = [stream_key(s, Purpose.EVALUATION, e) for s in (1, 2) for e in range(2)]
    wanted = world.initial(Streams(keys, world.uniforms, 0).at(0).uniform)
    seen: list[Tensor] = []

    def look(state: Tensor) -> Tensor:
        seen.append(state)
        return torch.zeros(len(state), 2, dtype=torch.float64)

    evaluate_controller(look, world, [1, 2], 2)
    assert torch.equal(seen[0], wanted)
