"""What kernels are given of a policy whose parameters are one vector."""

from __future__ import annotations

from pathlib import Path

import edtorch.search.kernels
from edtorch.native.plan import KernelPlan
from edtorch.policy.vector import VectorPolicy

_RAW = Path(edtorch.search.kernels.__file__).parent
"""Where the raw actions of each kind are; searches use the same text."""
_ACTS = Path(__file__).parent / "kernels" / "vector.py"


def add_vector(plan: KernelPlan, policy: VectorPolicy, states: int, actions: int) -> None:
    """Its sizes, numbers and text, and the function that acts by it."""
    squash, arrays = policy.squash, policy.arrays
    plan.chosen["acts"] = "act_by_vector"
    plan.constants |= {"N": states, "M": actions, "OWN": policy.size}
    plan.numbers |= {f"FORM_{i}": array for i, array in enumerate(arrays)}
    plan.numbers |= {"SQUASH_MIDDLE": squash.middle, "SQUASH_HALF": squash.half}
    parts = [
        f"number[FORM_{i} : FORM_{i} + {array.size}].reshape({array.shape})"
        for i, array in enumerate(arrays)
    ]
    plan.texts += [
        (_RAW / f"{policy.kernel}.py").read_text(encoding="utf-8"),
        f"@inner\ndef form_of(number):\n    return ({', '.join(parts)},)\n",
        _ACTS.read_text(encoding="utf-8"),
    ]
