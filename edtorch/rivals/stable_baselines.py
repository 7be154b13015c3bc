"""Algorithms of stable-baselines3 on our worlds, driven piece by piece, one model per seed.

A. Raffin et al., "Stable-Baselines3: Reliable Reinforcement Learning Implementations", JMLR 22,
2021.  Importing this file needs the extra [rivals]; the settings that use it do not
(``edtorch.rivals.sac``, ``edtorch.rivals.ppo``).
"""

from __future__ import annotations

import random
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.logger import Logger
from stable_baselines3.common.vec_env import VecEnv
from torch import Tensor, nn

from edtorch.learner.learner import Actor
from edtorch.rewards import Reward
from edtorch.rivals.base import Problem
from edtorch.rivals.deep import Decisions
from edtorch.rivals.ledger import Account
from edtorch.rivals.networks import Networks, stacked
from edtorch.run.random import Purpose, Streams, stream_key
from edtorch.run.rollout import rollout
from edtorch.run.scaled_sim import World
from edtorch.run.tick import Tick
from edtorch.types import Parameters, Transition, replace
from sims.base import Outcome

SECONDS_BETWEEN_PAUSES = 1.0


def action_box(world: World) -> tuple[Tensor, Tensor]:
    """Centre and radius ``[m]`` of the scaled actions that [-1, 1] stands for: the domain's bounds,
    and one scale to either side of zero for an action without them."""
    bounds = [
        (q.low / q.scale, q.high / q.scale) if np.isfinite([q.low, q.high]).all() else (-1.0, 1.0)
        for q in world.spec.action
    ]
    low, high = torch.tensor(bounds, dtype=world.dtype).unbind(-1)
    return (low + high) / 2, (high - low) / 2


class _Commanded:
    """Does what it is told (``edtorch.run.tick.Source``): its memory is the action."""

    def begin(self, memory: Tensor, fresh: Tensor, observation: Tensor, /) -> Tensor:
        """Nothing changes."""
        return memory

    def act(self, memory: Tensor, observation: Tensor, normal: Tensor, /) -> Tensor:
        """The action."""
        return memory

    def step(
        self, memory: Tensor, transition: Transition, /, *, improve: bool
    ) -> tuple[Tensor, None]:
        """Nothing is learned here."""
        return memory, None


