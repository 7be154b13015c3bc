"""The map from a stochastic process to a deterministic one over (mean, covariance) (section 3).

A transform is chosen by object, one file each:

================  ==============================================================================
``MeanOnly``      the mean alone (the paper's bicycle, section 4)
``FirstOrder``    mean and covariance to first order (eq. 2; the paper's section 3)
``SecondOrder``   with the curvature of the closed loop; makes the error estimate
``Cubature``      2n points, no derivatives: best accuracy for its cost
``GaussHermite``  order^n points, ``MonteCarlo`` random ones: references for tests
================  ==============================================================================

Any of them takes a tick that crosses a guard: ``Guarded``, with ``HeldLoop`` for its actions.
"""

from edtorch.transform.base import Transform
from edtorch.transform.cubature import Cubature
from edtorch.transform.first import FirstOrder
from edtorch.transform.gauss_hermite import GaussHermite
from edtorch.transform.guarded import (
    Event,
    Guarded,
    HeldLoop,
    crossing_probability,
    saltation,
)
from edtorch.transform.mean_only import MeanOnly
from edtorch.transform.monte_carlo import MonteCarlo
from edtorch.transform.noise import ConstantNoise, PositiveNoise
from edtorch.transform.second import SecondOrder
from edtorch.transform.start import data_belief, point_belief

__all__ = [
    "ConstantNoise",
    "Cubature",
    "Event",
    "FirstOrder",
    "GaussHermite",
    "Guarded",
    "HeldLoop",
    "MeanOnly",
    "MonteCarlo",
    "PositiveNoise",
    "SecondOrder",
    "Transform",
    "crossing_probability",
    "data_belief",
    "point_belief",
    "saltation",
]
