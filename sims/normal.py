"""Normal numbers from uniform ones, with the same digits whatever the batch."""

from __future__ import annotations

from typing import Any

from torch import Tensor

from sims.rows import TORCH, Function, Namespace

# M. J. Wichura, "Algorithm AS 241: the percentage points of the normal distribution", Applied
# Statistics 37, 1988, routine PPND16: right to about 1e-16.  Constant terms first.
_CENTRE = (
    (3.3871328727963666080e0, 1.3314166789178437745e2, 1.9715909503065514427e3,
     1.3731693765509461125e4, 4.5921953931549871457e4, 6.7265770927008700853e4,
     3.3430575583588128105e4, 2.5090809287301226727e3),
    (1.0, 4.2313330701600911252e1, 6.8718700749205790830e2, 5.3941960214247511077e3,
     2.1213794301586595867e4, 3.9307895800092710610e4, 2.8729085735721942674e4,
     5.2264952788528545610e3),
)  # fmt: skip
_FLANK = (
    (1.42343711074968357734e0, 4.63033784615654529590e0, 5.76949722146069140550e0,
     3.64784832476320460504e0, 1.27045825245236838258e0, 2.41780725177450611770e-1,
     2.27238449892691845833e-2, 7.74545014278341407640e-4),
    (1.0, 2.05319162663775882187e0, 1.67638483018380384940e0, 6.89767334985100004550e-1,
     1.48103976427480074590e-1, 1.51986665636164571966e-2, 5.47593808499534494600e-4,
     1.05075007164441684324e-9),
)  # fmt: skip
_TAIL = (
    (6.65790464350110377720e0, 5.46378491116411436990e0, 1.78482653991729133580e0,
     2.96560571828504891230e-1, 2.65321895265761230930e-2, 1.24266094738807843860e-3,
     2.71155556874348757815e-5, 2.01033439929228813265e-7),
    (1.0, 5.99832206555887937690e-1, 1.36929880922735805310e-1, 1.48753612908506148525e-2,
     7.86869131145613259100e-4, 1.84631831751005468180e-5, 1.42151175831644588870e-7,
     2.04426310338993978564e-15),
)  # fmt: skip

_LEAST = 2.0**-54
"""Half of the least step between the uniform numbers of a generator of 53 bits."""


def normal_quantile_over(xp: Namespace) -> Function:
    """The inverse of the normal distribution function over rows: standard normal numbers from
    float64 uniform ones in [0, 1].

    Finite also at 0 and 1 (+-8.2), which rounding to fewer bits can make of other numbers.
    """
    polynomial = xp.jit(_polynomial)

    @xp.jit
    def quantile(uniform):
        p = xp.maximum(xp.minimum(uniform, 1 - 2 * _LEAST), _LEAST)
        q = p - 0.5
        # The rarer end first: 1 - p is exact there.
        r = xp.sqrt(-xp.log(xp.minimum(p, 1 - p)))
        flank = polynomial(_FLANK[0], r - 1.6) / polynomial(_FLANK[1], r - 1.6)
        tail = polynomial(_TAIL[0], r - 5.0) / polynomial(_TAIL[1], r - 5.0)
        outer = xp.where(r <= 5.0, flank, tail)
        outer = xp.where(q < 0, -outer, outer)
        x = 0.180625 - q * q
        centre = q * (polynomial(_CENTRE[0], x) / polynomial(_CENTRE[1], x))
        return xp.where(xp.abs(q) <= 0.425, centre, outer)

    return quantile


def _polynomial(terms: tuple[float, ...], x: Any) -> Any:
    value = terms[7] * x + terms[6]
    for k in range(5, -1, -1):
        value = value * x + terms[k]
    return value


_QUANTILE = normal_quantile_over(TORCH)


def normal_quantile(uniform: Tensor) -> Tensor:
    """That inverse for a tensor of any shape."""
    return _QUANTILE(uniform.contiguous())
