r"""Balls that a process with bounded noise cannot leave, so that local constants suffice."""

from __future__ import annotations

from collections.abc import Callable

from torch import Tensor

from edtorch.bounds.constants import require_bound

LocalLipschitz = Callable[[Tensor, float], float]
"""An upper bound of sup |D mu|_2 over the ball around a state ``[n]`` of a radius."""


def tube_radii(
    mean: Tensor, local_lipschitz: LocalLipschitz, *, noise_radius: float, start_radius: float = 0.0
) -> list[float]:
    r"""Radii $\rho_{t+1} = L_t \rho_t + \bar w$ of balls around s~_t that hold every path.

    mean s~_t ``[T+1, n]`` of the first-order unroll; noise_radius $\bar w \ge |w|$ almost surely;
    start_radius bounds |s_0 - s~_0|.  Constants that are suprema over the ball of each step may
    then replace global ones (pass them to ``bound_errors`` step by step).  Unbounded noise has no
    such tube.  Raises ValueError for radii that are negative, NaN or infinite.
    """
    require_bound("noise_radius", noise_radius)
    require_bound("start_radius", start_radius)
    radii = [start_radius]
    for center in mean[:-1]:
        radius = local_lipschitz(center, radii[-1]) * radii[-1] + noise_radius
        require_bound("radius", radius)
        radii.append(radius)
    return radii
