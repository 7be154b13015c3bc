"""Learning from recorded transitions: exact where it is known, and the same as ``Learner.step``."""

from __future__ import annotations

import json
from dataclasses import astuple
from dataclasses import replace as with_fields
from typing import Any

import numpy as np
import pytest
import torch

from edtorch.learner.schedule import Schedule
from edtorch.model.fit import (
    AbsoluteError,
    NormalisedSquaredError,
    RecursiveLeastSquares,
    SquaredError,
)
from edtorch.model.fit_adaptive import AdaptiveLeastSquares
from edtorch.model.fit_decaying import DecayingFit
from edtorch.model.fit_gradient import GradientFit
from edtorch.model.fit_ridge import Ridge
from edtorch.model.noise import BayesianNoise, LinearNoise, ResidualNoise
from edtorch.policy.steps import DecayingStep, FullStep, PlainStep, SaturatedStep
from edtorch.rewards import QuadraticReward
from edtorch.run.episodes import Budget
from edtorch.run.offline import Lessons, Offline, Unused
from edtorch.run.scaled_sim import World
from edtorch.run.transitions_file import Recorded
from edtorch.transform import FirstOrder
from edtorch.types import LearnerState, Transition
from edtorch.value.choose import choose_path
from edtorch.value.linear.lqr import stationary_lqr
from edtorch.value.unroll import FromOrigin, Horizon
from sims.base import Outcome
from sims.bicycle import Bicycle
from sims.linear import LinearSystem
from tests.recorded import F, G, Q, R, derivative_learner, linear_learner, linear_world, lived
from tests.systems import bicycle_learner, f64

ALL = Budget(seconds=1e9)
SEEDS = [3, 4, 5]
WORLD = linear_world()
NOISY = linear_world(0.1)
_, EXACT = lived(WORLD, linear_learner(), SEEDS, 60.0)
_, DATA = lived(NOISY, linear_learner(), SEEDS, 60.0)


SHUFFLED = Lessons("own", "shuffled", 2)
FAST = LinearSystem(F, G, dt=0.01)


def learned(offline: Offline, steps: int = 20) -> LearnerState:
    for _ in offline.learn(steps, 7):
        pass
    return offline.learners


def test_a_system_without_noise_is_found_and_so_is_its_regulator() -> None:
    """W = [F G] to rounding, theta that of the infinite horizon, by another algorithm."""
    offline = Offline(linear_learner(), WORLD, EXACT, SEEDS, Lessons(), ALL)
    state = learned(offline)
    truth = torch.cat([f64(F), f64(G)], dim=-1)
    torch.testing.assert_close(state.model["weight"], truth.expand(3, 2, 3), rtol=0, atol=1e-9)
    theta, _ = stationary_lqr(f64(F), f64(G), Q, R)
    torch.testing.assert_close(state.policy["weight"], theta.expand(3, 1, 2), rtol=0, atol=1e-7)
    # The way there is one step; the second finds that it is there.
    assert offline.steps.tolist() == [2, 2, 2] and not bool(offline.moving.any())
    assert offline.experience == [60.0] * 3 and bool(offline.finite.all())


@pytest.mark.oracle
def test_the_gradient_climbs_to_the_top() -> None:
    """Where a policy has arrived, its gradient is zero, and no other policy near by is better."""
    learner = linear_learner()
    model, policy = learner.model, learner.policy
    horizon, noise_free = Horizon(6, 1.0, 1.0, 1.0), torch.eye(2).double()
    path = choose_path(
        "auto",
        model,
        policy,
        QuadraticReward(Q, R),
        FirstOrder(),
        horizon,
        noise=None,
        start_cov=noise_free,
    ).path
    learner = with_fields(learner, value=FromOrigin(path), step_rule=PlainStep(0.3))
    offline = Offline(learner, WORLD, EXACT, SEEDS, Lessons(), ALL, tolerance=1e-8)
    state = learned(offline, 4000)
    assert not bool(offline.moving.any())
    assert all(2 < steps < 4000 for steps in offline.steps.tolist())
    origin = torch.zeros(3, 2).double()
    top = learner.value(state.model, state.policy, state.noise, origin)
    assert float(top.gradient["weight"].abs().max()) < 1e-5
    for shift in ([0.05, 0.0], [-0.05, 0.0], [0.0, 0.05], [0.0, -0.05]):
        moved = {"weight": state.policy["weight"] + f64([shift])}
        assert bool(
            (learner.value(state.model, moved, state.noise, origin).value < top.value).all()
        )


