"""Pictures of Cardea by PyBullet's TinyRenderer, which needs no display."""

from __future__ import annotations

import os
from functools import lru_cache

import numpy as np
from torch import Tensor

from sims.cardea.arm import SHOULDER, wrist
from sims.cardea.physics import WHEEL_RADIUS, Robot

WIDTH, HEIGHT = 320, 240
_FLOOR, _BALL = (0.86, 0.87, 0.89, 1.0), (0.85, 0.10, 0.12, 1.0)


class _Studio(Robot):
    """The robot on a floor, with a ball where its wrist should be, before a camera."""

    def __init__(self) -> None:
        super().__init__()
        bullet, at = self._bullet, {"physicsClientId": self._client}
        floor = bullet.createVisualShape(
            bullet.GEOM_BOX, halfExtents=[3, 3, 0.01], rgbaColor=_FLOOR, **at
        )
        bullet.createMultiBody(baseVisualShapeIndex=floor, basePosition=[0, 0, -0.01], **at)
        ball = bullet.createVisualShape(bullet.GEOM_SPHERE, radius=0.04, rgbaColor=_BALL, **at)
        self._ball = bullet.createMultiBody(baseVisualShapeIndex=ball, **at)
        self._projection = bullet.computeProjectionMatrixFOV(40, WIDTH / HEIGHT, 0.1, 10)

    def picture(self, state: list[float], goal: np.ndarray) -> np.ndarray:
        """RGB ``[240, 320, 3]`` of a state ``[14]``; goal ``[3]``: of the wrist, m, from the
        shoulder."""
        bullet, at = self._bullet, {"physicsClientId": self._client}
        self.put(state)
        tilt, x = state[5], state[6]
        forward, side, up = goal + SHOULDER
        place = [
            x + forward * np.cos(tilt) + up * np.sin(tilt),
            side,
            WHEEL_RADIUS - forward * np.sin(tilt) + up * np.cos(tilt),
        ]
        bullet.resetBasePositionAndOrientation(self._ball, place, [0, 0, 0, 1], **at)
        view = bullet.computeViewMatrix([x + 1.7, -1.9, 1.55], [x + 0.2, 0, 0.82], [0, 0, 1])
        _, _, pixels, _, _ = bullet.getCameraImage(
            WIDTH,
            HEIGHT,
            view,
            self._projection,
            lightDirection=[1.5, -2.5, 4],
            renderer=bullet.ER_TINY_RENDERER,
            **at,
        )
        return np.asarray(pixels, dtype=np.uint8).reshape(HEIGHT, WIDTH, 4)[..., :3].copy()


def frame(state: Tensor) -> np.ndarray:
    """Picture, RGB uint8 ``[240, 320, 3]``, of one full state of ``sims.cardea.Cardea``."""
    goal = wrist(state[14:19].detach()).numpy()
    return _studio(os.getpid()).picture(state[:14].tolist(), goal)


@lru_cache(maxsize=1)
def _studio(process: int) -> _Studio:
    return _Studio()