class WorldEnvs(VecEnv):
    """Episodes of one seed in a world, side by side, as stable-baselines3 wants them.

    Observations are the world's scaled ones, float32 and unbounded; actions are in [-1, 1], see
    ``action_box``.  An action is held for ``repeat`` ticks, or until the episode ends; the reward
    of such a decision is ``reward_scale`` times: the sum over its ticks of r dt, of the state that
    each arrives at, less ``failure_penalty`` if it ends in a failure.  Every tick and episode is
    entered in ``account``.  Copy c of a seed draws from the c-th stream of the seed.
    """

    def __init__(
        self, world: World, reward: Reward, lesson: Decisions, seed: int, account: Account
    ) -> None:
        self._world = world
        self._reward = reward
        self._lesson = lesson
        self._account = account
        self._centre, self._radius = action_box(world)
        copies = lesson.copies
        keys = [stream_key(seed, Purpose.LEARNING, copy) for copy in range(copies)]
        self._streams = Streams(keys, world.uniforms, 0, world.dtype)
        # An episode that ends within a decision waits for the decision's end.
        self._tick = Tick(_Commanded(), world, most_episodes=1)
        self._begin = Tick(_Commanded(), world)
        self._clock = 0
        self._paid = 0
        self._ticks = torch.zeros(copies, dtype=torch.int64)
        self._actions = np.zeros((copies, len(world.spec.action)), dtype=np.float32)
        self.render_mode = None
        super().__init__(
            copies,
            spaces.Box(-np.inf, np.inf, (len(world.spec.state),), dtype=np.float32),
            spaces.Box(-1.0, 1.0, (len(world.spec.action),), dtype=np.float32),
        )

    def reset(self) -> np.ndarray:
        """Episodes from their start, ``[copies, n]``; done once, at the beginning."""
        with torch.no_grad():
            start = self._world.initial(self._streams.at(self._clock).uniform)
            self._here = self._tick.first(torch.from_numpy(self._actions), start)
        self._ticks.zero_()
        return self._seen()

    def step_async(self, actions: np.ndarray) -> None:
        """What ``step_wait`` is to do, ``[copies, m]``."""
        self._actions = actions

    def step_wait(self) -> tuple[np.ndarray, np.ndarray, np.ndarray, list[dict[str, Any]]]:
        """One decision of each copy: observation, reward, whether the episode ended, info; those
        whose episode ended are at the start of the next."""
        with torch.no_grad():
            earned, outcome, late = self._hold()
        ended = outcome != int(Outcome.RUNNING)
        failed = outcome == int(Outcome.FAILED)
        lesson = self._lesson
        rewards = lesson.reward_scale * (earned * self._world.dt - lesson.failure_penalty * failed)
        # From the whole, so that no rounding adds up.
        self._account.spend(self._paid * self._world.dt - self._account.seconds)
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        if bool(ended.any()):
            final = self._seen()
            success = self._world.success(self._here.worlds.world, outcome) != 0
            for copy in ended.nonzero().flatten().tolist():
                seconds = int(self._ticks[copy]) * self._world.dt
                end = Outcome(int(outcome[copy]))
                self._account.end(end, seconds, success=bool(success[copy]))
                infos[copy] = {
                    "terminal_observation": final[copy],
                    # Not a state from which nothing more is earned: its value counts.
                    "TimeLimit.truncated": bool(late[copy] & ~failed[copy]),
                }
            with torch.no_grad():
                # From the numbers of the last tick that its own did not use.
                draw = self._streams.at(self._clock)
                self._here = self._begin.turn(self._here, outcome, draw, self._clock)
            self._ticks = torch.where(ended, 0, self._ticks)
        return (
            self._seen(),
            rewards.to(torch.float32).numpy(),
            ended.numpy(),
            infos,
        )

    def _hold(self) -> tuple[Tensor, Tensor, Tensor]:
        """A decision, tick by tick: sum of rewards, outcome, whether time is up, ``[copies]``."""
        world = self._world
        action = torch.from_numpy(self._actions).to(world.dtype)
        action = world.clip(self._centre + self._radius * action)
        earned = torch.zeros(self.num_envs, dtype=world.dtype)
        outcome = torch.full((self.num_envs,), int(Outcome.RUNNING))
        everybody, none = torch.ones_like(outcome, dtype=torch.bool), torch.zeros_like(outcome)
        worlds = replace(self._here.worlds, active=everybody, episodes=none)
        for happened in rollout(
            self._tick,
            replace(self._here, learners=action, worlds=worlds),
            self._streams.at,
            clock=self._clock,
            ticks=self._lesson.repeat,
        ):
            running, self._clock = happened.before.active, happened.clock
            self._paid += int(running.sum())
            self._ticks += running
            earned += running * self._reward(happened.after.observation, action)
            outcome = torch.where(running, happened.outcome, outcome)
            self._here = happened.population
        # An episode that has ended begins anew.
        self._here = replace(self._here, worlds=replace(self._here.worlds, active=everybody))
        return earned, outcome, self._ticks >= world.limit_ticks

    def _seen(self) -> np.ndarray:
        return self._here.worlds.observation.to(torch.float32).numpy().copy()

    def close(self) -> None:
        """Nothing is open."""

    def get_attr(self, attr_name: str, indices: Any = None) -> list[Any]:
        """The attribute, which all copies share, once for each."""
        return [getattr(self, attr_name)] * len(list(self._get_indices(indices)))

    def set_attr(self, attr_name: str, value: Any, indices: Any = None) -> None:
        """Set it for all copies."""
        setattr(self, attr_name, value)

    def env_method(
        self, method_name: str, *method_args: Any, indices: Any = None, **method_kwargs: Any
    ) -> list[Any]:
        """What the method returns, once for each copy."""
        result = getattr(self, method_name)(*method_args, **method_kwargs)
        return [result] * len(list(self._get_indices(indices)))

    def env_is_wrapped(self, wrapper_class: Any, indices: Any = None) -> list[bool]:
        """No copy is."""
        return [False] * len(list(self._get_indices(indices)))


