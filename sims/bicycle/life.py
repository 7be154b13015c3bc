"""What a bicycle may have of its own for a whole life: constants drawn at its beginning, and a
change of them at a certain age.  A new start after a fall leaves both as they are."""

from __future__ import annotations

from typing import Any, NamedTuple

from sims.rows import Function, Namespace

DRAWN = ("M_c", "M_p", "M_d", "h", "d_CM", "v", "l")
"""Constants that are drawn.  The centre of mass stays at its place along the wheelbase: ``c`` is
drawn with ``l``."""

CHANGING = ("v", "g", "d_CM", "c", "h", "M_c", "M_d", "M_p", "r")
"""Constants that may change in mid-ride: not the frame's own length, the handlebar's stop, and what
counts as a fall."""


class Numbers(NamedTuple):
    """The constants of a bicycle by the names and in the order of ``Physics``, over rows."""

    v: Any
    g: Any
    d_CM: Any
    c: Any
    h: Any
    l: Any  # noqa: E741
    M_c: Any
    M_d: Any
    M_p: Any
    r: Any
    theta_max: Any
    omega_max: Any


def factors_over(xp: Namespace) -> Function:
    """By what the constants ``DRAWN`` are multiplied, over rows: a function of seven uniforms and
    ``spread``; uniform within that of 1 either way."""
    factor = xp.jit(lambda uniform, spread: 1 + spread * (2 * uniform - 1))

    @xp.jit
    def factors(u, spread):
        return (
            *(factor(u[0], spread), factor(u[1], spread), factor(u[2], spread)),
            *(factor(u[3], spread), factor(u[4], spread), factor(u[5], spread)),
            factor(u[6], spread),
        )

    return factors


def multiplied(p: Any, f: Any) -> Numbers:
    """The constants ``p`` times the factors ``f`` of ``DRAWN``, over rows."""
    return Numbers(
        p.v * f[5],
        p.g,
        p.d_CM * f[4],
        p.c * f[6],
        p.h * f[3],
        p.l * f[6],
        p.M_c * f[0],
        p.M_d * f[2],
        p.M_p * f[1],
        p.r,
        p.theta_max,
        p.omega_max,
    )


def changed_over(xp: Namespace) -> Function:
    """The constants from the age of the change on, over rows: a function of the age in steps and
    the constants of ``Bicycle.rows``."""

    @xp.jit
    def changed(age, c):
        late = age >= c.change_step
        return Numbers(
            xp.where(late, c.later_v, c.v),
            xp.where(late, c.later_g, c.g),
            xp.where(late, c.later_d_CM, c.d_CM),
            xp.where(late, c.later_c, c.c),
            xp.where(late, c.later_h, c.h),
            c.l,
            xp.where(late, c.later_M_c, c.M_c),
            xp.where(late, c.later_M_d, c.M_d),
            xp.where(late, c.later_M_p, c.M_p),
            xp.where(late, c.later_r, c.r),
            c.theta_max,
            c.omega_max,
        )

    return changed
