"""From a plan to its module: the text of the kernels with what the plan and the simulator add."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

import sims.rows
from edtorch.compiled import ModuleSource
from edtorch.native.fingerprint import fingerprint
from edtorch.native.plan import KernelPlan
from sims.base import Outcome

FOLDER = Path(__file__).parent / "kernels"
_TEXTS = (
    *("learn.py", "improve.py", "live.py", "ticks.py", "rides.py", "apart.py"),
    *("hashing.py", "episodes.py", "sarsa.py"),
)
_ROWS_BY = tuple(
    Path(sims.rows.__file__).with_name(name) for name in ("compiled_rows.py", "elementary.py")
)
"""What a simulator's rows are compiled with."""


def source_of(
    plan: KernelPlan, sim: Any, lanes: int
) -> tuple[ModuleSource, np.ndarray[Any, Any], tuple[float, ...]]:
    """The module of a plan, what kernels are given as ``number``, and the constants of the
    simulator, where the plan has its rows.

    Raises Unavailable for rows that cannot be told apart from others.
    """
    places, number = plan.number()
    c, rows = plan.constants, plan.rows
    text = _module_text(plan, {**c, **places, "LANES": lanes})
    if rows is None:
        return ModuleSource(text, "", {}), number, ()
    by = hashlib.sha256(b"".join(file.read_bytes() for file in _ROWS_BY)).hexdigest()
    own_code = fingerprint((rows.step, rows.observe, rows.outcome, rows.start, rows.stepped))
    key = f"{by}\n{own_code}"
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


def _module_text(plan: KernelPlan, constants: Mapping[str, object]) -> str:
    """The text of a module: ``constants``, the kernels, and the plan's own texts and roles."""
    lines = ["import math", "import numpy as np"]
    lines += [f"{outcome.name} = {int(outcome)}" for outcome in Outcome]
    lines += [f"{name} = {value!r}" for name, value in sorted(constants.items())]
    lines += [(FOLDER / name).read_text(encoding="utf-8") for name in _TEXTS]
    lines += plan.texts
    lines += [f"{role} = {function}" for role, function in sorted(plan.chosen.items())]
    return "\n".join(lines) + "\n"


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
