"""Any sim as a Gymnasium environment, and the bicycle among Gymnasium's own.

``import sims`` (or ``edtorch``) registers ``edtorch/Bicycle-v0`` (and others, see
``sims.cardea.env`` and ``sims.tasks.env``)::

    import gymnasium
    import edtorch
    env = gymnasium.make("edtorch/Bicycle-v0")

``gymnasium.make("sims:edtorch/Bicycle-v0")`` does the import itself.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, cast

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray
from torch import Tensor

from sims.base import Outcome, Pictured, Sim, Spec, spec_index
from sims.bicycle import Bicycle

Array = NDArray[np.float64]

RewardFunction = Callable[[Array, Array, Array], float]
"""(observation, action as applied, next observation), physical units, to the reward of a step."""

_RECENT, _THINNING = 2000, 50
"""A picture gets the last so many states, and of those before them every so-manieth."""


class SimEnv(gymnasium.Env[Array, Array]):
    """One episode of a sim at a time, in physical units and float64.

    Observation and action spaces are boxes with the bounds of ``sim.spec`` (an angle's box is its
    period around 0), infinite where there are none.  An episode terminates when its outcome is no
    longer RUNNING, and is truncated at the sim's time limit, whether or not the sim then counts it
    as a success.  The info of its last step has ``outcome`` (FAILED, SUCCEEDED or TIMED_OUT) and
    ``measures`` (dict of floats).
    Same seed, same actions: same digits.  It can be pickled where ``sim`` and ``reward`` can, with
    the episode that it is in.

    Arguments: ``sim``; ``reward``: function of (observation, action as applied, next observation);
    ``fail_penalty``: taken off the reward of a step that ends in failure; ``render_mode``: None or
    "rgb_array" (for a sim that draws itself); ``bounds``: by name those of components of the
    observation that ``sim.spec`` has none for.
    """

    metadata: dict[str, Any] = {"render_modes": ["rgb_array"], "render_fps": 25}  # noqa: RUF012

    def __init__(
        self,
        sim: Sim,
        reward: RewardFunction,
        *,
        fail_penalty: float = 0.0,
        render_mode: str | None = None,
        bounds: Mapping[str, tuple[float, float]] | None = None,
    ) -> None:
        """Wrap ``sim``, whose step earns ``reward``."""
        if render_mode not in (None, *self.metadata["render_modes"]):
            raise ValueError(f"render_mode={render_mode!r}: expected None or 'rgb_array'")
        if render_mode is not None and not isinstance(sim, Pictured):
            raise ValueError(f"render_mode={render_mode!r}: the sim {sim.spec.name} has no frame")
        self.sim = sim
        self.reward = reward
        self.fail_penalty = fail_penalty
        self.render_mode = render_mode
        self.observation_space = _observation_space(sim.spec, bounds or {})
        self.action_space = _action_space(sim.spec)
        self._low = torch.tensor([quantity.low for quantity in sim.spec.action]).double()
        self._high = torch.tensor([quantity.high for quantity in sim.spec.action]).double()
        self._past: list[Tensor] = []
        self._recent: deque[Tensor] = deque()
        self._steps = 0
        self._ended = True

    @property
    def dt(self) -> float:
        """Seconds per step."""
        return self.sim.spec.dt

    @property
    def max_episode_steps(self) -> int:
        """Steps after which an episode is truncated."""
        return round(self.sim.spec.time_limit / self.sim.spec.dt)

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[Array, dict[str, Any]]:
        """A new episode; ``options`` are not used."""
        super().reset(seed=seed)
        with torch.inference_mode():
            self._start = self._state = self.sim.initial(self._uniforms(self.sim.spec.reset_dim))
            self._observation = self.sim.observe(self._state)
        self._past, self._recent = [], deque([self._state])
        self._steps = 0
        self._ended = False
        return self._observation[0].numpy().copy(), {}

    def step(self, action: Array) -> tuple[Array, float, bool, bool, dict[str, Any]]:
        """One step of ``sim.spec.dt`` seconds; ValueError for an action of another shape than that
        of the space, or with numbers that are not finite."""
        if self._ended:
            raise RuntimeError("step of an episode that has ended; expected a reset first")
        sim, spec = self.sim, self.sim.spec
        if np.shape(action) != self.action_space.shape:
            raise ValueError(
                f"action={action}: has shape {np.shape(action)}, expected {self.action_space.shape}"
            )
        with torch.inference_mode():
            taken = torch.as_tensor(np.asarray(action), dtype=torch.float64).reshape(1, -1)
            if not bool(taken.isfinite().all()):
                raise ValueError(f"action={action}: expected finite numbers")
            if spec.clip_action:
                taken = taken.clamp(self._low, self._high)
            before = self._observation
            self._state = sim.step(self._state, taken, self._uniforms(spec.disturbance_dim))
            self._observation = sim.observe(self._state)
            self._steps += 1
            outcome = Outcome(int(sim.outcome(self._state)))
            seconds = self._steps * spec.dt
            # Half a step of tolerance: the product is rounded.
            late = seconds > spec.time_limit - spec.dt / 2
            truncated = outcome is Outcome.TIMED_OUT or (late and outcome is not Outcome.FAILED)
            terminated = not truncated and outcome is not Outcome.RUNNING
            info: dict[str, Any] = {}
            if terminated or truncated:
                self._ended = True
                clock = torch.tensor([seconds], dtype=torch.float64)
                measures = sim.measures(self._start, self._state, clock)
                ended = Outcome.TIMED_OUT if outcome is Outcome.RUNNING else outcome
                info["outcome"] = ended.name
                info["measures"] = {name: float(value) for name, value in measures.items()}
        if self.render_mode is not None:
            self._remember()
        observation = self._observation[0].numpy().copy()
        reward = self.reward(before[0].numpy(), taken[0].numpy(), observation)
        if outcome is Outcome.FAILED:
            reward -= self.fail_penalty
        return observation, float(reward), terminated, truncated, info

    def render(self) -> Any:
        """The picture that the sim draws of the episode so far, RGB uint8; None without a mode."""
        if self.render_mode is None or not isinstance(self.sim, Pictured):
            return None
        if not self._recent:
            raise RuntimeError("render before the first episode; expected a reset first")
        return self.sim.frame(torch.cat([*self._past, *self._recent]))

    def _remember(self) -> None:
        if len(self._recent) == _RECENT:
            oldest = self._recent.popleft()
            if self._steps % _THINNING == 0:
                self._past.append(oldest)
        self._recent.append(self._state)

    def _uniforms(self, count: int) -> Tensor:
        return torch.from_numpy(self.np_random.random((1, count)))


class BicycleEnv(SimEnv):
    """Balance a bicycle and ride it to a goal a kilometre away.

    The bicycle of J. Randløv and P. Alstrøm, "Learning to drive a bicycle using reinforcement
    learning and shaping", ICML 1998: it goes 10 km/h, and falls within two seconds if nothing is
    done.  Physics and constants: ``sims.bicycle.physics``.

    ## Observation Space

    ``Box(5,)``, float64; angles positive to the left.

    | No. | Observation | Unit | Min | Max |
    |-----|-------------|------|-----|-----|
    | 0 | lean of the frame from the vertical | rad | -inf | inf (ends beyond +-pi/15) |
    | 1 | rate of the lean | rad/s | -inf | inf |
    | 2 | angle of the handlebar | rad | -1.3963 | 1.3963 |
    | 3 | rate of the handlebar | rad/s | -inf | inf |
    | 4 | angle to the goal, positive if it is on the left | rad | -pi | pi |

    With ``lean_acceleration=True``, also 5: the lean acceleration in the last step, rad/s^2.

    ## Action Space

    ``Box(2,)``, float64; clipped to its bounds.

    | No. | Action | Unit | Min | Max |
    |-----|--------|------|-----|-----|
    | 0 | torque on the handlebar | N m | -2 | 2 |
    | 1 | displacement of the rider from the frame's plane | m | -0.02 | 0.02 |

    A disturbance, uniform in [-0.02, 0.02] m and new in every step of 0.01 s, is added to the
    displacement after the clipping.

    ## Rewards

    *r = -(angle_to_goal^2 + 10 lean^2) dt*, of the state a step arrives at: a cost per second.
    ``fall_penalty`` (default 0) is taken off in the step that ends in a fall.  Without it a fall
    costs nothing and ends all further cost, so that an agent that maximises the sum over an episode
    does best to fall at once, above all with the goal behind it; such agents want a penalty (the
    most that a ride can cost is about pi^2 per second), or a discount far from 1.

    ## Starting State

    Upright, straight and at rest at the origin, the goal's centre at (1000, 0) m; the heading is
    uniform over all directions (``start_heading_low``, ``start_heading_high``: the angle psi from
    +y in rad; 0 for both is the original start, with the goal 90 degrees to the right).

    ## Episode End

    Termination: the lean exceeds 12 degrees (pi/15; info ``outcome`` FAILED), or the front tyre is
    within ``goal_radius`` = 10 m of the goal (SUCCEEDED).  Truncation: after ``time_limit`` = 1000
    s, that is 100,000 steps (TIMED_OUT).  The shortest ride takes 356.0 s straight ahead and 360 s
    from behind.

    ## Arguments

    ``fall_penalty``, ``render_mode`` (None, "rgb_array"), and all those of ``sims.bicycle.Bicycle``
    by name.

    ```python
    >>> import gymnasium
    >>> env = gymnasium.make("sims.gymnasium_env:edtorch/Bicycle-v0", noise=0.0)
    >>> observation, info = env.reset(seed=3)
    >>> observation.round(3).tolist()[:4]
    [0.0, 0.0, 0.0, 0.0]
    >>> observation, reward, terminated, truncated, info = env.step(env.action_space.sample())
    >>> terminated, truncated
    (False, False)

    ```

    ## Version History

    * v0: first version.
    """

    def __init__(
        self, *, fall_penalty: float = 0.0, render_mode: str | None = None, **bicycle: Any
    ) -> None:
        """A bicycle, with the arguments ``bicycle`` of ``sims.bicycle.Bicycle``."""
        if not (math.isfinite(fall_penalty) and fall_penalty >= 0):
            raise ValueError(f"fall_penalty={fall_penalty!r}: expected a finite number, 0 or more")
        sim = Bicycle(**bicycle)
        lean, angle = spec_index(sim.spec, ("lean", "angle_to_goal"))
        stop = float(sim.physics.theta_max)
        super().__init__(
            sim,
            _RidingCost(lean, angle, sim.dt),
            fail_penalty=fall_penalty,
            render_mode=render_mode,
            bounds={"handlebar": (-stop, stop)},
        )


@dataclass(frozen=True)
class _RidingCost:
    """The reward of a step of ``dt`` seconds; lean, angle: where they are in the observation."""

    lean: int
    angle: int
    dt: float

    def __call__(self, before: Array, action: Array, after: Array) -> float:
        return -(after[self.angle] ** 2 + 10 * after[self.lean] ** 2) * self.dt


def _observation_space(
    spec: Spec, bounds: Mapping[str, tuple[float, float]]
) -> gymnasium.Space[Array]:
    spec_index(spec, bounds)
    own = {
        q.name: (-q.period / 2, q.period / 2) if q.period else (q.low, q.high) for q in spec.state
    }
    low, high = np.array(list((own | dict(bounds)).values()), dtype=np.float64).T
    return cast("gymnasium.Space[Array]", spaces.Box(low, high, dtype=np.float64))


def _action_space(spec: Spec) -> gymnasium.Space[Array]:
    low, high = [q.low for q in spec.action], [q.high for q in spec.action]
    box = spaces.Box(np.array(low), np.array(high), dtype=np.float64)
    return cast("gymnasium.Space[Array]", box)
