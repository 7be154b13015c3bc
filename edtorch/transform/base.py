"""The transform protocol: one step of the deterministic process M' (eq. 2; section 3)."""

from __future__ import annotations

from typing import Protocol

from edtorch.derivatives import StateFunction
from edtorch.rewards import Reward
from edtorch.shapes import Rows
from edtorch.types import Belief


class Transform(Protocol):
    """Propagates mean and covariance through the closed loop mu_pi; gives the expected reward.

    Transforms are pure, differentiable, and take any leading dimensions ``*batch``.

    Optional attributes, False where they are missing: ``exact_for_linear``, that mean and
    covariance are exact where the closed loop is linear and the noise constant, and the expectation
    of a quadratic reward is (closed forms then stand for the transform); ``at_mean``, that
    everything is taken at the mean, to first order: mu_pi, its Jacobian, nu_pi.
    """

    @property
    def propagates_covariance(self) -> bool:
        """Whether nu~ enters."""
        ...

    @property
    def differentiates_reward(self) -> bool:
        """Whether ``reward`` takes second derivatives of r_pi, which must then exist."""
        ...

    def keeps_positive(self, noise: StateFunction) -> bool:
        """Whether ``move`` keeps a covariance positive semidefinite by construction.

        Where it does not, ``edtorch.value.unroll`` checks the eigenvalues at every step, floors
        them and reports the first step where that happened.
        """
        ...

    def move(self, belief: Belief, closed_loop: StateFunction, noise: StateFunction) -> Belief:
        """The belief one step later.

        closed_loop: mu_pi ``[*batch, n] -> [*batch, n]``, perhaps with a method ``jacobian`` (see
        ``edtorch.derivatives.loop_jacobian``); noise: nu_pi ``[*batch, n] -> [*batch, n, n]``, the
        covariance of the next state given this one, over that step.
        """
        ...

    def reward(self, reward: Reward, belief: Belief, policy: StateFunction) -> Rows:
        """Expected reward ``[*batch]`` of a belief under the policy."""
        ...
