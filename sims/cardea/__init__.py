"""Cardea: an arm on a self-balancing base (section 5)."""

from sims.cardea.cardea import LIMITS, STOPS, Cardea, Trouble, slant, wrist

__all__ = ["LIMITS", "STOPS", "Cardea", "Trouble", "slant", "wrist"]
