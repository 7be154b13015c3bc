r"""How far the transformed process can be from the true one (Theorems 1-4 of section 3).

``theorems`` has the theorems for one step, printed and corrected; ``bound_errors`` chains the
corrected ones along an unroll and says whether the result is a certificate or an estimate.
Everything concerns the first-order transform (``edtorch.transform.FirstOrder``); ``docs/theory.md``
has the proofs.
"""

from edtorch.bounds.constants import (
    GAUSSIAN,
    NO_MODEL_ERROR,
    UNIFORM,
    Constants,
    ModelError,
    NoiseLaw,
    NonSmoothDynamics,
    NotCertified,
    Provenance,
)
from edtorch.bounds.moments import StartLaw, fourth_moment, gaussian_fourth_moment
from edtorch.bounds.path import Path, first_order_path
from edtorch.bounds.recursion import bound_errors, definition_weights, horizon_weights
from edtorch.bounds.result import ErrorBounds, Standing
from edtorch.bounds.sampling import sampled_constants
from edtorch.bounds.theorems import (
    corrected_covariance_bound,
    corrected_mean_bound,
    corrected_reward_bound,
    noise_change,
    printed_covariance_bound,
    printed_mean_bound,
    printed_reward_bound,
    printed_reward_order,
    printed_value_bound,
    value_bound,
)
from edtorch.bounds.tube import tube_radii
from edtorch.bounds.uniform import UniformBounds, uniform_bounds

__all__ = [
    "GAUSSIAN",
    "NO_MODEL_ERROR",
    "UNIFORM",
    "Constants",
    "ErrorBounds",
    "ModelError",
    "NoiseLaw",
    "NonSmoothDynamics",
    "NotCertified",
    "Path",
    "Provenance",
    "Standing",
    "StartLaw",
    "UniformBounds",
    "bound_errors",
    "corrected_covariance_bound",
    "corrected_mean_bound",
    "corrected_reward_bound",
    "definition_weights",
    "first_order_path",
    "fourth_moment",
    "gaussian_fourth_moment",
    "horizon_weights",
    "noise_change",
    "printed_covariance_bound",
    "printed_mean_bound",
    "printed_reward_bound",
    "printed_reward_order",
    "printed_value_bound",
    "sampled_constants",
    "tube_radii",
    "uniform_bounds",
    "value_bound",
]
