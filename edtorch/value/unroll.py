"""The limited-horizon value of a policy under a model, and its gradient (Fig. 1, steps 3-6).

``unroll`` pushes a belief through any closed loop; ``propagate`` is its inside, without checks.
``Generic`` differentiates that for any model, policy, reward and transform;
``edtorch.value.linear`` gives the same for linear closed loops, much faster;
``edtorch.value.choose`` decides between them.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal, Protocol, get_args

import torch
from torch import Tensor
from torch.func import grad_and_value

from edtorch.derivatives import StateFunction
from edtorch.model.models import Model
from edtorch.model.noise import Noise
from edtorch.policy.policies import Policy
from edtorch.rewards import Reward
from edtorch.transform import ConstantNoise, Transform, point_belief
from edtorch.transform.positive import floored
from edtorch.types import Belief, Parameters, Trajectory
from edtorch.value.checks import check_parts, check_smooth, warn_if_floored
from edtorch.value.closed_loop import ClosedLoop, LoopNoise

Reading = Literal["figure", "definition"]
"""Which of the paper's two sums is the value; see ``Horizon``."""


@dataclass(frozen=True)
class Horizon:
    """T steps of ``dt`` seconds (``step`` in the discrete form), each reward weighted.

    The value is the sum of discount^(k unit) unit r~ over the rewards that count, k = 0, 1, ...:
    unit = 1 in the discrete form; the Euler sum of section 4's integral with unit = dt and the
    discount per second in the derivative form.  The paper says in two ways which rewards count:

    * reading="figure": tau = 1..T, the rewards yet to be influenced (Fig. 1 step 6);
    * reading="definition": tau = 0..T, T + 1 of them (section 3: V_pi sums over tau = t..t+n).

    V_definition = unit r~_0 + discount^unit V_figure, so for a reward of the state alone the two
    have the same policy gradient but for the factor discount^unit.  T = 0 leaves r~_0 to the
    definition and nothing to the figure, which asks for one step at least.
    """

    steps: int
    dt: float
    discount: float
    unit: float
    reading: Reading = "figure"

    def __post_init__(self) -> None:
        if self.reading not in get_args(Reading):
            raise ValueError(
                f"reading={self.reading}: expected one of {', '.join(get_args(Reading))}"
            )
        if self.steps < self.first_step:
            raise ValueError(f"horizon={self.steps}: expected at least one step")
        if self.steps < 0:
            raise ValueError(f"horizon={self.steps}: expected 0 steps or more")
        if not self.dt > 0:
            raise ValueError(f"dt={self.dt}: expected a number > 0 (seconds)")
        if not 0 < self.discount <= 1:
            raise ValueError(f"discount={self.discount}: expected a number in (0, 1]")

    @property
    def first_step(self) -> int:
        """The tau of the first reward that counts: 1 in the figure, 0 in the definition."""
        return 0 if self.reading == "definition" else 1

    def weights(self) -> list[float]:
        """Weight of the expected reward of each step that counts, ``first_step``..T."""
        count = self.steps + 1 - self.first_step
        return [self.discount ** (k * self.unit) * self.unit for k in range(count)]


def propagate(
    start: Belief,
    closed_loop: StateFunction,
    policy: StateFunction,
    *,
    reward: Reward,
    transform: Transform,
    noise: StateFunction,
    horizon: Horizon,
) -> Trajectory:
    """``unroll`` without its checks: pure, for loops, ``torch.func.vmap`` and compilation.

    What went wrong comes back as numbers: NaN where arithmetic broke, ``first_floored`` where a
    covariance did.
    """
    beliefs, first_floored = course(
        start, closed_loop, transform=transform, noise=noise, steps=horizon.steps
    )
    weights, rewards = iter(horizon.weights()), []
    value = torch.zeros_like(start.mean[..., 0])
    for belief in beliefs[horizon.first_step :]:
        gain = transform.reward(reward, belief, policy)
        value = value + next(weights) * gain
        rewards.append(gain)
    return Trajectory(
        torch.stack([belief.mean for belief in beliefs]),
        torch.stack([belief.cov for belief in beliefs]),
        torch.stack(rewards),
        value,
        first_floored,
    )


def course(
    start: Belief,
    closed_loop: StateFunction,
    *,
    transform: Transform,
    noise: StateFunction,
    steps: int,
) -> tuple[list[Belief], Tensor]:
    """The beliefs of steps 0..T, ``steps`` T, without a reward; and ``first_floored`` as in
    ``Trajectory``.  Pure, as ``propagate``."""
    beliefs = [start]
    first_floored = torch.full(
        start.mean.shape[:-1], -1, dtype=torch.int64, device=start.mean.device
    )
    watched = not transform.keeps_positive(noise)
    for tau in range(1, steps + 1):
        belief = transform.move(beliefs[-1], closed_loop, noise)
        if watched:
            cov, began = floored(belief.cov)
            belief = Belief(belief.mean, cov)
            first_floored = torch.where(began & (first_floored < 0), tau, first_floored)
        beliefs.append(belief)
    return beliefs, first_floored


