r"""Bounds that hold at every time, for a closed loop that contracts."""

from __future__ import annotations

import math
from dataclasses import dataclass

from edtorch.bounds.constants import Constants, NoiseLaw, NonSmoothDynamics, require_bound
from edtorch.bounds.moments import StartLaw
from edtorch.bounds.result import Standing


@dataclass(frozen=True)
class UniformBounds:
    """Bounds for all t: |epsilon^s_t|, |epsilon^Sigma_t|_F, D_2 and D_4, and their standing."""

    mean: float
    cov: float
    second_moment: float
    fourth_moment: float
    standing: Standing


def uniform_bounds(
    constants: Constants, noise_law: NoiseLaw, *, noise_trace: float, start: StartLaw | None = None
) -> UniformBounds:
    r"""Errors of mean and covariance that no horizon exceeds, if L < 1.

    With tr nu(s) <= N everywhere (``noise_trace``):

    $$D_2 \le \frac{N}{1 - L^2}, \quad |\epsilon^s| \le \frac{m_\mu D_2}{2(1 - L)}, \quad
      D_4 \le \frac{6 L^2 N D_2 + k N^2 + 4 L \sqrt{D_2}\,\kappa_3}{1 - L^4}, \quad
      |\epsilon^\Sigma|_F \le \frac{M_\nu\sqrt{D_2} + m_\mu L \sqrt{D_2 D_4} + \frac14 m_\mu^2 D_4}
      {1 - L^2},$$

    k the kurtosis and kappa_3 the third moment of the noise law; or the start's own value where
    that is larger.  Raises ValueError unless L < 1, and NonSmoothDynamics if the constants say so.

    >>> linear = Constants(0.5, 0.0, 0.0, 0.0, "analytic")
    >>> uniform_bounds(linear, NoiseLaw(3.0), noise_trace=3.0).second_moment
    4.0
    """
    require_bound("noise_trace", noise_trace)
    L = constants.lipschitz
    if not L < 1:
        raise ValueError(f"lipschitz={L}: uniform bounds need a number < 1")
    if not constants.smooth:
        raise NonSmoothDynamics("the dynamics are flagged as not smooth: no bound exists for them")
    start = start or StartLaw.point()
    # Each is a fixed point x = rate x + added of its recursion: at most that, or the start's.
    D_2 = max(start.second_moment, noise_trace / (1 - L**2))
    fourth = 6 * L**2 * noise_trace * D_2 + noise_law.kurtosis * noise_trace**2
    fourth += 4 * L * math.sqrt(D_2) * noise_law.third
    D_4 = max(start.fourth_moment, fourth / (1 - L**4))
    mean = max(start.mean_error, 0.5 * constants.curvature * D_2 / (1 - L))
    cross = constants.curvature * L * math.sqrt(D_2 * D_4)
    change = constants.noise_slope * math.sqrt(D_2)
    cov = (change + cross + 0.25 * constants.curvature**2 * D_4) / (1 - L**2)
    standing: Standing = "estimate" if constants.provenance == "sampled" else "certified"
    return UniformBounds(mean, max(start.cov_error, cov), D_2, D_4, standing)
