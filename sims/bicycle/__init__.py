"""The bicycle of Randløv & Alstrøm, and harder worlds for it."""

from sims.bicycle.bicycle import (
    GOAL,
    HANDLEBAR_FIRST,
    RANDLOV,
    STATE,
    Bicycle,
    Physics,
    angle_to_goal,
    explicit_euler,
    semi_implicit,
    step,
)

__all__ = [
    "GOAL",
    "HANDLEBAR_FIRST",
    "RANDLOV",
    "STATE",
    "Bicycle",
    "Physics",
    "angle_to_goal",
    "explicit_euler",
    "semi_implicit",
    "step",
]