def test_it_is_learner_step_fed_with_the_rows() -> None:
    """To the last digit, learner by learner, whatever the others' lengths, improving or not."""
    for schedule in (None, Schedule(first=5, every=3)):
        learner = linear_learner()
        budgets = {3: Budget(seconds=60.0), 4: Budget(episodes=3), 5: Budget(seconds=11.0)}
        for row, (seed, budget) in enumerate(budgets.items()):
            offline = Offline(learner, NOISY, DATA, [seed], Lessons(), budget, schedule=schedule)
            while not offline.all_seen:
                offline.advance(10)
            state = learner.initial([seed])
            rows = np.flatnonzero(DATA.seed == seed)[: [60, 24, 11][row]]
            for tick, k in enumerate(rows, start=1):
                s, a, after = (
                    torch.from_numpy(part[k : k + 1])
                    for part in (DATA.state, DATA.action, DATA.next_state)
                )
                valid = torch.ones(1, dtype=torch.bool)
                transition = Transition(s, a, after, NOISY.seconds, valid)
                improve = schedule is not None and schedule.improves(tick)
                state, _ = learner.step(state, transition, improve=improve)
            assert torch.equal(offline.learners.model["weight"], state.model["weight"])
            assert torch.equal(offline.learners.policy["weight"], state.policy["weight"])
            assert offline.learners.tick.tolist() == [len(rows)]


def test_a_population_equals_its_members() -> None:
    lessons = Lessons("bootstrap", "shuffled", 2)
    together = learned(Offline(linear_learner(), NOISY, DATA, SEEDS, lessons, ALL))
    for row, seed in enumerate(SEEDS):
        alone = learned(Offline(linear_learner(), NOISY, DATA, [seed], lessons, ALL))
        assert torch.equal(alone.model["weight"][0], together.model["weight"][row])
        assert torch.equal(alone.policy["weight"][0], together.policy["weight"][row])
    assert not torch.equal(together.model["weight"][0], together.model["weight"][1])


def test_what_a_frozen_policy_lived_through_teaches_the_same_again() -> None:
    """On the bicycle, in physical units and back: the model that was learned online."""
    world = World(Bicycle())
    learner = with_fields(bicycle_learner(world, fit=RecursiveLeastSquares()), exploration=1.0)
    training, data = lived(world, learner, [1, 2], 5.0)
    offline = Offline(learner, world, data, [1, 2], Lessons(), ALL)
    state = learned(offline, 0)
    online = training.learners
    torch.testing.assert_close(state.model["weight"], online.model["weight"], rtol=1e-6, atol=1e-8)
    assert state.tick.tolist() == online.tick.tolist() == [500, 500]
    falls = [
        sum(e.outcome is Outcome.FAILED for e in training.episodes if e.row == k) for k in (0, 1)
    ]
    assert min(falls) >= 2
    assert offline.snapshot().failures == falls
    found = [(e.row, e.number, e.outcome) for e in offline.episodes]
    assert sorted(found) == sorted((e.row, e.number, e.outcome) for e in training.episodes)
    for one, other in zip(
        offline.episodes, sorted(training.episodes, key=lambda e: e.row), strict=True
    ):
        assert (one.start, one.seconds) == (
            pytest.approx(other.start),
            pytest.approx(other.seconds),
        )


def test_least_squares_does_not_mind_the_order_and_a_gradient_does() -> None:
    for fit, minds in ((RecursiveLeastSquares(), False), (SquaredError(0.1), True)):
        recorded, shuffled = (
            learned(Offline(linear_learner(fit), NOISY, DATA, SEEDS, Lessons(order=order), ALL), 0)
            for order in ("recorded", "shuffled")
        )
        difference = recorded.model["weight"] - shuffled.model["weight"]
        assert (float(difference.abs().max()) > 1e-6) == minds


def test_least_squares_of_two_passes_is_that_of_each_row_twice() -> None:
    """Ridge regression with half the penalty, solved outright."""
    twice = learned(
        Offline(
            linear_learner(RecursiveLeastSquares(2.0)), NOISY, DATA, [3], Lessons(passes=2), ALL
        ),
        0,
    )
    own = DATA.seed == 3
    phi = np.concatenate([DATA.state[own], DATA.action[own]], axis=1)
    wanted = np.linalg.solve(phi.T @ phi + 0.25 * np.eye(3), phi.T @ DATA.next_state[own]).T
    np.testing.assert_allclose(twice.model["weight"][0].numpy(), wanted, rtol=1e-9)


