"""What kernels are given of a policy by a phase."""

from __future__ import annotations

from edtorch.native.plan import KernelPlan
from edtorch.policy.phase import PhasePolicy


def add_phase(plan: KernelPlan, policy: PhasePolicy) -> None:
    """Its sizes and numbers, and the function that acts by it."""
    form, squash = policy.form, policy.squash
    plan.chosen["acts"] = "act_by_phase"
    plan.constants |= {
        "N": form.joint.shape[1],
        "M": form.drive.shape[0],
        "OWN": policy.size,
        "PHASE_JOINTS": form.joint.shape[0],
        "PHASE_POINTS": form.binomial.shape[1],
    }
    plan.numbers |= {
        "PHASE_ROWS": form.phase,
        "PHASE_JOINT": form.joint,
        "PHASE_RATE": form.rate,
        "PHASE_GAIN": form.gain,
        "PHASE_BINOMIAL": form.binomial,
        "PHASE_PLACE": form.place,
        "PHASE_DRIVE": form.drive,
        "PHASE_MIDDLE": squash.middle,
        "PHASE_HALF": squash.half,
    }
