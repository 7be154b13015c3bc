r"""Constants from derivatives at given states: an estimate of their suprema, never a bound."""

from __future__ import annotations

import torch
from torch import Tensor

from edtorch.bounds.constants import Constants
from edtorch.rewards import Reward, StateFunction, rowwise_jacobian


def sampled_constants(
    closed_loop: StateFunction,
    noise: StateFunction,
    policy: StateFunction,
    *,
    reward: Reward,
    states: Tensor,
    smooth: bool = True,
) -> Constants:
    r"""The largest derivatives at ``states`` ``[N, n]``, by ``torch.func``; labelled "sampled".

    The maximum over some states lies below the supremum over all of them, so that whatever is
    computed from these constants is an estimate.  The norms of second and third derivatives are
    spectral norms of their unfoldings, which at each state lie between the largest directional
    derivative and the Frobenius norm.  Raises ValueError where a derivative is not finite.
    """
    if states.ndim != 2 or len(states) == 0:
        raise ValueError(f"states has shape {tuple(states.shape)}, expected [N, n] with N >= 1")

    def derivative(function: StateFunction) -> StateFunction:
        return lambda s: rowwise_jacobian(function, s).flatten(-2)

    def state_reward(s: Tensor) -> Tensor:
        return reward(s, policy(s)).unsqueeze(-1)

    def flat_noise(s: Tensor) -> Tensor:
        return noise(s).flatten(-2)

    def noise_trace(s: Tensor) -> Tensor:
        return noise(s).diagonal(dim1=-2, dim2=-1).sum(-1, keepdim=True)

    n = states.shape[-1]

    def largest(name: str, function: StateFunction, order: int, rows: int) -> float:
        """The largest norm of a derivative, as a matrix of ``rows`` rows at each state."""
        for _ in range(order):
            function = derivative(function)
        matrices = function(states).detach().unflatten(-1, (rows, -1))
        if not bool(matrices.isfinite().all()):
            raise ValueError(f"the derivatives behind {name} are not finite at some state")
        return torch.linalg.matrix_norm(matrices, ord=2).max().item()

    return Constants(
        lipschitz=largest("lipschitz", closed_loop, 1, n),
        curvature=largest("curvature", closed_loop, 2, n),
        noise_slope=largest("noise_slope", flat_noise, 1, n * n),
        noise_trace_slope=largest("noise_trace_slope", noise_trace, 1, 1),
        noise_curvature=largest("noise_curvature", flat_noise, 2, n * n),
        reward_third=largest("reward_third", state_reward, 3, n),
        provenance="sampled",
        smooth=smooth,
    )