def test_everybody_s_data_for_everybody() -> None:
    """share=all: every learner solves the same regression, over all rows."""
    state = learned(Offline(linear_learner(), NOISY, DATA, [70, 71], Lessons(share="all"), ALL), 0)
    phi = np.concatenate([DATA.state, DATA.action], axis=1)
    wanted = np.linalg.lstsq(phi, DATA.next_state, rcond=None)[0].T
    for row in range(2):
        np.testing.assert_allclose(state.model["weight"][row].numpy(), wanted, atol=1e-7)


def test_a_bootstrap_draws_whole_episodes() -> None:
    lessons = Lessons(share="bootstrap")
    rows = lessons.assigned(DATA, 11, ALL)
    again, other = lessons.assigned(DATA, 11, ALL), lessons.assigned(DATA, 12, ALL)
    assert np.array_equal(rows, again) and not np.array_equal(rows, other)
    begins = np.flatnonzero(np.append(True, np.diff(DATA.episode) != 0))
    starts = [k for k, row in enumerate(rows) if row in begins]
    assert len(starts) == len(begins)
    for piece in np.split(rows, starts[1:]):
        assert np.array_equal(piece, np.flatnonzero(DATA.episode == DATA.episode[piece[0]]))


def test_budgets_cut_the_data() -> None:
    def count(budget: Budget, data: Recorded = DATA) -> int:
        return len(Lessons().assigned(data, 4, budget))

    assert [count(Budget(seconds=s)) for s in (60.0, 12.0, 1.0)] == [60, 12, 1]
    assert [count(Budget(episodes=k)) for k in (1, 2, 99)] == [8, 16, 60]
    # The first ride of seed 4 ends with its second episode.
    succeeded = np.zeros(len(DATA), dtype=bool)
    succeeded[60 + 15] = True
    ridden = with_fields(DATA, succeeded=succeeded, terminated=succeeded)
    assert count(Budget(successes=1), ridden) == 16
    assert count(Budget(successes=2), ridden) == 60


def test_every_row_is_used_or_left_out_for_a_reason() -> None:
    valid = np.arange(len(DATA)) % 5 != 0
    data = with_fields(DATA, valid=valid)
    for share in ("own", "all"):
        lessons = Lessons(share, within=((0, 1.0),))
        for budget in (None, Budget(episodes=2), Budget(seconds=9.0)):
            offline = Offline(linear_learner(), NOISY, data, SEEDS, lessons, budget)
            for used, unused in zip(offline.used, offline.unused, strict=True):
                assert used + sum(astuple(unused)) == len(data)
                assert (unused.budget == 0) == (budget is None) and unused.not_drawn == 0
                assert unused.other_seeds == (120 if share == "own" else 0)
    drawn = Lessons("bootstrap")
    offline = Offline(linear_learner(), NOISY, DATA, SEEDS, drawn, None)
    for seed, unused in zip(SEEDS, offline.unused, strict=True):
        assert unused.not_drawn == len(DATA) - len(set(drawn.assigned(DATA, seed, None).tolist()))


def test_only_what_is_within_bounds_is_learned_from() -> None:
    """Rows beyond a bound may hold anything."""
    far = np.abs(DATA.state[:, 0]) > 1.0
    spoiled = with_fields(DATA, next_state=np.where(far[:, None], 1e6, DATA.next_state))
    assert 10 < far.sum() < 170
    lessons = Lessons(within=((0, 1.0),))
    states = [
        learned(Offline(linear_learner(), NOISY, data, SEEDS, lessons, ALL), 0)
        for data in (DATA, spoiled)
    ]
    assert torch.equal(states[0].model["weight"], states[1].model["weight"])
    offline = Offline(linear_learner(), NOISY, DATA, SEEDS, lessons, ALL)
    assert (
        sum(each.within for each in offline.unused) == far.sum()
        and offline.experience == [60.0] * 3
    )


def test_masked_rows_are_paid_for_but_not_learned_from() -> None:
    valid = np.arange(len(DATA)) % 5 != 0
    data = with_fields(DATA, valid=valid, state=np.where(valid[:, None], DATA.state, np.nan))
    offline = Offline(linear_learner(), NOISY, data, SEEDS, Lessons(), ALL)
    state = learned(offline, 0)
    assert bool(state.model["weight"].isfinite().all()) and bool(offline.finite.all())
    assert offline.used == [48] * 3
    assert offline.unused == [Unused(120, 0, 0, 12, 0)] * 3
    assert offline.experience == [60.0] * 3


