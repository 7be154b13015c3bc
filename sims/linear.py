"""A linear system with Gaussian noise: the world whose every answer is known in closed form."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import ClassVar

import torch
from torch import Tensor

from sims.base import Measure, Outcome, Quantity, Spec, expect_action


class LinearSystem:
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

    traceable: ClassVar[bool] = True

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
        self._F, self._G, self._noise, self._start = F, G, noise, start
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

    def initial(self, uniforms: Tensor) -> Tensor:
        """Start states ``[*batch, n]`` from uniforms ``[*batch, n]``."""
        return self._start * (2 * uniforms - 1)

    def restart(self, state: Tensor, mask: Tensor, uniforms: Tensor) -> Tensor:
        """``state`` with a new start where ``mask`` ``[*batch]``."""
        return torch.where(mask.unsqueeze(-1), self.initial(uniforms), state)

    def step(self, state: Tensor, action: Tensor, uniforms: Tensor) -> Tensor:
        """The state ``[*batch, n]`` a step later; uniforms ``[*batch, 2 n]`` make the noise."""
        expect_action(state, action, self._G.shape[-1])
        # Box and Muller (1958); 1 - u keeps the logarithm finite.
        radius, angle = uniforms.chunk(2, dim=-1)
        normal = (-2 * torch.log1p(-radius)).sqrt() * (2 * math.pi * angle).cos()
        F, G = self._F.to(state.device), self._G.to(state.device)
        moved = (state.unsqueeze(-2) * F).sum(-1) + (action.unsqueeze(-2) * G).sum(-1)
        return moved + self._noise * normal

    def observe(self, state: Tensor) -> Tensor:
        """The state itself."""
        return state

    def outcome(self, state: Tensor) -> Tensor:
        """``Outcome`` of each episode, int64 ``[*batch]``."""
        inside = (state.abs() <= 1000 * self._start).all(-1)
        return torch.where(inside, int(Outcome.RUNNING), int(Outcome.FAILED))

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
