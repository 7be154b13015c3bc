"""A sweep's table, ``sweep.csv``."""

from __future__ import annotations

SWEEP = "sweep.csv"
FOLDER, STATE, HEADLINE = "folder", "status", "headline"