def test_transitions_of_any_length_teach_the_same_derivative() -> None:
    """ds/dt = W (s, a) exactly, in rows of three lengths, mixed among the learners."""
    generator = np.random.default_rng(0)
    W = np.array([[0.0, 1.0, 0.0], [-2.0, -0.5, 3.0]])
    size = 90
    state, action = generator.normal(size=(size, 2)), generator.normal(size=(size, 1))
    dt = generator.choice([0.01, 0.02, 0.05], size)
    moved = np.concatenate([state, action], axis=1) @ W.T
    data = Recorded(
        state=state,
        action=action,
        next_state=state + dt[:, None] * moved,
        dt=dt,
        episode=np.arange(size),
        terminated=np.ones(size, dtype=bool),
        truncated=np.zeros(size, dtype=bool),
        succeeded=np.zeros(size, dtype=bool),
        seed=np.repeat([0, 1], [40, 50]),
        valid=np.ones(size, dtype=bool),
    )
    learner = derivative_learner(RecursiveLeastSquares(1e10), None, PlainStep(0.1))
    world = World(FAST)
    offline = Offline(learner, world, data, [0, 1], Lessons(), ALL)
    weight = learned(offline, 0).model["weight"]
    torch.testing.assert_close(weight, f64(W.tolist()).expand(2, 2, 3), rtol=0, atol=1e-6)
    assert offline.experience == pytest.approx([dt[:40].sum(), dt[40:].sum()])


def jittering(size: int = 24, seeds: int = 3) -> Recorded:
    """Transitions of ds/dt = W (s, a), each learner's of other lengths."""
    generator = np.random.default_rng(0)
    W = np.array([[0.0, 1.0, 0.0], [-2.0, -0.5, 3.0]])
    state, action = generator.normal(size=(size, 2)), generator.normal(size=(size, 1))
    dt = generator.uniform(0.008, 0.012, size)
    return Recorded(
        state=state,
        action=action,
        next_state=state + dt[:, None] * np.concatenate([state, action], axis=1) @ W.T,
        dt=dt,
        episode=np.arange(size),
        terminated=np.ones(size, dtype=bool),
        truncated=np.zeros(size, dtype=bool),
        succeeded=np.zeros(size, dtype=bool),
        seed=np.arange(size) * seeds // size,
        valid=np.ones(size, dtype=bool),
    )


PARTS: list[tuple[Any, Any, Any]] = [
    (AbsoluteError(0.5), ResidualNoise(0.7), SaturatedStep(0.5, 0.1)),
    (SquaredError(0.5), LinearNoise(0.7), DecayingStep(0.5, 0.1, 0.2)),
    (NormalisedSquaredError(0.5), None, PlainStep(0.01)),
    (DecayingFit(SquaredError(0.5), 0.2), None, FullStep()),
    (RecursiveLeastSquares(10.0), BayesianNoise(0.7), PlainStep(0.01)),
    (AdaptiveLeastSquares(10.0), None, PlainStep(0.01)),
    (Ridge(0.1, every=4), None, PlainStep(0.01)),
    (GradientFit(0.01, recent=5), None, PlainStep(0.01)),
]


