r"""edtorch: learn to control a continuous system from seconds of its own experience.

The Essential Dynamics algorithm (Martin, "The Essential Dynamics Algorithm: Fast Policy Search In
Continuous Worlds") in PyTorch.  One notation runs through every module:

=================  ==============================================================================
``s``, state       what the learner observes, ``[*batch, n]``, divided by the domain's scales
``a``, action      what it does, ``[*batch, m]``, in the same scaled units
``mu``             model: mean of the next state, mu~(s, a); mu_pi(s) = mu~(s, pi(s))
``nu``             model: covariance of the next state, nu~(s, a), ``[*batch, n, n]``
``mean``, ``cov``  s~ and Sigma of a ``Belief``, a state of the deterministic process M' (section 3)
``policy``, theta  pi(s) = theta . phi(s), ``[*batch, m, k]``
``tau``            step of the unroll, 1..T; T is the horizon (the paper's n)
``discount``       gamma: per step in the discrete form, per second in the derivative form
``alpha, beta``    the policy step theta += alpha g / (beta + |g|) (section 4)
``dt``             seconds: of the simulator's tick, or (``unroll.dt``, the paper's Delta) of the
                   Euler step that integrates the model; the two are independent
=================  ==============================================================================

Rewards are maximised; costs are negative rewards.  Everything takes a leading batch axis, so that a
population of learners is one more dimension.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

import edtorch.renamed as _renamed
from edtorch.beside import claim as _claim
from edtorch.types import Belief, LearnerState, Metrics, Trajectory, Transition

if TYPE_CHECKING:
    from edtorch.api import learn, load
    from edtorch.app.acting import LearnedPolicy
    from edtorch.app.learned import Run

_renamed.install()
_claim("sims")  # which registers edtorch/Bicycle-v0 with Gymnasium

__version__ = "0.1.0"

_LAZY = {
    "LearnedPolicy": "edtorch.app.acting",
    "Run": "edtorch.app.learned",
    "learn": "edtorch.api",
    "load": "edtorch.api",
}
"""Names that are imported when they are first asked for: they need much of the package."""


def __getattr__(name: str) -> Any:
    if name not in _LAZY:
        raise AttributeError(f"module 'edtorch' has no attribute {name!r}")
    value = getattr(importlib.import_module(_LAZY[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *_LAZY})


__all__ = [
    "Belief",
    "LearnedPolicy",
    "LearnerState",
    "Metrics",
    "Run",
    "Trajectory",
    "Transition",
    "__version__",
    "learn",
    "load",
]
