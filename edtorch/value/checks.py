"""What the public doors ask of their inputs before any number is crunched.

These functions read numbers out of tensors, so they stay out of the learner's loop and of
``torch.func.vmap``.  Inputs off by more than 1e-8 relative are refused, with the offending value;
only what rounding does inside is ever put right silently.
"""

from __future__ import annotations

import warnings

import torch
from torch import Tensor

from edtorch.derivatives import StateFunction, rowwise_jacobian
from edtorch.errors import (
    AsymmetryError,
    CovarianceFloored,
    IndefiniteError,
    NonFiniteError,
    NonSmoothError,
    ShapeError,
)
from edtorch.rewards import Reward
from edtorch.transform.base import Transform
from edtorch.types import Belief, Trajectory

_TOLERANCE = 1e-8
"""Relative; in float32, where rounding is larger, 100 times the type's precision."""


def _expect_shape(name: str, tensor: Tensor, shape: tuple[int, ...]) -> None:
    if tuple(tensor.shape) != tuple(shape):
        raise ShapeError(f"{name} has shape {tuple(tensor.shape)}, expected {tuple(shape)}")


def _expect_finite(name: str, tensor: Tensor) -> None:
    bad = ~tensor.isfinite()
    if bool(bad.any()):
        where = bad.nonzero()[0].tolist()
        raise NonFiniteError(
            f"{name}{where or ''} is {tensor[tuple(where)].item()}, expected a finite number"
        )


def check_covariance(name: str, cov: Tensor) -> None:
    """Refuse what is no covariance ``[*batch, n, n]``.

    Raises NonFiniteError, AsymmetryError or IndefiniteError, with the row, the numbers and the
    tolerance, relative to the largest entry and the largest eigenvalue.
    """
    _expect_finite(name, cov)
    tolerance = max(_TOLERANCE, 100 * torch.finfo(cov.dtype).eps)
    difference = (cov - cov.mT).abs()
    bad = difference > tolerance * cov.abs().amax((-2, -1), keepdim=True)
    if bool(bad.any()):
        *row, i, j = bad.nonzero()[0].tolist()
        matrix = cov[tuple(row)]
        raise AsymmetryError(
            f"{name}{row or ''} is not symmetric: entry ({i}, {j}) is {matrix[i, j].item():.9g} "
            f"and ({j}, {i}) is {matrix[j, i].item():.9g}"
        )
    values = torch.linalg.eigvalsh(cov)
    negative = values[..., 0] < -tolerance * values.abs().amax(-1)
    if bool(negative.any()):
        row = negative.nonzero()[0].tolist()
        raise IndefiniteError(
            f"{name}{row or ''} has the eigenvalue {values[tuple(row)][0].item():.6g}, "
            f"expected none below 0"
        )


def check_belief(belief: Belief) -> None:
    """Reject an invalid belief: wrong shapes, NaN, or a matrix that is no covariance."""
    if belief.mean.ndim < 1 or belief.mean.shape[-1] < 1:
        raise ShapeError(f"mean has shape {tuple(belief.mean.shape)}, expected [*batch, n]")
    _expect_shape("cov", belief.cov, (*belief.mean.shape, belief.mean.shape[-1]))
    _expect_finite("mean", belief.mean)
    check_covariance("cov", belief.cov)


def check_policy(policy: StateFunction, state: Tensor, actions: int | None = None) -> None:
    """Refuse a policy whose action at ``state`` ``[*batch, n]`` is not ``[*batch, actions]``.

    actions: m, or None where it is not known.
    """
    action = policy(state)
    m = actions if actions is not None else (action.shape[-1] if action.ndim else 0)
    _expect_shape("the policy's action", action, (*state.shape[:-1], m))
    _expect_finite("the policy's action", action)


def check_smooth(reward: Reward, transform: Transform) -> None:
    """Refuse a reward declared non-smooth (``smooth = False``) where D^2 r enters."""
    if transform.differentiates_reward and not getattr(reward, "smooth", True):
        raise NonSmoothError(
            f"{type(reward).__name__} declares smooth=False, and {type(transform).__name__} takes "
            f"second derivatives of the reward; a point transform does not"
        )


def check_reward(
    reward: Reward, state: Tensor, policy: StateFunction, transform: Transform
) -> None:
    """Refuse a reward that is not one number a row, or whose Hessian is needed and not finite."""
    check_smooth(reward, transform)

    def closed(s: Tensor) -> Tensor:
        return reward(s, policy(s))

    _expect_shape("the reward", closed(state), tuple(state.shape[:-1]))
    _expect_finite("the reward", closed(state))
    if transform.differentiates_reward:

        def gradient(s: Tensor) -> Tensor:
            return rowwise_jacobian(lambda x: closed(x).unsqueeze(-1), s).squeeze(-2)

        _expect_finite("the reward's Hessian", rowwise_jacobian(gradient, state))


def check_parts(
    start: Belief,
    closed_loop: StateFunction,
    policy: StateFunction,
    *,
    reward: Reward,
    transform: Transform,
    noise: StateFunction,
    actions: int | None = None,
) -> None:
    """All of the above where an unroll starts; the functions are tried at the start's mean.

    actions: the number of actions m, if known (by default the reward's ``actions``, if it has any).
    """
    check_belief(start)
    expected = actions if actions is not None else getattr(reward, "actions", None)
    check_policy(policy, start.mean, expected)
    _expect_shape("the closed loop's next state", closed_loop(start.mean), tuple(start.mean.shape))
    _expect_finite("the closed loop's next state", closed_loop(start.mean))
    if transform.propagates_covariance:
        added = noise(start.mean)
        _expect_shape("noise", added, tuple(start.cov.shape))
        check_covariance("noise", added)
    check_reward(reward, start.mean, policy, transform)


def warn_if_floored(trajectory: Trajectory) -> None:
    """Warn ``CovarianceFloored`` of the earliest step at which a covariance had to be floored."""
    floored = trajectory.first_floored >= 0
    if bool(floored.any()):
        step = int(trajectory.first_floored[floored].min())
        warnings.warn(
            f"the covariance became indefinite at step {step} of {len(trajectory.cov) - 1} "
            f"({int(floored.sum())} of {floored.numel()} rows); eigenvalues are floored at 0 from "
            f"there on",
            CovarianceFloored,
            stacklevel=3,
        )
