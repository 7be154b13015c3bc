"""The search for a gait in the walker's own model: its gaits walk in the simulator."""

from __future__ import annotations

from dataclasses import replace

import pytest
import torch

from edtorch.app.build_planned import build_planned
from edtorch.app.compose import compose
from edtorch.errors import NoPlan
from edtorch.model.evidence import Posterior
from edtorch.native.evaluation import evaluate_policies
from edtorch.search import population
from edtorch.search.hybrid_fit import LearnedHybrid
from edtorch.search.knowledge import Knowledge
from edtorch.search.population import PopulationSearch
from edtorch.search.problem import SearchProblem
from edtorch.types import Transition
from tests.search.test_striking import true_model
from tests.walkers import true_ground

pytest.importorskip("cmaes")


@pytest.fixture(autouse=True)
def ground(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(population, "fit_ground", lambda *_: true_ground())


KNOWN = Knowledge(
    readings=[torch.zeros(2, 13).double()],
    actions=[torch.zeros(1, 4).double()],
    valid=[torch.ones(1, dtype=torch.bool)],
)
"""A trial that nothing is learned from."""


STAGE = ("policies=1", "enough=0")
"""A stage that any population passes."""


def built(*overrides: str) -> tuple[PopulationSearch, SearchProblem]:
    setup = build_planned(compose(["experiment=walker", *overrides]))
    assert isinstance(setup.search, PopulationSearch)
    return setup.search, replace(setup.problem, hybrid=known)


def known(transitions: Transition, substeps: int) -> LearnedHybrid:
    model = true_model(substeps)
    weight = torch.from_numpy(model.free.weight)
    cov = torch.zeros(*weight.shape, weight.shape[1]).double()
    return LearnedHybrid(model, Posterior(weight, cov, torch.zeros(len(weight))), 0, 0)


@pytest.mark.oracle
def test_no_gait_is_no_plan() -> None:
    search, problem = built("search.rough.policies=1", "search.attempts=2")
    with pytest.raises(NoPlan, match="no gait of 32 lasts for 3 s in imagination"):
        search.improve(problem, KNOWN, 0, 1)


@pytest.mark.oracle
def test_last_ticks_of_runs_are_not_learned_from() -> None:
    learned: list[Transition] = []

    def told(transitions: Transition, substeps: int) -> LearnedHybrid:
        learned.append(transitions)
        return known(transitions, substeps)

    search, problem = built("search.rough.policies=1", "search.attempts=1")
    knowledge = KNOWN
    for ticks in (3, 2):
        valid = torch.ones(ticks, dtype=torch.bool)
        zeros = torch.zeros(ticks + 1, 13).double()
        knowledge = knowledge.with_trial(zeros, zeros[1:, :4], valid)
    with pytest.raises(NoPlan):
        search.improve(replace(problem, hybrid=told), knowledge, 0, 1)
    assert learned[0].valid.tolist() == [False, True, True, False, True, False]
    assert all(bool(own.all()) for own in knowledge.valid)


@pytest.mark.long
@pytest.mark.oracle
def test_a_policy_linear_in_the_state_is_searched_for_as_a_gait_is() -> None:
    """At its beginning the search's vectors are those that its gait is told to have."""
    stages = (f"search.{name}.{key}" for name in ("rough", "fine", "firm") for key in STAGE)
    search, problem = built("search/gait=linear", "search.attempts=1", *stages)
    policy, _ = search.actor(problem)
    found = search.improve(problem, KNOWN, 0, 1)
    first, drawn = policy.initial([0]), search.explored(problem, [0], 0).parameters
    assert {name: p.shape for name, p in found.parameters.items()} == {
        **{"gain": (4, 10), "constant": (4,)}
    }
    for name, own in found.parameters.items():
        moved = (own - first[name][0]).abs()
        assert 0 < moved.max() < 3 * (drawn[name] - first[name]).abs().max()
    assert found.figures["policies"] == 3 * 16
    again = search.improve(problem, KNOWN, 0, 1)
    assert all(torch.equal(own, again.parameters[name]) for name, own in found.parameters.items())


@pytest.mark.long
def test_a_gait_found_in_the_true_model_walks() -> None:
    search, problem = built()
    found = search.improve(problem, KNOWN, 0, 1)
    assert found.figures["imagined"] > 0.9
    again = replace(search, attempts=1).improve(problem, found.knowledge, 0, 2)
    world = build_planned(compose(["experiment=walker"])).calm()
    parameters = {
        name: torch.stack([found.parameters[name], again.parameters[name]])
        for name in found.parameters
    }
    actor, _ = search.actor(problem)
    episodes = evaluate_policies(actor, parameters, world, [0, 0], 20)
    walked = [sum(bool(each.success) for each in own) for own in episodes]
    assert min(walked) > 16
