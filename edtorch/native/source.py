"""From a plan to the text of its module."""

from __future__ import annotations

import hashlib
from collections.abc import Sequence
from typing import Any

import numpy as np

from edtorch.native.plan import KernelPlan
from edtorch.native.program import ModuleSource, fingerprint, module_text


def source_of(
    plan: KernelPlan, sim: Any, lanes: int
) -> tuple[ModuleSource, np.ndarray[Any, Any], tuple[float, ...]]:
    """The module of a plan, what kernels are given as ``number``, and the constants of the
    simulator, where the plan has its rows.

    Raises Unavailable for rows that cannot be told apart from others.
    """
    places, number = plan.number()
    c, rows = plan.constants, plan.rows
    text = module_text({**c, **places, "LANES": lanes}, plan.chosen)
    if rows is None:
        return ModuleSource(text, "", {}), number, ()
    key = fingerprint((rows.step, rows.observe, rows.outcome, rows.start, rows.stepped))
    text += _tuples(c)
    from sims.compiled_rows import compiled

    own = compiled(sim, hashlib.sha256((key + text).encode()).hexdigest()[:24])
    parts = {"world_step": own.step, "observe": own.observe, "outcome_of": own.outcome}
    parts |= {"start": own.start}
    if own.stepped is None:
        text += "@inner\ndef applies(state, constants):\n    return True\n"
    else:
        parts["applies"] = own.stepped
    return ModuleSource(text, key, parts), number, own.constants


def _tuples(c: dict[str, int]) -> str:
    """Functions that take tuples of rows from arrays and put them there: numba builds no tuple in a
    loop."""
    state = [f"z[(row + {i}) * LANES + l]" for i in range(c["WIDTH"])]
    action = [f"s[(ACTION + {i}) * LANES + l] * number[ACTION_SCALE + {i}]" for i in range(c["M"])]
    drawn = [f"uniform[l, t, {i}]" for i in range(c["DISTURBANCES"] + c["RESETS"])]
    seen = [
        f"s[(row + {i}) * LANES + l] = seen[{i}] / number[STATE_SCALE + {i}]" for i in range(c["N"])
    ]
    stored = [f"{place} = new[{i}]" for i, place in enumerate(state)]
    moved = [f"{place} = new[{i}] if moves else old[{i}]" for i, place in enumerate(state)]
    return "".join(
        (
            _function("state_at(z, row, l)", [_returned(state)]),
            _function("action_at(s, number, l)", [_returned(action)]),
            _function("uniforms_at(uniform, l, t)", [_returned(drawn[: c["DISTURBANCES"]])]),
            _function("resets_at(uniform, l, t)", [_returned(drawn[c["DISTURBANCES"] :])]),
            _function("store_state(z, row, new, l)", stored),
            _function("store_moved(z, row, old, new, moves, l)", moved),
            _function("store_seen(s, row, number, seen, l)", seen),
        )
    )


def _returned(places: Sequence[str]) -> str:
    return f"return ({', '.join(places)},)" if places else "return ()"


def _function(head: str, body: Sequence[str]) -> str:
    return "\n".join((f"@inner\ndef {head}:", *(f"    {line}" for line in body))) + "\n"
