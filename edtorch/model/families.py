"""Families of mechanism models, as a configuration names them."""

from __future__ import annotations

from dataclasses import dataclass

from edtorch.model.chain import chain
from edtorch.model.lift import Lift
from edtorch.model.mechanism import Structure
from edtorch.model.terms import Terms
from edtorch.model.told import Told


def _at_least_one(degree: int) -> None:
    if degree < 1:
        raise ValueError(f"degree={degree}: expected an integer >= 1")


@dataclass(frozen=True)
class ImplicitModel:
    """Each acceleration linear in the others: the equations of a mechanism (``Terms.implicit``)."""

    degree: int = 2

    def __post_init__(self) -> None:
        """Refuse impossible settings."""
        _at_least_one(self.degree)

    def structures(self, told: Told) -> dict[str, Structure]:
        """The one structure, by name."""
        lift = Lift.of(told)
        return {"implicit": Structure.of(told, lift, Terms.implicit(told, lift, self.degree))}


@dataclass(frozen=True)
class ChainModel:
    """Each acceleration linear in the others: a planar chain of links, whose angles are measured
    from one direction in space (``edtorch.model.chain``)."""

    def structures(self, told: Told) -> dict[str, Structure]:
        """The one structure, by name.  Raises ValueError for what is no chain."""
        lift = Lift.of(told)
        return {"chain": Structure.of(told, lift, *chain(told, lift))}


@dataclass(frozen=True)
class ProductModel:
    """Accelerations by products of trigonometric terms, rates and actions (``Terms.products``)."""

    degree: int = 3

    def __post_init__(self) -> None:
        """Refuse impossible settings."""
        _at_least_one(self.degree)

    def structures(self, told: Told) -> dict[str, Structure]:
        """The one structure, by name."""
        lift = Lift.of(told)
        return {"products": Structure.of(told, lift, Terms.products(told, lift, self.degree))}


@dataclass(frozen=True)
class MonomialModel:
    """Accelerations by all monomials of the lift (``Terms.monomials``): no mechanism is told."""

    degree: int = 4

    def __post_init__(self) -> None:
        """Refuse impossible settings."""
        _at_least_one(self.degree)

    def structures(self, told: Told) -> dict[str, Structure]:
        """The one structure, by name."""
        lift = Lift.of(told)
        return {"monomials": Structure.of(told, lift, Terms.monomials(told, lift, self.degree))}


@dataclass(frozen=True)
class BestModel:
    """The family that predicts held-out data best, of all of them (``edtorch.model.held_out``)."""

    implicit: ImplicitModel = ImplicitModel()
    products: ProductModel = ProductModel()
    monomials: MonomialModel = MonomialModel()

    def structures(self, told: Told) -> dict[str, Structure]:
        """All of them by name, those with fewer terms first."""
        families = (self.implicit, self.products, self.monomials)
        found = {n: s for family in families for n, s in family.structures(told).items()}
        return dict(sorted(found.items(), key=lambda item: item[1].terms.count))
