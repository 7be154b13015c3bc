"""Simulators written once: equal in torch and compiled, differentiable, refused if incomplete."""

from __future__ import annotations

import math
import pickle
from collections.abc import Callable
from dataclasses import replace
from typing import Any, NamedTuple

import numba.core.config
import pytest
import torch
from torch import Tensor

from sims.base import Outcome, Quantity, Sim, Spec
from sims.bicycle import Bicycle, Physics, explicit_euler, semi_implicit
from sims.bicycle.slalom import Slalom
from sims.compiled_rows import compiled, numba_namespace
from sims.conformance import check
from sims.linear import LinearSystem
from sims.rows import (
    TORCH,
    FallibleRowSim,
    Namespace,
    NoRows,
    Rows,
    RowSim,
    joined,
    rows_of,
    stacked,
    unstacked,
)
from sims.tasks.cart_pole import CartPole
from sims.tasks.quadrotor import Quadrotor
from tests.sims.test_conformance import ALL_AT_ONCE

CHANGING: dict[str, Any] = {"change_at": 0.05, "change": {"M_p": 90.0, "v": 5.0, "r": 0.3}}
SHORT_GUSTS: dict[str, Any] = {"gust": 10.0, "gust_seconds": 0.03, "gust_every": 0.05}

WORLDS: dict[str, Callable[[], Sim]] = {
    "bicycle": Bicycle,
    "explicit": lambda: Bicycle(
        physics=Physics(true_precession=True),
        lean_acceleration=True,
        integrate=explicit_euler,
        **SHORT_GUSTS,
    ),
    "drawn": lambda: Bicycle(spread=0.3),
    "windy": lambda: Bicycle(**SHORT_GUSTS),
    "windy, true precession": lambda: Bicycle(physics=Physics(true_precession=True), **SHORT_GUSTS),
    "changing": lambda: Bicycle(**CHANGING),
    "drawn, changing": lambda: Bicycle(spread=0.3, **CHANGING),
    "off balance": lambda: Bicycle(start_lean=0.1, start_handlebar=0.35),
    "slalom": Slalom,
    "short slalom": lambda: Slalom(gates=1, gate_spacing=2.1, look_ahead=1.5),
    "slalom, all at once": lambda: Slalom(**ALL_AT_ONCE),
    "linear, one": lambda: LinearSystem([[1.0]], [[0.5]]),
    "linear, three": lambda: LinearSystem(
        [[1.0, 0.1, 0.3], [0.0, 0.9, 0.2], [0.1, 0.2, 0.3]], [[0.0, 1.0], [0.5, 0.2], [0.1, 0.3]]
    ),
    "cart-pole": lambda: CartPole(push=2.0),
    "quadrotor": Quadrotor,
}


def f64(numbers: list[float]) -> Tensor:
    return torch.tensor(numbers, dtype=torch.float64)


