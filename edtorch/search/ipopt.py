"""A path to a goal by nonlinear programming: CasADi and IPOPT (Andersson et al. 2019; Wächter &
Biegler 2006), for systems on which shooting gets stuck."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from edtorch.search.package import Package
from edtorch.search.plan import Plan
from edtorch.search.tick_model import TickModel, product_tree

CASADI = Package("casadi", "plan")
_LEAST = 1e-3
"""Weights smaller than this part of the largest of their row are left out of a path's model."""


def reach(
    model: TickModel, line: Plan, ticks: int, largest: float = 0.85, limit: int = 150
) -> Plan | None:
    """A start for ``connect``: the goal is reached exactly at tick ``ticks``, and held from there.

    line: what the search starts from (``starts.lines``), whose first state is the start and whose
    last the goal, over the whole horizon H.  Minimised is the sum of |u_t|^2 and |u_t - u_t-1|^2,
    u in parts of its bound, of which no more than ``largest`` is used, so that gains have something
    left; the states of all ticks are unknowns, each constrained to follow from the one before
    (multiple shooting), by the ``coarse`` model.  After tick ``ticks`` the raw actions are 0.  None
    where IPOPT has not converged after ``limit`` iterations.

    Raises Unavailable, in one line, without CasADi; ValueError for ``ticks`` beyond the horizon.
    """
    horizon, m = line.raw.shape
    if not 1 <= ticks <= horizon:
        raise ValueError(f"ticks={ticks}: expected 1 to {horizon}, the horizon of the line")
    casadi, n = CASADI.module(), line.state.shape[1]
    state, push = casadi.MX.sym("state", n, ticks + 1), casadi.MX.sym("push", m, ticks)
    after = tick_function(casadi, coarse(model)).map(ticks)(state[:, :-1], push)
    change = push[:, 1:] - push[:, :-1]
    program = {
        "x": casadi.veccat(state, push),
        "f": casadi.sumsqr(push) + casadi.sumsqr(change),
        "g": casadi.vec(after - state[:, 1:]),
    }
    quiet = {"ipopt.print_level": 0, "ipopt.sb": "yes", "print_time": False}
    solver = casadi.nlpsol("reach", "ipopt", program, {**quiet, "ipopt.max_iter": limit})
    states = line.state[: ticks + 1].copy()
    states[-1] = line.state[-1]
    free = np.full((ticks + 1, n), np.inf)
    free[0] = free[-1] = 0.0
    bound, ends = np.full(ticks * m, largest), np.where(free > 0, 0.0, states)
    found = solver(
        x0=np.concatenate((states.ravel(), np.zeros(ticks * m))),
        lbx=np.concatenate(((ends - free).ravel(), -bound)),
        ubx=np.concatenate(((ends + free).ravel(), bound)),
        lbg=0.0,
        ubg=0.0,
    )
    if not solver.stats()["success"]:
        return None
    values = np.array(found["x"]).ravel()
    parts = values[(ticks + 1) * n :].reshape(ticks, m)
    raw = np.concatenate((np.arctanh(parts), np.zeros((horizon - ticks, m))))
    held = np.tile(line.state[-1], (horizon - ticks, 1))
    moved = values[: (ticks + 1) * n].reshape(ticks + 1, n)
    return Plan(np.concatenate((moved, held)), raw, np.zeros_like(line.gain), np.inf)


def reach_each(
    model: TickModel, lines: Sequence[Plan], ticks: int, limit: int = 150
) -> tuple[list[Plan], tuple[str, ...]]:
    """``reach`` from each line, the line itself where IPOPT finds no path, and a note that says how
    many those are."""
    paths = [reach(model, line, ticks, limit=limit) for line in lines]
    starts = [line if path is None else path for line, path in zip(lines, paths, strict=True)]
    missed = sum(path is None for path in paths)
    if not missed:
        return starts, ()
    return starts, (
        f"IPOPT found no path to the target from {missed} of {len(lines)} straight lines: planned"
        " from those lines themselves",
    )


def coarse(model: TickModel) -> TickModel:
    """Good enough for a start, and several times as fast: one step of Runge and Kutta's method a
    tick, and none of the weights that automatic relevance determination has left next to zero."""
    size = np.abs(model.weight)
    small = size < _LEAST * size.max(axis=1, keepdims=True)
    return replace(model, weight=np.where(small, 0.0, model.weight), substeps=1)


def tick_function(casadi: Any, model: TickModel) -> Any:
    """The state one tick after s ``[n]`` under u ``[m]``, in parts of its bound, as an expression:
    what the kernels compute, without stops."""
    n, m = len(model.structure.source), len(model.half)
    s, part = casadi.SX.sym("s", n), casadi.SX.sym("part", m)
    action = casadi.DM(model.middle) + casadi.DM(model.half) * part
    x, h = s, model.dt / model.substeps
    for _ in range(model.substeps):
        first = _slope(casadi, model, x, action)
        second = _slope(casadi, model, x + h / 2 * first, action)
        third = _slope(casadi, model, x + h / 2 * second, action)
        fourth = _slope(casadi, model, x + h * third, action)
        x = x + h / 6 * (first + 2 * second + 2 * third + fourth)
    return casadi.Function("tick", [s, part], [x])


def _slope(casadi: Any, model: TickModel, s: Any, action: Any) -> Any:
    """ds/dt: (I - N) f = h for what is learned."""
    structure, lift = model.structure, model.structure.lift
    learned, source, derivative = structure.learned, structure.source, structure.terms.derivative
    entry = [1.0] * lift.size
    for i, first in enumerate(lift.at):
        entry[first] = casadi.sin(s[i] * lift.unit[i]) if lift.angle[i] else s[i]
        if lift.angle[i]:
            entry[first + 1] = casadi.cos(s[i] * lift.unit[i])
    for j in range(len(model.half)):
        entry[lift.action_at + j] = action[j]
    tree, node = product_tree(structure.terms.factors)
    product = [casadi.SX(1.0)]
    for parent, factor in tree[1:]:
        product.append(product[parent] * entry[factor])
    h, matrix = casadi.SX.zeros(len(learned)), casadi.SX.eye(len(learned))
    for l_, k in np.argwhere(model.weight):
        value, j = model.weight[l_, k] * product[node[k]], derivative[k]
        if j < 0:
            h[l_] += value
        else:
            matrix[l_, j] -= value
    f = casadi.solve(matrix, h)
    slope = casadi.SX.zeros(len(source))
    for i in np.flatnonzero(source >= 0):
        slope[i] = structure.ratio[i] * s[source[i]]
    for l_, i in enumerate(learned):
        slope[i] = f[l_]
    return slope
