r"""Theorems 1-4 (section 3) for one step, as printed and corrected, as functions of plain numbers.

Notation: X ~ P_t is the state, delta = X - s~_t, epsilon = E X - s~_t, C = cov X,
E = C - Sigma~_t, J = D mu(s~_t), D_p = E |delta|^p, so that D_2 = tr C + |epsilon|^2.

As printed, Theorem 1 is false for every n >= 10 and Theorem 2 already for n = 1; ``docs/theory.md``
has the counterexamples and the proofs of the corrected forms.  The printed forms stand here to be
compared with, never to be relied upon.
"""

from __future__ import annotations

import math
from collections.abc import Sequence


def printed_mean_bound(*, mean_error: float, M_mu: float, M: float) -> float:
    r"""Theorem 1 as printed: $(|\epsilon| + M_\mu)(\frac32 M + \frac12 |\epsilon|^2)$.

    M bounds both |D mu(s~)| and |C|_F.  True for n <= 9, false in general for n >= 10.
    """
    return (mean_error + M_mu) * (1.5 * M + 0.5 * mean_error**2)


def mean_remainder(*, curvature: float, second_moment: float) -> float:
    r"""What curvature adds to the error of the mean: $\frac12 m_\mu D_2$."""
    return 0.5 * curvature * second_moment


def corrected_mean_bound(
    *, jacobian: float, mean_error: float, curvature: float, second_moment: float
) -> float:
    r"""Theorem 1 corrected (T1): $|\epsilon_{t+1}| \le |J|_2 |\epsilon| + \frac12 m_\mu D_2$.

    jacobian is |J|_2.  Its constant cannot be improved in any dimension.
    """
    return jacobian * mean_error + mean_remainder(curvature=curvature, second_moment=second_moment)


def printed_covariance_bound(
    *, cov_error: float, mean_error: float, M_mu: float, M_nu: float, M: float
) -> float:
    r"""Theorem 2 as printed, without its O(|epsilon|).

    $(|E|_F + |\epsilon| + M_\mu + M_\nu) \cdot 10 M^2$.  False in general, already for n = 1.
    """
    return (cov_error + mean_error + M_mu + M_nu) * 10 * M**2


def noise_change(
    *,
    noise_slope: float,
    second_moment: float,
    noise_gradient: float,
    mean_error: float,
    noise_curvature: float,
) -> float:
    r"""Bound N of $|E\,\nu(X) - \nu(\tilde s)|_F$.

    $\min\{M_\nu \sqrt{D_2},\ |D\nu(\tilde s)|\,|\epsilon| + \frac12 M_{\nu 2} D_2\}$, where
    noise_gradient is the largest |D nu(s~)[u]|_F over |u| = 1.
    """
    first = noise_slope * math.sqrt(second_moment)
    if math.isinf(noise_curvature):
        return first
    return min(first, noise_gradient * mean_error + 0.5 * noise_curvature * second_moment)


def covariance_remainder(
    *, noise_change: float, curvature: float, pushed_trace: float, fourth_moment: float
) -> float:
    r"""What noise and curvature add to the error of the covariance.

    $N + m_\mu \sqrt{\mathrm{tr}(JCJ') D_4} + \frac14 m_\mu^2 D_4$; pushed_trace is tr(JCJ').
    """
    cross = curvature * math.sqrt(pushed_trace) * math.sqrt(fourth_moment)
    return noise_change + cross + 0.25 * curvature * curvature * fourth_moment


def corrected_covariance_bound(
    *,
    jacobian: float,
    cov_error: float,
    noise_change: float,
    curvature: float,
    pushed_trace: float,
    fourth_moment: float,
) -> float:
    r"""Theorem 2 corrected (T2).

    $|E_{t+1}|_F \le |J|_2^2 |E|_F + N + m_\mu\sqrt{\mathrm{tr}(JCJ')D_4} + \frac14 m_\mu^2 D_4$;
    N is ``noise_change``.  epsilon enters only through D_2 and D_4.
    """
    return jacobian * jacobian * cov_error + covariance_remainder(
        noise_change=noise_change,
        curvature=curvature,
        pushed_trace=pushed_trace,
        fourth_moment=fourth_moment,
    )


def printed_reward_bound(*, cov_error: float, mean_error: float, M_r: float, M: float) -> float:
    r"""Theorem 3 as printed, without its O(|epsilon|): $(|E|_F + |\epsilon| + M_r)\frac53 M$.

    True where M bounds the moments E|s - E s|^k, k = 1..4, once ``printed_reward_order`` is added
    to 5/3 M.
    """
    return (cov_error + mean_error + M_r) * 5 / 3 * M


def printed_reward_order(*, mean_error: float, M: float) -> float:
    r"""What Theorem 3's O(|epsilon|) can be, if M bounds the moments E|s - E s|^k, k = 1..4.

    $|\epsilon|(\frac12 M + \frac12 M^{2/3} + \frac12 M^{1/3}|\epsilon| + \frac16|\epsilon|^2)$.
    """
    root = M ** (1 / 3)
    return mean_error * (0.5 * M + 0.5 * root**2 + 0.5 * root * mean_error + mean_error**2 / 6)


def reward_remainder(
    *, hessian: float, mean_error: float, reward_third: float, third_moment: float
) -> float:
    r"""What is not linear in epsilon and E: $\frac12|D^2r|_2|\epsilon|^2 + \frac16 M_r D_3$."""
    return 0.5 * hessian * mean_error * mean_error + reward_third * third_moment / 6


def corrected_reward_bound(
    *,
    gradient: float,
    mean_error: float,
    hessian_frobenius: float,
    cov_error: float,
    hessian: float,
    reward_third: float,
    third_moment: float,
) -> float:
    r"""Theorem 3 corrected (T3).

    $|\nabla r||\epsilon| + \frac12|D^2r|_F|E|_F + \frac12|D^2r|_2|\epsilon|^2 + \frac16 M_r D_3$,
    with $D_3 \le \sqrt{D_2 D_4}$; derivatives are of r_pi at s~, hessian is |D^2 r|_2.
    """
    linear = gradient * mean_error + 0.5 * hessian_frobenius * cov_error
    return linear + reward_remainder(
        hessian=hessian,
        mean_error=mean_error,
        reward_third=reward_third,
        third_moment=third_moment,
    )


def printed_value_bound(*, discount: float, steps: int, reward_error: float) -> float:
    r"""Theorem 4: $\frac{1-\gamma^{n+1}}{1-\gamma} M_{er}$, n = steps; n + 1 where gamma = 1.

    reward_error M_er bounds the error of each of the n + 1 expected rewards.  Printed with "<";
    constant errors attain it.  Raises ValueError for steps < 0 or a discount outside [0, 1].
    """
    if steps < 0:
        raise ValueError(f"steps={steps}: expected a number >= 0")
    return value_bound(discount=discount, reward_errors=[reward_error] * (steps + 1))


def value_bound(*, discount: float, reward_errors: Sequence[float]) -> float:
    r"""Theorem 4, tighter: $\sum_{k=0}^n \gamma^k |\epsilon^r_{t+k}|$.

    Raises ValueError for a discount outside [0, 1].
    """
    if not 0 <= discount <= 1:
        raise ValueError(f"discount={discount}: expected a number in [0, 1]")
    return math.fsum(discount**k * error for k, error in enumerate(reward_errors))