@pytest.mark.parametrize("parts", PARTS, ids=lambda parts: type(parts[0]).__name__)
def test_a_tick_of_several_lengths_is_a_step_of_each_learner(parts: Any) -> None:
    """To rounding, model, noise and policy, while policies are improved too."""
    fit, noise, step = parts
    learner, world, data = derivative_learner(fit, noise, step), World(FAST), jittering()
    assert learner.dt_per_learner
    offline = Offline(learner, world, data, [0, 1, 2], Lessons(), None, schedule=Schedule())
    steps = 0
    while not offline.all_seen:
        steps += offline.advance(10)
    assert steps == 8
    for row in range(3):
        state = learner.initial([row])
        for k in np.flatnonzero(data.seed == row):
            s, a, after = (
                torch.from_numpy(part[k : k + 1])
                for part in (data.state, data.action, data.next_state)
            )
            valid = torch.ones(1, dtype=torch.bool)
            state, _ = learner.step(state, Transition(s, a, after, f64(data.dt[k]), valid))
        for group in ("model", "noise", "fit", "policy", "step"):
            for name, wanted in getattr(state, group).items():
                found = getattr(offline.learners, group)[name][row : row + 1]
                torch.testing.assert_close(found, wanted, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("parts", PARTS, ids=lambda parts: type(parts[0]).__name__)
def test_it_goes_on_from_a_state_bit_for_bit(parts: Any) -> None:
    """From between two pieces, while transitions pass and while policies climb."""

    def begin() -> Offline:
        learner, lessons = derivative_learner(*parts), Lessons("bootstrap", "shuffled", 2)
        data, schedule = jittering(), Schedule(first=2, every=5)
        # No policy ever arrives.
        return Offline(
            *(learner, World(FAST), data, [0, 1, 2], lessons, None),
            schedule=schedule,
            tolerance=0.0,
        )

    whole, states = begin(), []
    for _ in whole.learn(5, 2):
        states.append(whole.state())
    told = astuple(whole.snapshot())
    climbing = [bool(state["tensors"]["steps"].max() > 0) for state in states]
    assert len(climbing) > 8 and sum(climbing) == 3
    for state in (states[4], states[-2]):
        second = begin()
        second.restore({**state, "starts": json.loads(json.dumps(state["starts"]))})
        for _ in second.learn(5, 2):
            pass
        np.testing.assert_equal(astuple(second.snapshot()), told)
        np.testing.assert_equal(_numbers(second.state()), _numbers(whole.state()))


def _numbers(state: dict[str, Any]) -> dict[str, Any]:
    return {**state, "tensors": {name: t.numpy() for name, t in state["tensors"].items()}}


def test_the_state_of_other_data_or_learners_is_refused() -> None:
    def begin(data: Recorded = DATA, lessons: Lessons = SHUFFLED, fit: Any = None) -> Offline:
        learner = linear_learner()
        learner = learner if fit is None else with_fields(learner, fit=fit)
        return Offline(learner, NOISY, data, SEEDS, lessons, ALL)

    state = begin().state()
    begin().restore(state)
    for other in (begin(EXACT), begin(lessons=Lessons("own", "recorded", 2))):
        with pytest.raises(ValueError, match="data: expected the transitions, in the order"):
            other.restore(state)
    with pytest.raises(ValueError, match=r"learners\.fit\.\w+ is (missing|superfluous)"):
        begin(fit=Ridge(0.1, every=4)).restore(state)


class Own:
    """A rule of somebody's own, which does not say that it takes a dt for each learner."""

    def initial(self, weight: torch.Tensor) -> dict[str, torch.Tensor]:
        return {}

    def update(self, weight: Any, memory: Any, phi: Any, y: Any, unit: Any) -> Any:
        assert unit.ndim == 0
        return SquaredError(0.5).update(weight, memory, phi, y, unit)


def test_parts_that_take_one_length_get_one() -> None:
    found = []
    for fit in (Own(), SquaredError(0.5)):
        learner = derivative_learner(fit, None, PlainStep(0.01))
        assert learner.dt_per_learner == isinstance(fit, SquaredError)
        offline = Offline(learner, World(FAST), jittering(), [0, 1, 2], Lessons(), None)
        found.append(learned(offline, 0).model["weight"])
    torch.testing.assert_close(*found, rtol=1e-12, atol=1e-12)


def test_what_cannot_be_learned_from_is_refused() -> None:
    def begin(lessons: Lessons, seeds: list[int], data: Recorded = DATA) -> None:
        Offline(linear_learner(), NOISY, data, seeds, lessons, ALL)

    with pytest.raises(ValueError, match=r"share=own: nothing is recorded of seed 9; .*3, 4, 5"):
        begin(Lessons(), [3, 9])
    nameless = with_fields(DATA, seed=np.full(len(DATA), -1))
    with pytest.raises(ValueError, match=r"share=own: .* none: it names no seeds"):
        begin(Lessons(), [3], nameless)
    with pytest.raises(ValueError, match=r"seed 3 has 60 transitions and none to learn from"):
        begin(Lessons(), [3], with_fields(DATA, valid=np.zeros(len(DATA), dtype=bool)))
    wrongs: tuple[dict[str, Any], ...] = ({"share": "some"}, {"order": "backwards"}, {"passes": 0})
    for wrong in wrongs:
        with pytest.raises(ValueError, match=f"{next(iter(wrong))}="):
            Lessons(**wrong)
