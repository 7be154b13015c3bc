"""Gauss and Newton's method in the weights of a stationary policy, through time.

The cost is that of roll-outs from several starts; forward sensitivities ds_t/dtheta give its
residuals' Jacobian, and so its Hessian without second derivatives.  Levenberg and Marquardt's
damping in proportion to the Hessian's diagonal (Marquardt, "An algorithm for least-squares
estimation of nonlinear parameters", 1963).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from edtorch.model.terms import Terms
from edtorch.search.plan import Cost
from edtorch.search.program import kernels
from edtorch.search.shooting import planning_problem
from edtorch.search.tick_model import TickModel, product_tree, real, whole


@dataclass(frozen=True, eq=False)
class Weighted:
    """z = theta phi(A(s)): ``terms`` phi of the lift, F of them, and ``weight`` theta ``[m, F]``.

    cost: mean over the starts that it was fitted to.
    """

    terms: Terms
    weight: np.ndarray
    cost: float = np.nan

    @property
    def products(self) -> tuple[np.ndarray, ...]:
        """The tree of the terms, as kernels take it."""
        return tuple(whole(part, np.int64) for part in product_tree(self.terms.factors))


@dataclass(frozen=True)
class PolicyDescent:
    """How a policy is improved: as ``edtorch.search.shooting.Descent``, with whole steps alone.

    least: what the diagonal of the Hessian counts at least, as a share of its largest entry.
    """

    damping: float = 1e-2
    easier: float = 0.3
    harder: float = 4.0
    most: float = 1e4
    limit: int = 40
    tolerance: float = 1e-3
    least: float = 1e-4


POLICY_DESCENT = PolicyDescent()


def expansion(
    model: TickModel, cost: Cost, policy: Weighted, start: np.ndarray
) -> tuple[float, np.ndarray, np.ndarray]:
    """Mean cost from starts ``[S, n]``, inf where one is not finite; gradient ``[P]`` and Hessian
    ``[P, P]`` by Gauss and Newton in theta, row by row, P = m F.

    Raises ValueError for arrays that do not fit each other, Unavailable where the kernels cannot be
    compiled.
    """
    size = policy.weight.size
    gradient, hessian = np.zeros(size), np.zeros((size, size))
    given = _arguments(model, cost, policy, start)
    found = kernels()["policy_expansion"](*given, gradient, hessian)
    return found, gradient, hessian


def descend(
    model: TickModel,
    cost: Cost,
    policy: Weighted,
    start: np.ndarray,
    descent: PolicyDescent = POLICY_DESCENT,
) -> Weighted:
    """The policy improved for these starts ``[S, n]``; its cost is inf where it was from the first.

    Errors as for ``expansion``.
    """
    damping = descent.damping
    value, gradient, hessian = expansion(model, cost, policy, start)
    policy = replace(policy, cost=value)
    for _ in range(descent.limit):
        if not np.isfinite(value):
            break
        diagonal = np.maximum(hessian.diagonal(), descent.least * hessian.diagonal().max())
        step = np.linalg.solve(hessian + damping * np.diag(diagonal + 1e-12), gradient)
        trial = replace(policy, weight=policy.weight - step.reshape(policy.weight.shape))
        new = kernels()["policy_cost"](*_arguments(model, cost, trial, start))
        if not new < value:
            damping *= descent.harder
            if damping > descent.most:
                break
            continue
        gained, damping = value - new, max(damping * descent.easier, 1e-9)
        policy = replace(trial, cost=new)
        if gained <= descent.tolerance * value:
            break
        value, gradient, hessian = expansion(model, cost, policy, start)
    return policy


def _arguments(
    model: TickModel, cost: Cost, policy: Weighted, start: np.ndarray
) -> tuple[Any, ...]:
    shape = (len(model.half), policy.terms.count)
    if policy.weight.shape != shape:
        raise ValueError(f"weight: shape {policy.weight.shape}: expected {shape}")
    given = planning_problem(model, cost)
    return (*given, policy.products, real(policy.weight), real(start))
