"""A linear system with Gaussian noise: the world whose every answer is known in closed form."""

from __future__ import annotations

import math
from collections.abc import Sequence

import torch
from torch import Tensor

from sims.base import Measure, Outcome, Quantity, Spec
from sims.rows import Function, Namespace, Rows, RowSim, joined

RUNNING, FAILED = int(Outcome.RUNNING), int(Outcome.FAILED)


class LinearSystem(RowSim):
    """s' = F s + G a + noise w, with w standard normal.

    ======== ==================================================================================
    state    ``[*batch, n]``, all of it observed, as state_0, state_1, ...; no unit
    action   ``[*batch, m]``, action_0, action_1, ..., not clipped
    start    each component uniform in [-start, start]
    end      TIMED_OUT after ``time_limit``; FAILED if a component leaves [-1000 start, 1000 start],
             which an unstable loop will do
    measures ``final_size``: the Euclidean norm of the last state
    ======== ==================================================================================

    Arguments: ``state_matrix`` F ``[n][n]``, ``action_matrix`` G ``[n][m]``; ``noise``: standard
    deviation; ``start`` above 0; ``dt`` and ``time_limit`` in s.  ValueError names what is wrong.
    """

    def __init__(
        self,
        state_matrix: Sequence[Sequence[float]],
        action_matrix: Sequence[Sequence[float]],
        *,
        noise: float = 0.1,
        start: float = 1.0,
        dt: float = 1.0,
        time_limit: float = 50.0,
    ) -> None:
        """Check the arguments."""
        F = _matrix("state_matrix", state_matrix)
        G = _matrix("action_matrix", action_matrix)
        if F.shape[0] != F.shape[1]:
            raise ValueError(f"state_matrix={state_matrix}: expected a square matrix")
        if G.shape[0] != F.shape[0]:
            raise ValueError(f"action_matrix={action_matrix}: expected {F.shape[0]} rows")
        for name, value in (("start", start), ("dt", dt), ("time_limit", time_limit)):
            if not (math.isfinite(value) and value > 0):
                raise ValueError(f"{name}={value}: expected a finite number above 0")
        if not (math.isfinite(noise) and noise >= 0):
            raise ValueError(f"noise={noise}: expected a finite number, 0 or more")
        self._F, self._G, self._noise, self._start = F, G, float(noise), float(start)
        self._spec = Spec(
            name="linear",
            state=tuple(Quantity(f"state_{i}", "1") for i in range(F.shape[0])),
            action=tuple(Quantity(f"action_{i}", "1") for i in range(G.shape[1])),
            dt=dt,
            time_limit=time_limit,
            disturbance_dim=2 * F.shape[0],
            reset_dim=F.shape[0],
            clip_action=False,
            headline="state_0",
            measures=(Measure("final_size", "size of the last state", "", "lower"),),
            survival=True,
        )

    @property
    def spec(self) -> Spec:
        """The facts of the domain."""
        return self._spec

    def rows(self, xp: Namespace) -> Rows:
        """s' = F s + G a + noise w; constants: noise, start, and the rows of [F G]."""
        n, m = self._G.shape
        both = torch.cat((self._F, self._G), dim=1).flatten().tolist()

        def component(i: int) -> Function:
            first = 2 + i * (n + m)

            @xp.jit
            def moved(state, action, uniforms, constants):
                free = constants[first] * state[0]
                for j in range(1, n):
                    free = free + constants[first + j] * state[j]
                forced = constants[first + n] * action[0]
                for j in range(1, m):
                    forced = forced + constants[first + n + j] * action[j]
                # Box and Muller (1958); 1 - u keeps the logarithm finite.
                radius = xp.sqrt(-2 * xp.log1p(-uniforms[i]))
                normal = radius * xp.cos(2 * math.pi * uniforms[n + i])
                return (free + forced + constants[0] * normal,)

            return moved

        def started(i: int) -> Function:
            return xp.jit(
                lambda state, uniforms, constants: (constants[1] * (2 * uniforms[i] - 1),)
            )

        def outcome(state, constants):
            inside = xp.abs(state[0]) <= 1000 * constants[1]
            for j in range(1, n):
                inside = xp.both(inside, xp.abs(state[j]) <= 1000 * constants[1])
            return xp.where(inside, RUNNING, FAILED)

        return Rows(
            width=n,
            step=joined(xp, *(component(i) for i in range(n))),
            observe=lambda state, constants: state,
            outcome=outcome,
            start=joined(xp, *(started(i) for i in range(n))),
            constants=(self._noise, self._start, *both),
        )

    def measures(self, start: Tensor, final: Tensor, seconds: Tensor) -> dict[str, Tensor]:
        """``final_size`` ``[*batch]``."""
        return {"final_size": torch.linalg.vector_norm(final, dim=-1)}


def _matrix(name: str, rows: Sequence[Sequence[float]]) -> Tensor:
    try:
        matrix = torch.tensor(rows, dtype=torch.float64)
    except (TypeError, ValueError) as error:
        raise ValueError(f"{name}={rows}: expected rows of numbers, all of one length") from error
    if matrix.ndim != 2 or not bool(matrix.isfinite().all()):
        raise ValueError(f"{name}={rows}: expected rows of finite numbers")
    return matrix
