r"""Beliefs of the first-order unroll (eq. 2) and the derivatives that the error bounds need."""

from __future__ import annotations

import torch
from torch import Tensor

from edtorch.rewards import Reward, StateFunction, rowwise_jacobian
from edtorch.types import Belief, tree_dataclass


@tree_dataclass
class Path:
    """T + 1 beliefs of the first-order transform and what surrounds them.

    mean s~_t ``[T+1, n]``, cov Sigma~_t ``[T+1, n, n]``; jacobian J_t = D mu(s~_t) ``[T, n, n]``,
    noise nu(s~_t) ``[T, n, n]`` and its derivative ``[T, n, n, n]`` (the last index is the state's)
    for the T moves; expected_reward r' ``[T+1]`` with gradient ``[T+1, n]`` and hessian
    ``[T+1, n, n]`` of r_pi(s) = r(s, pi(s)) at each mean.
    """

    mean: Tensor
    cov: Tensor
    jacobian: Tensor
    noise: Tensor
    noise_jacobian: Tensor
    expected_reward: Tensor
    reward_gradient: Tensor
    reward_hessian: Tensor

    @property
    def steps(self) -> int:
        """T."""
        return self.jacobian.shape[0]

    def require_sound(self) -> None:
        """Raise ValueError where a number is not finite or not float64."""
        for name in self.__dataclass_fields__:
            tensor: Tensor = getattr(self, name)
            if tensor.dtype != torch.float64:
                raise ValueError(f"{name} is {tensor.dtype}, expected torch.float64")
            bad = (~tensor.isfinite()).nonzero()
            if len(bad):
                raise ValueError(f"{name} is not finite at step {int(bad[0, 0])}")


def first_order_path(
    start: Belief,
    closed_loop: StateFunction,
    noise: StateFunction,
    policy: StateFunction,
    *,
    reward: Reward,
    steps: int,
) -> Path:
    """The first-order unroll of ``start``, with derivatives by ``torch.func`` through the policy.

    start: one belief, mean ``[n]`` and cov ``[n, n]``, float64; closed_loop mu_pi ``[*batch, n] ->
    [*batch, n]``, noise nu_pi ``[*batch, n] -> [*batch, n, n]`` and policy work row by row.  Raises
    ValueError for a batch of beliefs, steps < 0, another dtype, or numbers that are not finite
    (naming the step).
    """
    if start.mean.ndim != 1:
        raise ValueError(f"mean has shape {tuple(start.mean.shape)}, expected one state [n]")
    if steps < 0:
        raise ValueError(f"steps={steps}: expected a number >= 0")
    means, covs, jacobians = [start.mean.detach()], [start.cov.detach()], []
    for _ in range(steps):
        J = rowwise_jacobian(closed_loop, means[-1]).detach()
        cov = (noise(means[-1]) + J @ covs[-1] @ J.mT).detach()
        means.append(closed_loop(means[-1]).detach())
        covs.append(0.5 * (cov + cov.mT))
        jacobians.append(J)
    mean, cov = torch.stack(means), torch.stack(covs)
    n, moved = mean.shape[-1], mean[:-1]

    def state_reward(s: Tensor) -> Tensor:
        return reward(s, policy(s)).unsqueeze(-1)

    def gradient(s: Tensor) -> Tensor:
        return rowwise_jacobian(state_reward, s).squeeze(-2)

    hessian = rowwise_jacobian(gradient, mean)
    noise_jacobian = rowwise_jacobian(lambda s: noise(s).flatten(-2), moved)
    path = Path(
        mean=mean,
        cov=cov,
        jacobian=torch.stack(jacobians) if jacobians else cov[:0],
        noise=noise(moved).detach(),
        noise_jacobian=noise_jacobian.detach().unflatten(-2, (n, n)),
        expected_reward=(state_reward(mean)[:, 0] + 0.5 * (hessian * cov).sum((-1, -2))).detach(),
        reward_gradient=gradient(mean).detach(),
        reward_hessian=hessian.detach(),
    )
    path.require_sound()
    return path
