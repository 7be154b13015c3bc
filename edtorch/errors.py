"""What can be wrong with an input, with numbers or with optional packages, by name."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager


class ShapeError(ValueError):
    """A tensor, or what a function returned, has the wrong shape."""


class NonFiniteError(ValueError):
    """An input holds NaN or infinity."""


class AsymmetryError(ValueError):
    """A covariance is not symmetric, beyond rounding."""


class IndefiniteError(ValueError):
    """A covariance has a negative eigenvalue, beyond rounding."""


class NonSmoothError(ValueError):
    """A reward has no second derivatives, and the transform takes them."""


class FitError(ValueError):
    """Data from which no model can be fitted."""


class Contradicted(ValueError):
    """What is told cannot be true of the data, whatever is added to them."""


class NoPlan(ValueError):
    """No start led to a plan whose numbers are finite."""


class Unavailable(RuntimeError):
    """A package, or what it is to compile, cannot be used here; one line that says why."""


@contextmanager
def within(part: str) -> Iterator[None]:
    """Turn a part's ``ValueError("width=0: ...")`` into the whole's ``part.width=0: ...``."""
    try:
        yield
    except ValueError as error:
        raise ValueError(f"{part}.{error}") from error


class CovarianceFloored(UserWarning):
    """A covariance lost its positive semidefiniteness on the way and was floored from there on."""
