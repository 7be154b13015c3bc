"""The few frozen dataclasses that cross the walls between rooms.

Every tensor carries optional leading batch dimensions ``*batch``; a population of learners is one
such dimension.  All of them are registered as pytrees, so ``torch.func`` and ``tree_map`` see
through them.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields, replace
from typing import Any, TypeVar, cast, dataclass_transform

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

Parameters = dict[str, Tensor]
"""Parameters of an ``nn.Module`` by name, each with the population as its leading dimension."""

_T = TypeVar("_T")


@dataclass_transform(frozen_default=True)
def tree_dataclass(cls: type[_T]) -> type[_T]:
    """Make ``cls`` a frozen dataclass whose fields are the children of a pytree node."""
    frozen = dataclass(frozen=True)(cls)
    names = [f.name for f in fields(cast(Any, frozen))]
    pytree.register_dataclass(frozen, field_names=names)
    return frozen


@tree_dataclass
class Transition:
    """What happened in one tick of the simulator (Fig. 1: s_{t-1}, a_{t-1} -> s_t).

    state ``[*batch, n]``, action ``[*batch, m]`` (as applied), next_state ``[*batch, n]``,
    dt ``[]`` in seconds, or ``[B]`` for parts that say so (``dt_per_learner``), valid ``[*batch]``
    (bool: false where nothing is to be learned from it).
    """

    state: Tensor
    action: Tensor
    next_state: Tensor
    dt: Tensor
    valid: Tensor


@tree_dataclass
class Belief:
    """Mean ``[*batch, n]`` and covariance ``[*batch, n, n]``: a state of M' (section 3)."""

    mean: Tensor
    cov: Tensor


@tree_dataclass
class Trajectory:
    """An unrolled horizon.

    mean ``[T+1, *batch, n]``, cov ``[T+1, *batch, n, n]``, reward ``[T, *batch]`` (expected reward
    r~ of steps 1..T, Fig. 1 step 6c; ``[T+1, *batch]``, of steps 0..T, where the horizon's reading
    is the definition's), value ``[*batch]`` (their discounted sum, step 6d), first_floored
    ``[*batch]`` int64 (the first step whose covariance had lost its positive semidefiniteness and
    was floored, -1 if none).
    """

    mean: Tensor
    cov: Tensor
    reward: Tensor
    value: Tensor
    first_floored: Tensor


@tree_dataclass
class LearnerState:
    """Everything that a population of B learners knows; saving it is saving them.

    model, policy: parameters with leading ``[B]``; fit: the estimator's own tensors;
    noise: the memory of the rule for nu~; limit: the bounds of what is seen of an observation, if
    there are any (``edtorch.learner.limit``); step: the policy step rule's own tensors; seed
    ``[B]`` int64 and tick ``[B]`` int64 (together the state of the random stream,
    ``edtorch.run.random``); sound_ticks ``[B]`` int64: ticks before the first one whose numbers
    were not all finite; observer: what is remembered of readings that are late or err, if they are
    (``edtorch.learner.observer``).
    """

    model: Parameters
    policy: Parameters
    fit: Parameters
    noise: Parameters
    limit: Parameters
    step: Parameters
    seed: Tensor
    tick: Tensor
    sound_ticks: Tensor
    observer: Parameters = field(default_factory=dict)


@tree_dataclass
class Metrics:
    """What one learner step reports, each ``[B]`` but for the last.

    value: V~ before the step; gradient: |dV~/dtheta|; both None where the policy rested; error:
    mean over state components of |target - prediction| before the fit; finite ``[3, B]``: by place,
    see ``edtorch.learner.learner.Check``; first_floored: as in ``Trajectory``, None where nothing
    can be.
    """

    value: Tensor | None
    gradient: Tensor | None
    error: Tensor
    finite: Tensor
    first_floored: Tensor | None


def each_learner(number: Tensor, ndim: int) -> Tensor:
    """``number`` ``[B]`` with axes appended until it has ``ndim``; as it is if it is ``[]``."""
    return number if number.ndim == 0 else number.view(number.shape + (1,) * (ndim - number.ndim))


def select(mask: Tensor, yes: Tensor, no: Tensor) -> Tensor:
    """Rows of ``yes`` where ``mask`` ``[B]``, else of ``no``; both ``[B, ...]``."""
    return torch.where(mask.view(mask.shape + (1,) * (no.ndim - mask.ndim)), yes, no)


__all__ = [
    "Belief",
    "LearnerState",
    "Metrics",
    "Parameters",
    "Trajectory",
    "Transition",
    "each_learner",
    "replace",
    "select",
    "tree_dataclass",
]
