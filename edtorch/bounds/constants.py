r"""What the error bounds assume of dynamics, noise and model, and how it is known.

The bounds hold where the constants are suprema over every state that the process reaches, every
mean s~_t, and the segments between them.  A number found by looking at some states is a lower bound
of such a supremum: it says how large the error may well be, not how large it can be.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

Provenance = Literal["analytic", "interval", "sampled"]
"""How a constant was obtained: on paper, by interval arithmetic, or from sampled states."""


class NonSmoothDynamics(ValueError):
    """The dynamics are not twice differentiable, so that the bounds do not exist."""


class NotCertified(ValueError):
    """A certificate was asked of numbers that only estimate."""


def require_bound(name: str, value: float, *, finite: bool = True) -> None:
    """Raise ValueError unless ``value`` is >= 0, not NaN and, if asked for, finite."""
    if math.isnan(value) or value < 0 or (finite and math.isinf(value)):
        raise ValueError(f"{name}={value}: expected a {'finite ' if finite else ''}number >= 0")


@dataclass(frozen=True)
class Constants:
    r"""Suprema over the states in question, for the closed loop (policy included).

    ============== ========= ================================================================
    lipschitz      L         sup |D mu|_2, over a convex set: |mu(s) - mu(s')| <= L |s - s'|
    curvature      m_mu      sup over s and |u| = 1 of |D^2 mu(s)[u, u]|
    noise_slope    M_nu      |nu(s) - nu(s')|_F <= M_nu |s - s'|
    noise_trace_   ell       |tr nu(s) - tr nu(s')| <= ell |s - s'|; None: sqrt(n) M_nu,
    slope                    which always holds
    noise_         M_nu2     sup over s and |u| = 1 of |D^2 nu(s)[u, u]|_F; infinite if unknown
    curvature
    reward_third   M_r       sup over s and |u| = 1 of |D^3 r_pi(s)[u, u, u]|
    ============== ========= ================================================================

    The paper's M_mu, M_nu and M_r are suprema of Frobenius norms; they are at least as large and
    may stand here too.  ``provenance`` is the weakest of the ways in which these numbers were
    obtained.  ``smooth`` says whether mu is C^2, nu C^1 and r_pi C^3 where the process goes; a
    joint limit or the end of an episode at a fall makes it false.

    Raises ValueError for negative, NaN or infinite numbers (``noise_curvature`` may be infinite).
    """

    lipschitz: float
    curvature: float
    noise_slope: float
    reward_third: float
    provenance: Provenance
    smooth: bool = True
    noise_trace_slope: float | None = None
    noise_curvature: float = math.inf

    def __post_init__(self) -> None:
        for name in ("lipschitz", "curvature", "noise_slope", "reward_third"):
            require_bound(name, getattr(self, name))
        if self.noise_trace_slope is not None:
            require_bound("noise_trace_slope", self.noise_trace_slope)
        require_bound("noise_curvature", self.noise_curvature, finite=False)
        if self.provenance not in ("analytic", "interval", "sampled"):
            raise ValueError(
                f"provenance={self.provenance!r}: expected 'analytic', 'interval' or 'sampled'"
            )

    def trace_slope(self, n: int) -> float:
        """ell for a state of n components."""
        if self.noise_trace_slope is None:
            return math.sqrt(n) * self.noise_slope
        return self.noise_trace_slope


@dataclass(frozen=True)
class NoiseLaw:
    r"""Fourth and third moments of the noise w = s_{t+1} - mu(s_t), given its covariance nu.

    E[|w|^4 | s] <= (tr nu)^2 + (kurtosis - 1) |nu|_F^2: equality for Gaussian noise of any
    covariance with kurtosis 3 (Isserlis), and for w = U diag(sqrt v) z with a fixed orthogonal U
    and independent z_i of variance 1 with E z_i^4 = kurtosis (uniform: 1.8).

    ``third`` is a bound of |E[w |w|^2 | s]|, 0 for a symmetric law.  Raises ValueError for a
    kurtosis below 1, which no law has.
    """

    kurtosis: float
    third: float = 0.0

    def __post_init__(self) -> None:
        if not 1 <= self.kurtosis < math.inf:
            raise ValueError(f"kurtosis={self.kurtosis}: expected a finite number >= 1")
        require_bound("third", self.third)


GAUSSIAN = NoiseLaw(3.0)
UNIFORM = NoiseLaw(1.8)


@dataclass(frozen=True)
class ModelError:
    """How far a learned model is from the truth, at every state in question.

    mean (eta): sup |mu - mu^|; cov (eta_nu): sup |nu - nu^|_F, for learned mu^, nu^.  The
    ``Constants`` and the path are then those of the learned model, the noise law is the truth's.
    """

    mean: float
    cov: float
    provenance: Provenance

    def __post_init__(self) -> None:
        require_bound("mean", self.mean)
        require_bound("cov", self.cov)


NO_MODEL_ERROR = ModelError(0.0, 0.0, "analytic")
