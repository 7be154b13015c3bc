"""Policies that are linear in monomials, improved one by one by Gauss and Newton's method."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch

from edtorch.policy.bounded import BoundedPolicy
from edtorch.search.improver import Improved, PolicyTask, side_by_side
from edtorch.search.policy_descent import Weighted, descend
from edtorch.types import Parameters


@dataclass(frozen=True)
class GaussNewton:
    """On the model as it is (``edtorch.search.policy_descent``)."""

    def check(self, policy: BoundedPolicy) -> None:
        """See ``Improver``."""
        if policy.linear_terms is None:
            raise ValueError(
                f"search.improver: GaussNewton cannot improve a {policy.label}; expected"
                " search/policy=monomials with it, or search/improver=adam"
            )

    def improve(self, task: PolicyTask, fresh: Parameters, warm: Parameters) -> Improved:
        """See ``Improver``."""
        terms = task.policy.linear_terms
        assert terms is not None
        start, found = task.starts.numpy(), list[Weighted]()
        horizons = [task.growing] * len(fresh["weight"]) + [[task.ticks]] * len(warm["weight"])
        for weight, ticks in zip(
            side_by_side(fresh, warm)["weight"].numpy(), horizons, strict=True
        ):
            policy = Weighted(terms, weight)
            for each in ticks:
                policy = descend(task.model, task.cost(each), policy, start)
            found.append(policy)
        improved = torch.from_numpy(np.stack([policy.weight for policy in found]))
        return Improved({"weight": improved}, np.array([policy.cost for policy in found]))


GAUSS_NEWTON = GaussNewton()
