"""What a reward is, and its expectation under a belief (eq. 1)."""

from __future__ import annotations

from typing import Protocol

from torch import Tensor

from edtorch.derivatives import StateFunction, scalar_curvature
from edtorch.rewards.form import QuadraticForm
from edtorch.shapes import Actions, Rows, States
from edtorch.types import Belief


class Reward(Protocol):
    """r(s, a), ``[*batch]``, of states ``[*batch, n]`` and actions ``[*batch, m]``, scaled.

    Any differentiable function or module of tensors.  Optional members, read where they exist:

    * ``quadratic_form``: a ``QuadraticForm`` that r is, which closed forms of the value need;
    * ``expected(belief)``: the exact expectation ``[*batch]`` under a Gaussian, of a reward of the
      state alone; transforms that propagate a covariance then take it;
    * ``target`` ``[n]``: the state it wants, from which an unroll may start;
    * ``smooth = False``: r has no second derivatives everywhere, and is refused by transforms that
      take them;
    * ``timed = True``: something is to be followed, so that r depends on the time of an episode,
      too: planners alone can take that in (``edtorch.rewards.squares``);
    * ``actions``: the m that r expects, for the checks of ``edtorch.value.checks``.
    """

    def __call__(self, state: States, action: Actions, /) -> Rows:
        """The reward of each row."""
        ...


def quadratic_form_of(reward: Reward) -> QuadraticForm | None:
    """The quadratic form that the reward is, None where it is none."""
    return getattr(reward, "quadratic_form", None)


def target_of(reward: Reward) -> Tensor | None:
    """The state ``[n]`` that the reward wants, None where it does not say or it is zero."""
    return getattr(reward, "target", None)


def exact_expectation(reward: Reward, belief: Belief) -> Rows | None:
    """The reward's own expectation ``[*batch]``, None where it offers none."""
    offered = getattr(reward, "expected", None)
    return None if offered is None else offered(belief)


def expected_reward(reward: Reward, belief: Belief, policy: StateFunction) -> Rows:
    """E[r_pi] = r_pi(mean) + 1/2 tr(D^2 r_pi(mean) cov) (eq. 1; Fig. 1 step 6c), ``[*batch]``.

    r_pi(s) = r(s, pi(s)): the curvature includes the policy's.  Exact for quadratic r_pi and any
    distribution with this mean and covariance; second order otherwise, unless the reward knows its
    expectation itself.
    """
    exact = exact_expectation(reward, belief)
    if exact is not None:
        return exact

    def closed(s: Tensor) -> Tensor:
        return reward(s, policy(s))

    return closed(belief.mean) + 0.5 * scalar_curvature(closed, belief.mean, belief.cov)
