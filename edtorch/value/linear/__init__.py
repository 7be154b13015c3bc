"""The value of a linear closed loop under a quadratic reward, exactly, by recursion.

``mean``: the mean alone; ``moment``: mean and covariance, by the second moment; ``ignorance``: with
what the model does not know counted as noise; ``lqr``: the optimum that Riccati's recursion finds,
and the stationary covariance.
"""

from edtorch.value.linear.ignorance import LinearIgnorance
from edtorch.value.linear.mean import LinearMeanOnly, mean_value_and_gradient
from edtorch.value.linear.moment import LinearMoment, moment_value_and_gradient

__all__ = [
    "LinearIgnorance",
    "LinearMeanOnly",
    "LinearMoment",
    "mean_value_and_gradient",
    "moment_value_and_gradient",
]