class _GlobalRandom:
    """The state of the generators of Python, NumPy and torch that belong to nobody.

    stable-baselines3 seeds them and draws from them.  Here each model finds them as it left them,
    and so does everybody else.
    """

    def __init__(self) -> None:
        self._own = self._now()

    @staticmethod
    def _now() -> tuple[Any, Any, Tensor]:
        return random.getstate(), np.random.get_state(), torch.get_rng_state()

    @staticmethod
    def _set(states: tuple[Any, Any, Tensor]) -> None:
        python, numpy, of_torch = states
        random.setstate(python)
        np.random.set_state(numpy)
        torch.set_rng_state(of_torch)

    @contextmanager
    def own(self) -> Iterator[None]:
        """The model's numbers inside, everybody else's outside."""
        others = self._now()
        self._set(self._own)
        try:
            yield
        finally:
            self._own = self._now()
            self._set(others)


class BaselinesSearch:
    """A model of stable-baselines3 for each seed (``edtorch.rivals.base.Search``).

    piece: how many decisions the piece of work with this number has; make: a model for these
    episodes and this seed; layers: those of a model's policy, whose activations are ``hidden`` and
    ``squash``.
    """

    def __init__(
        self,
        problem: Problem,
        lesson: Decisions,
        piece: Callable[[int], int],
        make: Callable[[VecEnv, int], BaseAlgorithm],
        layers: Callable[[Any], Sequence[nn.Linear]],
        hidden: Callable[[Tensor], Tensor],
        squash: Callable[[Tensor], Tensor],
    ) -> None:
        self._piece = piece
        self._pieces = [0] * len(problem.seeds)
        self._layers = layers
        self.accounts = [Account() for _ in problem.seeds]
        self.models: list[BaseAlgorithm] = []
        self._random = [_GlobalRandom() for _ in problem.seeds]
        for seed, account, numbers in zip(problem.seeds, self.accounts, self._random, strict=True):
            with numbers.own():
                envs = WorldEnvs(problem.world, problem.reward, lesson, seed, account)
                # NumPy's global generator takes 32 bits.
                model = make(envs, seed % 2**32)
                model.set_logger(Logger(None, []))
                self.models.append(model)
        centre, radius = action_box(problem.world)
        count = len(layers(self.models[0]))
        self._actor = Networks(count, hidden, squash, centre, radius)

    @property
    def actor(self) -> Actor:
        """The deterministic policy: what ``predict(deterministic=True)`` of a model does."""
        return self._actor

    @property
    def parameters(self) -> Parameters:
        """The current policies."""
        return stacked([self._layers(model) for model in self.models])

    @property
    def done(self) -> list[bool]:
        """Never: the budget ends it."""
        return [False] * len(self.models)

    def advance(self, going: Sequence[bool], pause: Callable[[], None]) -> None:
        """The next piece of work of each model that is ``going``, in whole rollouts."""
        last = time.monotonic()

        def look(local: dict[str, Any], everywhere: dict[str, Any]) -> bool:
            nonlocal last
            if time.monotonic() - last > SECONDS_BETWEEN_PAUSES:
                last = time.monotonic()
                pause()
            return True

        for row, (model, numbers) in enumerate(zip(self.models, self._random, strict=True)):
            if going[row]:
                with numbers.own():
                    steps = self._piece(self._pieces[row])
                    model.learn(steps, callback=look, reset_num_timesteps=False)
                self._pieces[row] += 1
