"""Plans for worlds in which nobody learns by a model."""

from __future__ import annotations

from collections.abc import Mapping

from edtorch.native.plan import KernelPlan, add_world, begun, place
from edtorch.run.scaled_sim import World


def plan_of_world(world: World, kept: Mapping[str, int], counted: Mapping[str, int]) -> KernelPlan:
    """A plan whose episodes end by the world's own rules and have no return.

    kept, counted: rows that a kernel keeps from tick to tick beside the world's, numbers and
    integers, by name with their width.  ``Z``, ``COUNTERS`` and ``SCRATCH`` say how many rows there
    are.  Raises NoKernel.
    """
    plan = begun(world)
    add_world(plan, world)
    assert plan.rows is not None
    n, m, width = len(world.spec.state), len(world.spec.action), plan.rows.width
    flags = dict.fromkeys(("VALID", "OUTCOME", "LIVES", "DEVIATE"), 1)
    plan.constants |= {"N": n, "M": m, "WIDTH": width, "EARNS": 0, "RETURN_DECIDES": 0}
    plan.constants |= {
        "Z": place(plan, {"WORLD": width, "OBSERVATION": n, "EARNED": 1, **kept}),
        "COUNTERS": place(plan, {"ACTIVE": 1, "BEGUN": 1, **counted}),
        "SCRATCH": place(plan, {"ACTION": m, "NEXT": n, **flags}),
        "UNIFORMS": world.uniforms,
    }
    return plan
