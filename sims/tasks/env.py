"""The tasks among Gymnasium's environments: ``edtorch/CartPoleSwingUp-v0``..."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar

import numpy as np
import torch

from sims.base import spec_index
from sims.gymnasium_env import Array, SimEnv
from sims.sensing import Sensed
from sims.tasks.cart_double_pendulum import CartDoublePendulum
from sims.tasks.cart_pole_swing_up import CartPoleSwingUp
from sims.tasks.double_pendulum import DoublePendulum
from sims.tasks.five_links import SHANK, THIGH
from sims.tasks.held_tip import HeldTip
from sims.tasks.pendubot import Pendubot
from sims.tasks.pendulum_swing_up import PendulumSwingUp
from sims.tasks.stop_pendulum import StopPendulum
from sims.tasks.unicycle import RADIUS, TO_DISC, Unicycle
from sims.tasks.walker import Walker


class HeldTipEnv(SimEnv):
    """Swing rods up and hold their tip at a place, all seen through noisy sensors.

    Observation, action, start and success are those of the task (``sims.tasks``); each component is
    read with a normal error of standard deviation ``noise``.

    The reward of a step is PILCO's, *r = exp(-d^2 / (2 width^2))*, d the distance of the tip from
    its target by the reading that the step returns: between 0 and 1.

    Nothing terminates an episode; it is truncated at the time limit, where info ``outcome`` says
    SUCCEEDED or TIMED_OUT.

    Arguments: ``noise``, ``render_mode`` (None, "rgb_array"), and those of the task by name, but
    for ``amplitude``: no component tells the time of a target that moves.
    """

    task: ClassVar[Callable[..., HeldTip]]

    def __init__(
        self, *, noise: float = 0.01, render_mode: str | None = None, **arguments: Any
    ) -> None:
        """The task, with ``arguments`` of its own, seen through sensors."""
        task = type(self).task(**arguments)
        amplitude = task.constants.amplitude
        if amplitude != 0:
            raise ValueError(
                f"amplitude={amplitude}: expected 0, an observation does not tell the time"
            )
        deviations = {quantity.name: noise for quantity in task.spec.state}
        super().__init__(Sensed(task, deviations), _Nearness(task), render_mode=render_mode)


@dataclass(frozen=True)
class _Nearness:
    """PILCO's reward of a step."""

    task: HeldTip

    def __call__(self, before: Array, action: Array, after: Array) -> float:
        away = float(self.task.distance(torch.as_tensor(after)))
        return float(np.exp(-0.5 * (away / self.task.constants.width) ** 2))


class CartPoleSwingUpEnv(HeldTipEnv):
    """``sims.tasks.cart_pole_swing_up.CartPoleSwingUp``."""

    task = CartPoleSwingUp


class PendulumSwingUpEnv(HeldTipEnv):
    """``sims.tasks.pendulum_swing_up.PendulumSwingUp``."""

    task = PendulumSwingUp


class PendubotEnv(HeldTipEnv):
    """``sims.tasks.pendubot.Pendubot``."""

    task = Pendubot


class DoublePendulumEnv(HeldTipEnv):
    """``sims.tasks.double_pendulum.DoublePendulum``."""

    task = DoublePendulum


class CartDoublePendulumEnv(HeldTipEnv):
    """``sims.tasks.cart_double_pendulum.CartDoublePendulum``."""

    task = CartDoublePendulum


class StopPendulumEnv(HeldTipEnv):
    """``sims.tasks.stop_pendulum.StopPendulum``."""

    task = StopPendulum


class UnicycleEnv(SimEnv):
    """Keep a robotic unicycle upright for ten seconds: ``sims.tasks.unicycle.Unicycle``.

    Each component is read with a normal error of standard deviation ``noise`` (PILCO's unicycle has
    0.01 for rates and 0.003 for angles).

    The reward of a step is *r = exp(-d^2 / 2)*, d (m) the distance of the disc from where it is in
    an upright unicycle on the same point of the ground, by the reading that the step returns.

    A fall terminates an episode (info ``outcome`` FAILED), the time limit truncates it (SUCCEEDED).

    Arguments: ``noise``, ``render_mode`` (None, "rgb_array"), and those of the simulator by name.
    """

    def __init__(
        self,
        *,
        noise: float = 0.01,
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        """The unicycle, with ``arguments`` of its own, seen through sensors."""
        sim = Unicycle(**arguments)
        deviations = {quantity.name: noise for quantity in sim.spec.state}
        roll, pitch = spec_index(sim.spec, ("roll", "pitch"))
        super().__init__(Sensed(sim, deviations), _Height(roll, pitch), render_mode=render_mode)


@dataclass(frozen=True)
class _Height:
    """The reward of a step; roll, pitch: where they are in the observation."""

    roll: int
    pitch: int

    def __call__(self, before: Array, action: Array, after: Array) -> float:
        forward = TO_DISC * np.sin(after[self.pitch])
        up, top = RADIUS + TO_DISC * np.cos(after[self.pitch]), RADIUS + TO_DISC
        square = forward**2 + up**2 + top**2 - 2 * up * top * np.cos(after[self.roll])
        return float(np.exp(-0.5 * square))


class WalkerEnv(SimEnv):
    """Walk a planar biped from rest: ``sims.tasks.walker.Walker``.

    Leans are read with a normal error of standard deviation 0.001 rad, their rates with 0.005 rad/s
    (``noise``, ``rate_noise``), steps and forces without.

    The reward of a step is how far the hip went forward (m), by the leans and rates that the step
    returns.

    A fall terminates an episode (info ``outcome`` FAILED, SUCCEEDED after enough steps), the time
    limit truncates it (SUCCEEDED or TIMED_OUT).

    Arguments: ``noise``, ``rate_noise``, ``render_mode`` (None, "rgb_array"), and those of the
    simulator by name.
    """

    def __init__(
        self,
        *,
        noise: float = 0.001,
        rate_noise: float = 0.005,
        render_mode: str | None = None,
        **arguments: Any,
    ) -> None:
        """The walker, with ``arguments`` of its own, seen through sensors."""
        sim = Walker(**arguments)
        deviations = {
            quantity.name: rate_noise if quantity.rate_of else noise
            for quantity in sim.spec.state[:10]
        }
        super().__init__(Sensed(sim, deviations), _Forward(sim.spec.dt), render_mode=render_mode)


@dataclass(frozen=True)
class _Forward:
    """The speed of the hip times ``dt``; shank and thigh of the stance leg are observed first."""

    dt: float

    def __call__(self, before: Array, action: Array, after: Array) -> float:
        shank, shank_rate, thigh, thigh_rate = after[:4]
        speed = SHANK * np.cos(shank) * shank_rate + THIGH * np.cos(thigh) * thigh_rate
        return float(speed * self.dt)
