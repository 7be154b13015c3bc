r"""A reward that saturates far from its target: exp(-d^2 / 2) - 1, d in widths.

Nothing that is far away weighs more than what is near, so that one bad step of a prediction does
not outweigh all others (Deisenroth & Rasmussen, "PILCO", 2011, eq. 25).  With e = s - target and
L = diag(1 / width) over the components that have one, and a Gaussian state,

    E[exp(-|L e|^2 / 2)] = |B|^(-1/2) exp(-(L m)' B^-1 (L m) / 2),  B = I + L S L,

m and S being mean and covariance of e.  It is between -1 and 0.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from edtorch.shapes import Actions, Rows, States
from edtorch.types import Belief


class SaturatingReward:
    """r(s) = exp(-1/2 sum_i ((s_i - target_i) / width_i)^2) - 1, in units of the state.

    names: of the state's components, in order; width: by name, above zero, of those that count;
    target: by name, a number or the name of another component, 0 where none is given.  ValueError
    for unknown names, widths that are not positive and targets without a width.

    Differences are not wrapped: those of angles are taken on the turn on which the state is.
    """

    def __init__(
        self,
        names: Sequence[str],
        width: Mapping[str, float],
        target: Mapping[str, float | str] | None = None,
        dtype: torch.dtype = torch.float64,
    ) -> None:
        names, wanted = list(names), dict(target or {})
        if not width:
            raise ValueError(f"width={dict(width)}: expected one for some of {', '.join(names)}")
        for key, group in (("width", width), ("target", wanted)):
            for name, value in group.items():
                if name not in names:
                    raise ValueError(f"{key}.{name}={value}: expected one of {', '.join(names)}")
        for name, value in width.items():
            if not value > 0:
                raise ValueError(f"width.{name}={value}: expected a number > 0")
        rows = torch.zeros(len(width), len(names), dtype=dtype)
        offset = torch.zeros(len(width), dtype=dtype)
        for row, (name, value) in enumerate(width.items()):
            rows[row, names.index(name)] = 1 / value
            other = wanted.pop(name, 0.0)
            if not isinstance(other, str):
                offset[row] = other / value
            elif other in names and other != name:
                rows[row, names.index(other)] = -1 / value
            else:
                raise ValueError(
                    f"target.{name}={other}: expected a number or another of {', '.join(names)}"
                )
        for name, value in wanted.items():
            raise ValueError(f"target.{name}={value}: has no effect without width.{name}")
        self._rows = rows
        self._offset = offset
        self.target = torch.tensor(
            [float(v) if not isinstance(v, str) else 0.0 for v in _by_place(names, target)],
            dtype=dtype,
        )

    def _deviation(self, state: Tensor) -> Tensor:
        """L e, ``[*batch, k]``."""
        return state @ self._rows.mT.to(state) - self._offset.to(state)

    def __call__(self, state: States, action: Actions | None = None, /) -> Rows:
        """``[*batch]`` of states ``[*batch, n]``; actions do not count."""
        return torch.exp(-0.5 * self._deviation(state).square().sum(-1)) - 1

    def expected(self, belief: Belief) -> Rows:
        """The expectation under a Gaussian, ``[*batch]``."""
        rows = self._rows.to(belief.cov)
        deviation = self._deviation(belief.mean).unsqueeze(-1)
        spread = rows @ belief.cov @ rows.mT
        eye = torch.eye(spread.shape[-1], dtype=spread.dtype, device=spread.device)
        # B is at least I: its factor exists at zero covariance as well.
        lower = torch.linalg.cholesky_ex(eye + spread).L
        shrunk = torch.linalg.solve_triangular(lower, deviation, upper=False).squeeze(-1)
        half_log = torch.diagonal(lower, dim1=-2, dim2=-1).log().sum(-1)
        return torch.exp(-0.5 * shrunk.square().sum(-1) - half_log) - 1


def _by_place(names: Sequence[str], target: Mapping[str, float | str] | None) -> list[float | str]:
    return [(target or {}).get(name, 0.0) for name in names]
