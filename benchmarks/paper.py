"""The numbers of section 4's bicycle, for the peers that are written for it alone.

edtorch reads them from conf/experiment/bicycle_paper.yaml; tests/benchmarks/test_peers.py says when
the two part.  The constants of the bicycle itself are the simulator's: only the code is the peers'.
"""

from __future__ import annotations

import math

from sims.bicycle import GOAL
from sims.bicycle.physics import RANDLOV, WHEELBASE_TOLERANCE

__all__ = ["GOAL", "WHEELBASE_TOLERANCE"]

N, M = 5, 2
"""Lean, its rate, handlebar, its rate, angle to the goal; torque, displacement."""
STATE_SCALE = (math.pi / 15, 0.5, 0.5, 2.0, math.pi)
ACTION_SCALE = (2.0, 0.02)
"""The bounds of the actions, too: they are held within +-1 in scaled units."""
TURN = 2.0
"""A full turn of the angle to the goal, scaled."""

DT = 0.01
LIMIT_TICKS = 100_000
GOAL_RADIUS = 10.0
DISTURBANCE = 0.02

EXPLORATION = 0.05
FIT_RATE = 1.0 * DT
NOISE_RATE = 1.0 * DT
"""Of the moving average of squared residuals; with covariance only.  Like all rates, per tick."""
ALPHA, BETA = 0.1 * DT, 1.0

HORIZON, UNROLL_DT = 30, 0.051
STATE_COST = (10.0 * STATE_SCALE[0] ** 2, 0.0, 0.0, 0.0, STATE_SCALE[4] ** 2)
"""Of the scaled components squared, per second."""

# What a step needs of the bicycle's constants, multiplied out once, as anybody would.
WHEELBASE, HEIGHT = float(RANDLOV.l), float(RANDLOV.h)
BEHIND = WHEELBASE - float(RANDLOV.c)
"""From the back tyre to the centre of mass."""
STOP, FALLEN = float(RANDLOV.theta_max), float(RANDLOV.omega_max)
TRAVEL = float(RANDLOV.v) * DT
"""The way of a tyre in a tick."""
TYRE_TERM = float(RANDLOV.v**2 * RANDLOV.M_d * RANDLOV.r / (RANDLOV.l * RANDLOV.I_B))
CENTRE_TERM = float(RANDLOV.v**2 * RANDLOV.M * RANDLOV.h / RANDLOV.I_B)
GYROSCOPIC_TERM = float(RANDLOV.I_d * RANDLOV.sigma_dot / RANDLOV.I_B)
GRAVITY_TERM = float(RANDLOV.h * RANDLOV.M * RANDLOV.g / RANDLOV.I_B)
TORQUE_TERM = 1 / (0.5 * float(RANDLOV.I_d))
SPIN_TERM = 3 * float(RANDLOV.sigma_dot)
