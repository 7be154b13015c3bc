"""One tick of learning an inverse model and an inverse policy (section 5), as a pure function.

The same walk as ``edtorch.learner.learner``, with the same state and the same ``initial``, ``act``
and ``step``; what is fitted and what is unrolled are others.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import torch
from torch import Tensor

from edtorch.inverse.controller import InverseController
from edtorch.inverse.coordinates import View
from edtorch.inverse.loop import base_acceleration, base_regressor
from edtorch.inverse.unroll import InverseValue, regressors
from edtorch.model.fit import Fit, RecursiveLeastSquares
from edtorch.model.noise import Noise
from edtorch.policy.policies import explore
from edtorch.policy.steps import Step, gradient_norm
from edtorch.types import LearnerState, Metrics, Parameters, Transition, replace, select


@dataclass(frozen=True)
class SampleWeight:
    """The weight of a transition in the fit of the inverse model.

    w = 1 / (1 + (max |ddq| / trust_acceleration)^2 + (max |dq| / trust_speed)^4): violent motion
    says little about the region in which the policy works.  In rad/s^2 and rad/s.
    """

    trust_acceleration: float = 100.0
    trust_speed: float = 10.0

    def __post_init__(self) -> None:
        for name in ("trust_acceleration", "trust_speed"):
            if not getattr(self, name) > 0:
                raise ValueError(f"{name}={getattr(self, name)}: expected a number > 0")

    def __call__(self, speed: Tensor, acceleration: Tensor) -> Tensor:
        """w ``[*batch, 1]``; both ``[*batch, n]``."""
        accelerated = acceleration.abs().amax(-1, keepdim=True) / self.trust_acceleration
        fast = speed.abs().amax(-1, keepdim=True) / self.trust_speed
        return 1 / (1 + accelerated.square() + fast.square().square())


def _finite(tensor: Tensor) -> Tensor:
    """Whether every number of a learner is finite, ``[B]``."""
    return torch.isfinite(tensor.flatten(1).sum(-1))


@dataclass(frozen=True)
class InverseLearner:
    """A population of learners of inverse models; what they know is in a ``LearnerState``.

    Its ``model`` has the ``inverse`` W ``[B, n, k]`` and the ``base`` V ``[B, p, r]``, its
    ``policy`` the ``weight`` Theta, its ``step`` the step rule's memory, the last ``states`` and
    ``goals`` to unroll from, and value and gradient of the last update.

    fit: of W, to samples weighted by ``sample_weight``; base_fit: of V; noise: rule for nu~ of all
    accelerations, how they turn out less how the unroll foresees them, None where the value does
    not use it; every: ticks between two updates of the policy; recent: states of the last ticks
    that an update unrolls from; exploration: standard deviation of the Gaussian added to the
    action, scaled units.
    """

    policy: InverseController
    unroll: InverseValue
    fit: Fit
    step_rule: Step
    every: int = 5
    recent: int = 10
    exploration: float = 0.0
    sample_weight: SampleWeight = field(default_factory=SampleWeight)
    base_fit: Fit = field(default_factory=lambda: RecursiveLeastSquares(1000.0, 0.9999))
    noise: Noise | None = None

    def __post_init__(self) -> None:
        if self.unroll.propagates_covariance and self.noise is None:
            raise ValueError("noise=None: expected a rule for nu~, which the covariance needs")
        if self.noise is not None and not self.noise.is_constant:
            raise ValueError(
                f"noise={type(self.noise).__name__}: expected one that is the same for every state"
                " with an inverse policy, ResidualNoise"
            )
        for name in ("every", "recent"):
            if not getattr(self, name) >= 1:
                raise ValueError(f"{name}={getattr(self, name)}: expected at least one")
        if not self.exploration >= 0:
            raise ValueError(f"exploration={self.exploration}: expected a number >= 0")

    @property
    def needs_autograd(self) -> bool:
        """Whether torch's differentiation must be at work."""
        return self.unroll.needs_autograd

    @property
    def observer(self) -> None:
        """None: observations are taken for the state."""
        return None

    def begin(self, state: LearnerState, fresh: Tensor, observation: Tensor) -> LearnerState:
        """Nothing of what is known depends on the episode."""
        return state

    def initial(self, seeds: Sequence[int]) -> LearnerState:
        """Learners that know nothing yet, one per seed."""
        size, layout = len(seeds), self.policy.policy.layout
        n, p = layout.joints, layout.others

        def zeros(*shape: int) -> Tensor:
            return torch.zeros(size, *shape, dtype=torch.float64)

        inverse = zeros(n, self.policy.features.outputs)
        base = zeros(p, regressors(self.policy.policy))
        policy = {"weight": zeros(n, self.policy.policy.outputs)}
        fit = {f"inverse.{k}": m for k, m in self.fit.initial(inverse).items()}
        fit |= {f"base.{k}": m for k, m in self.base_fit.initial(base).items()}
        ticks = torch.zeros(size, dtype=torch.int64)
        return LearnerState(
            model={"inverse": inverse, "base": base},
            policy=policy,
            fit=fit,
            noise={} if self.noise is None else self.noise.initial(zeros(n + p, 1)),
            limit={},
            step={f"rule.{k}": m for k, m in self.step_rule.initial(policy).items()}
            | {
                "states": zeros(self.recent, layout.size),
                "goals": zeros(self.recent, n),
                "value": zeros(),
                "gradient": zeros(),
            },
            seed=torch.tensor(list(seeds), dtype=torch.int64),
            tick=ticks,
            sound_ticks=ticks,
        )

    def acting(self, state: LearnerState) -> Parameters:
        """What ``policy.action`` needs of a state."""
        return {"weight": state.policy["weight"], "inverse": state.model["inverse"]}

    def act(self, state: LearnerState, observation: Tensor, normal: Tensor) -> Tensor:
        """W phi(s, pi(s, g)) plus exploration, ``[B, m]`` in scaled units; normal ``[B, m]``."""
        return explore(
            self.policy.action(self.acting(state), observation), normal, self.exploration
        )

    def step(
        self, state: LearnerState, transition: Transition, *, improve: bool = True
    ) -> tuple[LearnerState, Metrics]:
        """Fit, and every so often climb (never unless ``improve``), after one transition of each
        learner.

        Whether an update is due is asked of a tensor, so that in between it costs nothing.
        """
        coordinates = self.policy.coordinates
        before = coordinates.view(transition.state)
        after = coordinates.view(transition.next_state)
        sound = _finite(transition.next_state)
        learn = transition.valid & sound
        learned, error, fit_ok = self._fit(state, transition, before, after, learn)

        # The unroll starts from the states of the last ticks: a row each, in turn.
        place = (state.tick % self.recent).unsqueeze(-1)
        here = (torch.arange(self.recent) == place) & learn.unsqueeze(-1)
        states = select(here, after.state.unsqueeze(-2), state.step["states"])
        goals = select(here, after.goal.unsqueeze(-2), state.step["goals"])
        learned = replace(
            learned,
            tick=state.tick + transition.valid,
            step=state.step | {"states": states, "goals": goals},
        )
        value_ok, floored = torch.ones_like(sound), None
        due = transition.valid & (learned.tick % self.every == 0) & (learned.tick >= self.recent)
        if improve and bool(due.any()):
            learned, value_ok, floored = self._climb(learned, transition.dt * self.every, due)
        unbroken = value_ok & fit_ok & (state.sound_ticks == state.tick) & transition.valid
        learned = replace(learned, sound_ticks=state.sound_ticks + unbroken)
        finite = torch.stack([sound, fit_ok, value_ok])
        value, gradient = learned.step["value"], learned.step["gradient"]
        return learned, Metrics(value, gradient, error, finite, floored)

    def _fit(
        self,
        state: LearnerState,
        transition: Transition,
        before: View,
        after: View,
        learn: Tensor,
    ) -> tuple[LearnerState, Tensor, Tensor]:
        """Steps 1 and 2 of Fig. 1; also the error before, and whether all is finite, ``[B]``."""
        layout, dt = self.policy.policy.layout, transition.dt
        n, half = layout.joints, layout.size // 2
        known = learn.unsqueeze(-1)

        # A row of zeros leaves a fit as it is, at a fraction of what selecting its memory costs.
        def only_known(tensor: Tensor) -> Tensor:
            return torch.where(known, tensor, 0.0)

        rate = before.joints[..., half : half + n]
        acceleration = (after.joints[..., half : half + n] - rate) / dt
        weight = self.sample_weight(rate, acceleration)
        phi = only_known(self.policy.features(before.joints, acceleration))
        target = only_known(transition.action)
        old = state.model["inverse"]
        memory = _part(state.fit, "inverse.")
        fitted = self.fit.update(
            old, memory, only_known(weight * phi), only_known(weight * target), dt
        )
        error = (fitted.residual / only_known(weight).clamp(min=1e-300)).abs().mean(-1)

        change = only_known((after.state - before.state)[..., half:] / dt)
        psi = only_known(base_regressor(self.policy.policy, before.state, change[..., :n]))
        base_memory = _part(state.fit, "base.")
        base = self.base_fit.update(state.model["base"], base_memory, psi, change[..., n:], dt)

        fit_ok = _finite(fitted.weight) & _finite(base.weight)
        keep = learn & fit_ok
        fit = {f"inverse.{k}": m for k, m in fitted.memory.items()}
        fit |= {f"base.{k}": select(keep, m, base_memory[k]) for k, m in base.memory.items()}
        model = {
            "inverse": select(keep, fitted.weight, old),
            "base": select(keep, base.weight, state.model["base"]),
        }
        noise = self._noise(state, before, change, known, dt)
        return replace(state, model=model, fit=fit, noise=noise), error, fit_ok

    def _noise(
        self, state: LearnerState, before: View, change: Tensor, known: Tensor, dt: Tensor
    ) -> Parameters:
        """The memory of nu~ with one more ``change``, accelerations ``[B, n + p]``."""
        if self.noise is None:
            return state.noise
        policy = self.policy.policy
        wish = policy.acceleration(state.policy["weight"], before.state, before.goal)
        psi = base_regressor(policy, before.state, wish)
        foreseen = torch.cat((wish, base_acceleration(state.model["base"], psi)), -1)
        error = torch.where(known, change - foreseen, 0.0)
        squared = error.unsqueeze(-1) * error.unsqueeze(-2) * dt
        updated = self.noise.update(state.noise, squared, psi, {}, dt)
        return {
            name: select(known.squeeze(-1) & _finite(new), new, state.noise[name])
            for name, new in updated.items()
        }

    def _climb(
        self, state: LearnerState, seconds: Tensor, due: Tensor
    ) -> tuple[LearnerState, Tensor, Tensor | None]:
        """Steps 3 to 7 of Fig. 1 for the learners that are ``due``; also what is finite, and from
        which step of the unroll on a covariance had to be floored."""
        theta, memory = state.policy["weight"], state.step
        nu = None
        if self.noise is not None:
            nu = self.noise.covariance(state.noise, state.model["base"][..., :1, :])
        here = self.unroll(theta, state.model["base"], memory["states"], memory["goals"], nu)
        value, size = here.value, gradient_norm(here.gradient)
        value_ok = torch.isfinite(value + size)
        rule = _part(memory, "rule.")
        policy, rule = self.step_rule(state.policy, here.gradient, rule, seconds)
        climb = due & value_ok
        step = memory | {
            "value": torch.where(climb, value, memory["value"]),
            "gradient": torch.where(climb, size, memory["gradient"]),
        }
        step |= {f"rule.{k}": select(climb, m, memory[f"rule.{k}"]) for k, m in rule.items()}
        weight = select(climb, policy["weight"], theta)
        floored = here.first_floored
        if floored is not None:
            floored = torch.where(due, floored, -1)
        return replace(state, policy={"weight": weight}, step=step), value_ok | ~due, floored


def _part(memory: Parameters, prefix: str) -> Parameters:
    """The entries whose names begin with ``prefix``, by the rest of their names."""
    return {k.removeprefix(prefix): m for k, m in memory.items() if k.startswith(prefix)}
