"""Compiled ticks as functions of tensors: beside the eager model, and their derivatives."""

from __future__ import annotations

import numpy as np
import torch
from torch.autograd import gradcheck

from edtorch.model.mechanism import runge_kutta, runge_kutta_jacobian
from edtorch.search.ticks import CompiledTicks, drawn_ticks
from tests.planning import swing_up
from tests.systems import normal

MODEL = swing_up()
WEIGHT = torch.from_numpy(MODEL.weight)


def _where(*batch: int) -> tuple[torch.Tensor, torch.Tensor]:
    generator = torch.Generator().manual_seed(0)
    return normal(generator, *batch, 4), normal(generator, *batch, 1)


def test_they_are_the_eager_models() -> None:
    state, action = _where(3, 2)
    ticks, about = CompiledTicks(MODEL), (MODEL.structure, WEIGHT)
    after = runge_kutta(*about, state, action, MODEL.dt, MODEL.substeps)
    by = runge_kutta_jacobian(*about, state, action, MODEL.dt, MODEL.substeps)
    assert torch.allclose(ticks(state, action), after, atol=1e-10)
    assert torch.allclose(ticks.jacobian(state, action), by, atol=1e-9)


def test_torch_differentiates_them() -> None:
    """Reverse mode beside finite differences: of s' exactly, of its Jacobian by differences."""
    state, action = (x.requires_grad_() for x in _where(2))
    ticks = CompiledTicks(MODEL)
    assert gradcheck(ticks, (state, action))
    assert gradcheck(ticks.jacobian, (state, action), atol=1e-5)


def test_each_course_has_weights_of_its_own() -> None:
    state, action = _where(3, 2)
    weight = MODEL.weight * (1 + 0.1 * np.random.default_rng(0).standard_normal((3, 1, 1)))
    found = drawn_ticks(MODEL, weight, state, action)
    for p in range(3):
        own = torch.from_numpy(weight[p])
        after = runge_kutta(MODEL.structure, own, state[p], action[p], MODEL.dt, MODEL.substeps)
        assert torch.allclose(found[p], after, atol=1e-10)