def unroll(
    start: Belief,
    closed_loop: StateFunction,
    policy: StateFunction,
    *,
    reward: Reward,
    transform: Transform,
    noise: StateFunction,
    horizon: Horizon,
    actions: int | None = None,
) -> Trajectory:
    """Push ``start`` through T steps of the closed loop and add up its rewards (Fig. 1, step 6).

    closed_loop mu_pi and policy pi work row by row on ``[*batch, n]``; noise nu_pi
    ``[*batch, n] -> [*batch, n, n]`` is the covariance of the next state given this one, per step
    (``edtorch.transform.ConstantNoise`` where it is the same everywhere); actions: the policy's m,
    for the checks, if the reward does not say it.  Differentiable with respect to everything that
    the functions close over.

    Raises the errors of ``edtorch.errors`` for invalid inputs (``edtorch.value.checks``), and warns
    ``CovarianceFloored`` with the first step at which a covariance had to be floored.
    """
    check_parts(
        start,
        closed_loop,
        policy,
        reward=reward,
        transform=transform,
        noise=noise,
        actions=actions,
    )
    trajectory = propagate(
        start,
        closed_loop,
        policy,
        reward=reward,
        transform=transform,
        noise=noise,
        horizon=horizon,
    )
    warn_if_floored(trajectory)
    return trajectory


@dataclass(frozen=True)
class ValueGradient:
    """value ``[B]`` and its gradient with respect to each policy parameter ``[B, ...]``.

    first_floored ``[B]`` as in ``Trajectory``; None where no covariance can need it.
    """

    value: Tensor
    gradient: Parameters
    first_floored: Tensor | None = None


class ValuePath(Protocol):
    """A way to the value and its gradient: (model, policy, memory of nu~, state ``[B, n]``).

    needs_autograd: whether it differentiates with torch; a loop over one that does not may run in
    torch's inference mode, which is a fifth faster.
    """

    @property
    def needs_autograd(self) -> bool:
        """Whether torch's differentiation must be at work."""
        ...

    def __call__(
        self, model: Parameters, policy: Parameters, noise: Parameters, state: Tensor
    ) -> ValueGradient:
        """Value of unrolling from ``state`` and dV/dtheta, learner by learner."""
        ...


@dataclass(frozen=True)
class Generic:
    """Any model and policy: reverse-mode differentiation of ``unroll``.

    The oracle for every faster path.  Learners do not mix, so the gradient of the sum of their
    values is each one's own gradient.
    """

    model: Model
    policy: Policy
    reward: Reward
    transform: Transform
    horizon: Horizon
    noise: Noise | None = None
    start_cov: Tensor | None = None
    needs_autograd: bool = True

    def __post_init__(self) -> None:
        check_smooth(self.reward, self.transform)

    def loop(self, model: Parameters, policy: Parameters) -> ClosedLoop:
        """mu_pi with these parameters."""
        return ClosedLoop(self.model, self.policy, model, policy, self.horizon.dt)

    def noise_of(self, loop: ClosedLoop, memory: Parameters, state: Tensor) -> StateFunction:
        """nu_pi of a closed loop; zero without a rule."""
        if self.noise is None:
            n = state.shape[-1]
            return ConstantNoise(state.new_zeros(n, n))
        return LoopNoise(loop, self.noise, memory)

    def start(self, state: Tensor) -> Belief:
        """The belief that the unroll from an observed state begins with."""
        if self.start_cov is None:
            return point_belief(state)
        return Belief(state, self.start_cov.expand(*state.shape, state.shape[-1]))

    def trajectory(
        self, model: Parameters, policy: Parameters, noise: Parameters, start: Belief
    ) -> Trajectory:
        """The unrolled horizon from ``start``."""
        loop = self.loop(model, policy)
        return propagate(
            start,
            loop,
            loop.act,
            reward=self.reward,
            transform=self.transform,
            noise=self.noise_of(loop, noise, start.mean),
            horizon=self.horizon,
        )

    def __call__(
        self, model: Parameters, policy: Parameters, noise: Parameters, state: Tensor
    ) -> ValueGradient:
        """See ``ValuePath``."""

        def total(parameters: Parameters) -> tuple[Tensor, tuple[Tensor, Tensor]]:
            found = self.trajectory(model, parameters, noise, self.start(state))
            return found.value.sum(), (found.value, found.first_floored)

        gradient, (_, (value, first_floored)) = grad_and_value(total, has_aux=True)(policy)
        return ValueGradient(value, gradient, first_floored)


@dataclass(frozen=True)
class FromOrigin:
    """Another path, from the origin of the state space instead of the state of the moment, or from
    the state ``origin`` ``[n]`` that is wanted.

    With a covariance to start from, this unrolls a belief over all states near the goal: what is
    learned at each tick is good for every one of them, and not for the present one alone.
    """

    path: ValuePath
    origin: Tensor | None = None

    @property
    def needs_autograd(self) -> bool:
        """Whether torch's differentiation must be at work."""
        return self.path.needs_autograd

    def __call__(
        self, model: Parameters, policy: Parameters, noise: Parameters, state: Tensor
    ) -> ValueGradient:
        """See ``ValuePath``; of state only the shape counts."""
        start = torch.zeros_like(state) if self.origin is None else self.origin.expand_as(state)
        return self.path(model, policy, noise, start)
