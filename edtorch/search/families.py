"""Kinds of stationary policies to search among, as a configuration names them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Protocol

from edtorch.model.lift import Lift
from edtorch.model.terms import Terms
from edtorch.policy.bounded import BoundedPolicy, OddPolicy
from edtorch.policy.lifted import LiftedPolicy
from edtorch.policy.network import NetworkPolicy
from edtorch.policy.radial import RadialPolicy
from edtorch.policy.squash import Squash


class PolicyFamily(Protocol):
    """Policies of the lift of these ``components`` of the state."""

    def policy(
        self, lift: Lift, components: Sequence[int], squash: Squash, *, odd: bool
    ) -> BoundedPolicy:
        """The policy; odd: one that acts the other way in the mirror image."""
        ...


@dataclass(frozen=True)
class MonomialPolicies:
    """Linear in the monomials up to ``degree`` (``edtorch.policy.lifted``)."""

    degree: int = 3

    def __post_init__(self) -> None:
        """Reject invalid settings."""
        if self.degree < 1:
            raise ValueError(f"degree={self.degree}: expected an integer >= 1")

    def policy(
        self, lift: Lift, components: Sequence[int], squash: Squash, *, odd: bool
    ) -> BoundedPolicy:
        """See ``PolicyFamily``: of odd monomials alone."""
        return LiftedPolicy(lift, Terms.of_state(lift, components, self.degree, odd=odd), squash)


MONOMIALS = MonomialPolicies()


@dataclass(frozen=True)
class RadialPolicies:
    """Radial basis functions (``edtorch.policy.radial``)."""

    centres: int = 30
    width: float = 0.5
    normalised: bool = True

    def policy(
        self, lift: Lift, components: Sequence[int], squash: Squash, *, odd: bool
    ) -> BoundedPolicy:
        """See ``PolicyFamily``."""
        given = (self.centres, self.width, self.normalised)
        found = RadialPolicy(lift, components, squash, *given)
        return OddPolicy(found) if odd else found


@dataclass(frozen=True)
class NetworkPolicies:
    """Networks with layers of ``hidden`` units (``edtorch.policy.network``)."""

    hidden: Sequence[int] = (32, 32)

    def policy(
        self, lift: Lift, components: Sequence[int], squash: Squash, *, odd: bool
    ) -> BoundedPolicy:
        """See ``PolicyFamily``."""
        found = NetworkPolicy(lift, components, squash, self.hidden)
        return OddPolicy(found) if odd else found