@pytest.mark.parametrize("name", WORLDS)
def test_one_text_is_one_world(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    # Not compiled, which takes seconds: numba leaves the functions of numbers as they are.
    monkeypatch.setattr(numba.core.config, "DISABLE_JIT", True)
    check(WORLDS[name](), batches=((5,),))


@pytest.mark.oracle
@pytest.mark.parametrize("name", ["explicit", "slalom, all at once", "linear, three"])
def test_compiled_it_is_the_same_world(name: str) -> None:
    check(WORLDS[name](), batches=((5,),))


@pytest.mark.oracle
def test_the_functions_agree_on_what_is_special() -> None:
    xp = numba_namespace("special")
    numbers = [math.nan, math.inf, -math.inf, 0.0, -0.0, 0.5, -1.5, 2.5, 3.2, -0.3, 1e-310]
    rows = f64(numbers)

    def same(found: list[float], wanted: Tensor) -> None:
        right = wanted.double()
        assert torch.allclose(f64(found), right, 1e-15, 0, equal_nan=True)

    for name in ("sign", "floor", "round", "abs", "isfinite", "as_number", "negated"):
        rows_here = rows > 0 if name in ("as_number", "negated") else rows
        function = getattr(xp, name)
        compiled_here = xp.jit(lambda x, function=function: function(x))
        found = [compiled_here(x) for x in rows_here.tolist()]
        same(found, getattr(TORCH, name)(rows_here))
    for name in ("minimum", "maximum"):
        for other in numbers:
            found = [getattr(xp, name)(x, other) for x in numbers]
            same(found, getattr(TORCH, name)(rows, other))
            same(found, getattr(TORCH, name)(other, rows))
            same(found, getattr(TORCH, name)(rows, torch.full_like(rows, other)))
    for name in ("both", "either"):
        for other in (True, False):
            found = [getattr(xp, name)(x, other) for x in (rows > 0).tolist()]
            same(found, getattr(TORCH, name)(rows > 0, torch.full_like(rows, other).bool()))
    same([xp.where(x > 0, 0.1, 1) for x in numbers], TORCH.where(rows > 0, 0.1, 1))
    assert xp.tiny(1.0) == TORCH.tiny(rows)


@pytest.mark.oracle
def test_nan_in_any_component_is_a_failure() -> None:
    sim = Slalom(**ALL_AT_ONCE)
    rows = compiled(sim, "nan")
    start = sim.initial(torch.full((sim.spec.reset_dim,), 0.4).double())
    for k in range(len(start)):
        state = start.clone()
        state[k] = math.nan
        assert int(sim.outcome(state)) == Outcome.FAILED
        assert rows.outcome(tuple(state.tolist()), rows.constants) == Outcome.FAILED


POLE = Spec(
    name="pole",
    state=(Quantity("angle", "rad"), Quantity("rate", "rad/s", rate_of="angle")),
    action=(Quantity("torque", "N m", low=-5.0, high=5.0),),
    dt=0.02,
    time_limit=10.0,
    disturbance_dim=0,
    reset_dim=2,
    clip_action=True,
    headline="angle",
)


class Pole(RowSim):
    """A pole whose constants are a parameter, and a member of whose rows can be replaced."""

    spec = POLE

    def __init__(self, gravity: float = 9.81, **others: Any) -> None:
        self.gravity, self.others = gravity, others

    def rows(self, xp: Namespace) -> Rows:
        def step(state: Any, action: Any, uniforms: Any, c: Any) -> Any:
            rate = state[1] + 0.02 * (c[0] * xp.sin(state[0]) + action[0])
            return state[0] + 0.02 * rate, rate

        given: dict[str, Any] = {
            "constants": (self.gravity,),
            "width": 2,
            "step": step,
            "observe": lambda state, c: state,
            "outcome": lambda state, c: xp.where(xp.abs(state[0]) > 0.6, 1, 0),
            "start": lambda state, u, c: (0.1 * (2 * u[0] - 1), 0.0),
        }
        return Rows(**{k: v for k, v in (given | self.others).items() if v != "missing"})

    def measures(self, start: Tensor, final: Tensor, seconds: Tensor) -> dict[str, Tensor]:
        return {}


def test_a_user_writes_rows_and_nothing_else(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.core.config, "DISABLE_JIT", True)
    check(Pole())
    again = pickle.loads(pickle.dumps(Pole(3.0)))
    assert again.gravity == 3.0
    sim = Pole()
    sim.initial(torch.zeros(4, 2).double())
    assert pickle.loads(pickle.dumps(sim)).others == {}


@pytest.mark.oracle
def test_derivatives_through_rows() -> None:
    sim = Pole(3.0)
    draw = torch.Generator().manual_seed(0)
    state, action = torch.rand(2, 4, 2, generator=draw, dtype=torch.float64).requires_grad_()
    arguments = (state.detach().requires_grad_(), action[:, :1].detach().requires_grad_())

    def twice(state: Tensor, action: Tensor) -> Tensor:
        nothing = torch.zeros(4, 0, dtype=torch.float64)
        return sim.observe(sim.step(sim.step(state, action, nothing), action, nothing))

    assert torch.autograd.gradcheck(twice, arguments)


@pytest.mark.parametrize(
    ("others", "message"),
    [
        ({"observe": "missing"}, "Pole.rows: expected a function `observe`"),
        ({"step": 3}, "Pole.rows: expected a function `step`"),
        ({"birth": 3}, "Pole.rows: expected a function `birth` or None"),
        ({"width": 4}, "Pole.rows: step returned 2 rows, expected width=4"),
        ({"observe": lambda s, c: (s[0],)}, "Pole.rows: observe returned 1 rows, expected 2, as"),
        ({"observe": lambda s, c: s[0]}, "Pole.rows: observe returned Tensor, expected a tuple of"),
        ({"step": lambda s, c: s}, "Pole.rows: step failed: TypeError: "),
        ({"birth": lambda u, c: (u[5], 0)}, "Pole.rows: birth failed: IndexError: tuple index"),
        ({"outcome": lambda s, c: s[0]}, "Pole.rows: outcome returned torch.float64, expected one"),
        ({"stepped": lambda s, c: s[0] > 0}, "Pole.rows: gives `stepped`, expected Pole to be a "),
    ],
)
def test_incomplete_rows_are_named(others: dict[str, Any], message: str) -> None:
    with pytest.raises(ValueError) as refusal:
        Pole(**others).initial(torch.zeros(3, 2).double())
    assert str(refusal.value).startswith(message)
    with pytest.raises(AssertionError, match="pole: Pole"):
        check(Pole(**others))


def test_what_is_no_rows_is_named() -> None:
    class Text(Pole):
        def rows(self, xp: Namespace) -> Any:
            return "rows"

    with pytest.raises(ValueError, match=r"^Text\.rows: returned str, expected Rows$"):
        rows_of(Text())
    with pytest.raises(NotImplementedError, match="Bare: expected a function `rows`"):
        type("Bare", (RowSim,), {"spec": POLE})().initial(torch.zeros(2))


def test_steps_that_may_fail() -> None:
    class Skipping(Pole, FallibleRowSim):
        pass

    state = torch.tensor([[0.1, 0.0], [-0.1, 0.0]]).double()
    sim = Skipping(stepped=lambda s, c: s[0] > 0)
    assert sim.stepped(state).tolist() == [True, False]
    with pytest.raises(ValueError, match=r"Skipping\.rows: expected a function `stepped`"):
        Skipping().stepped(state)


def test_a_difference_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    class Two(Pole):
        """Another text for numbers."""

        def rows(self, xp: Namespace) -> Rows:
            rows = super().rows(xp)
            if xp is TORCH:
                return rows
            return replace(rows, observe=lambda state, c: (state[0], state[1] + 1e-9))

    monkeypatch.setattr(numba.core.config, "DISABLE_JIT", True)
    with pytest.raises(AssertionError, match=r"^pole: rows: observe: component 1 is .* compiled"):
        check(Two())


@pytest.mark.oracle
def test_what_numba_cannot_compile_is_named() -> None:
    def helper(state: Any) -> Any:
        return state

    sim = Pole(observe=lambda state, c: helper(state))
    with pytest.raises(AssertionError, match=r"^pole: observe cannot be compiled: .*@xp\.jit"):
        check(sim)


def test_sims_that_have_no_rows_say_why() -> None:
    def own(theta: Any, theta_dot: Any, theta_ddot: Any, *others: Any) -> Any:
        return semi_implicit(theta, theta_dot, theta_ddot, *others)

    sim = Bicycle(integrate=own)
    start = sim.initial(torch.zeros(3, 1).double())
    moved = sim.step(start, torch.zeros(3, 2).double(), torch.zeros(3, 1).double())
    assert moved.shape == (3, 10)
    with pytest.raises(NoRows, match=r"^integrate=own: over rows there are only semi_implicit and"):
        rows_of(sim)

    masses = torch.linspace(50, 70, 3).double()
    with pytest.raises(NoRows, match=r"constants\.M_p is a Tensor: compiled code takes numbers"):
        rows_of(Bicycle(physics=Physics(M_p=masses)))

    class Slow(Bicycle):
        def step(self, state: Tensor, action: Tensor, uniforms: Tensor) -> Tensor:
            return state

    with pytest.raises(NoRows, match=r"^Slow: overrides `step` and not `rows`"):
        rows_of(Slow())

    class Jumpy(Pole):
        def stepped(self, state: Tensor) -> Tensor:
            return state[..., 0] > 0

    with pytest.raises(NoRows, match=r"^Jumpy: its `stepped` is not among its rows"):
        rows_of(Jumpy())


def test_constants_are_floats_when_compiled() -> None:
    class Constants(NamedTuple):
        gravity: float

    assert compiled(Pole(constants=Constants(9)), "whole").constants == Constants(9.0)
    assert type(compiled(Pole(constants=(9, 2.5)), "whole").constants[0]) is float


def test_every_compiled_function_carries_the_key() -> None:
    def helper(x: Any) -> Any:
        return x

    once, again = (numba_namespace(key).jit(helper) for key in ("first", "second"))
    assert (once.py_func.__name__, again.py_func.__name__) == ("helper_first", "helper_second")
    assert once.py_func.__qualname__.endswith("helper_first") and helper.__name__ == "helper"
    rows = compiled(Slalom(), "third")
    for member in ("step", "observe", "outcome", "start", "birth", "stepped"):
        assert getattr(rows, member).py_func.__qualname__.endswith("_third")


def test_rows_and_tensors_are_each_other() -> None:
    tensor = torch.arange(24.0, dtype=torch.float64).reshape(2, 3, 4)
    assert torch.equal(stacked(unstacked(tensor), tensor), tensor)
    filled = stacked((1, 2.5, tensor[..., 0], torch.tensor(3.0)), tensor)
    assert filled.shape == (2, 3, 4) and filled.dtype == torch.float64
    assert torch.equal(filled[..., 1], torch.full((2, 3), 2.5).double())
    assert torch.equal(filled[..., 3], torch.full((2, 3), 3.0).double())
    parts = [(lambda x, k=k: (x + k,)) for k in range(9)]
    assert all(joined(TORCH, *parts[:n])(1) == tuple(range(1, n + 1)) for n in range(10))


def test_numbers_stay_float64_in_torch() -> None:
    row = torch.tensor([1.0, -1.0]).double()
    assert TORCH.where(row > 0, 0.1, 0.2).tolist() == [0.1, 0.2]
    assert TORCH.where(row > 0, 0.1, 0.1) == 0.1
    assert TORCH.where(row > 0, 1, 0.2).tolist() == [1.0, 0.2]
    assert TORCH.where(row > 0, 1, 0).dtype == torch.int64
    assert (0.1 * TORCH.as_number(row > 0)).tolist() == [0.1, 0.0]
    assert float(TORCH.sqrt(2.0)) == pytest.approx(math.sqrt(2), rel=1e-15)
    assert (TORCH.minimum(1.0, 2.0), TORCH.maximum(1.0, 2.0)) == (1.0, 2.0)
    assert Rows(1, *[max] * 4, constants=()).constants == (0.0,)
