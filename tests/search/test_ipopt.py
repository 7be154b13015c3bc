"""Paths by nonlinear programming, where CasADi is installed."""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import pytest

from edtorch.errors import Unavailable
from edtorch.search.ipopt import coarse, reach, reach_each, tick_function
from edtorch.search.plan import Plan
from edtorch.search.shooting import connect
from edtorch.search.starts import lines
from edtorch.search.tick_model import TickModel
from tests.planning import HANGING, swing_up, swing_up_cost, tick_once, tip_error


def _line(model: TickModel, ticks: int = 40) -> Plan:
    generator = np.random.default_rng(0)
    return lines(model.structure, HANGING, np.zeros(4), ticks, 1, model.dt, generator, wave=0.0)[0]


def test_without_casadi_one_line_says_so(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "casadi", None)
    model = swing_up()
    with pytest.raises(Unavailable, match=r"casadi cannot be imported .*edtorch\[plan\]"):
        reach(model, _line(model), 30)


def test_ticks_beyond_the_horizon_are_named() -> None:
    model = swing_up()
    with pytest.raises(ValueError, match="ticks=41: expected 1 to 40"):
        reach(model, _line(model), 41)


def test_the_expression_is_what_the_kernels_compute() -> None:
    casadi, model = pytest.importorskip("casadi"), swing_up()
    function, generator = tick_function(casadi, model), np.random.default_rng(0)
    for _ in range(5):
        state, part = generator.standard_normal(4), generator.uniform(-1, 1, 1)
        after, _ = tick_once(model, model.weight, state, part)
        np.testing.assert_allclose(np.array(function(state, part)).ravel(), after, rtol=1e-12)


def test_a_coarse_model_leaves_out_what_hardly_counts() -> None:
    model, generator = swing_up(dt=0.05), np.random.default_rng(0)
    size = np.abs(model.weight).max(axis=1, keepdims=True)
    hardly = 0.9e-3 * size * generator.uniform(-1, 1, model.weight.shape)
    found = coarse(replace(model, weight=np.where(model.weight == 0, hardly, model.weight)))
    np.testing.assert_array_equal(found.weight, model.weight)
    for _ in range(5):
        state, part = generator.standard_normal(4), generator.uniform(-1, 1, 1)
        exact, _ = tick_once(model, model.weight, state, part)
        np.testing.assert_allclose(tick_once(found, found.weight, state, part)[0], exact, atol=1e-3)


@pytest.mark.experiment
def test_the_pole_reaches_upright_and_the_plan_is_polished() -> None:
    pytest.importorskip("casadi")
    model = swing_up()
    start = reach(model, _line(model), 30)
    assert start is not None
    np.testing.assert_allclose(start.state[0], HANGING, atol=1e-9)
    np.testing.assert_allclose(start.state[30:, [0, 1, 3]], 0.0, atol=1e-9)
    assert np.abs(np.tanh(start.raw)).max() < 0.851
    rough = coarse(model)
    for t in range(40):
        action = np.tanh(start.raw[t])
        after, _ = tick_once(rough, rough.weight, start.state[t], action)
        np.testing.assert_allclose(after, start.state[t + 1], atol=1e-6)
    (plan,) = connect(model, swing_up_cost(model), [start]).plans
    assert plan.cost < 0.3 and (tip_error(plan.state[30:]) < 0.25).all()


def test_what_cannot_be_reached_gives_none() -> None:
    pytest.importorskip("casadi")
    model = swing_up()
    assert reach(model, _line(model), 4, limit=20) is None


def test_what_starts_from_its_line_is_said() -> None:
    pytest.importorskip("casadi")
    model = swing_up()
    line = _line(model)
    (start,), (note,) = reach_each(model, [line], 4, limit=20)
    assert start is line
    assert "IPOPT found no path to the target from 1 of 1 straight lines" in note
