"""What a population of learners reports of a moment: rows, scalars and a line of a snapshot."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence

from edtorch.run.episodes import Episode, Snapshot
from edtorch.run.log import Entry, median_known
from sims.base import DEFAULT_WORDS, Words

_METRICS = (
    *("active", "episodes", "failures", "successes", "episode_seconds"),
    *("value", "gradient", "error", "policy_norm"),
)


class Snapshots:
    """Entries of a population of learners, in the words of the domain: a row per learner; scalars
    by simulated seconds, their median over the learners, and extremes where they tell.

    can_fail, can_succeed: whether the domain declares it; otherwise the line counts failures and
    successes from the first failure on, before which a time-out may be either, and without either
    the episodes.
    """

    def __init__(
        self, words: Words = DEFAULT_WORDS, *, can_fail: bool = True, can_succeed: bool = True
    ) -> None:
        self._words = words
        self._declared = can_fail, can_succeed
        named = {"failures": words.failures, "successes": words.successes}
        metrics = [named.get(name, name) for name in _METRICS]
        self.columns = ("seconds", "seed", *metrics, "value_error_estimate")
        self._last_seconds, self._last_time = 0.0, time.monotonic()

    def entry(self, snapshot: Snapshot, episodes: Sequence[Episode]) -> Entry:
        """Of a moment; episodes: those that have ended since the one before."""
        columns = [getattr(snapshot, name) for name in _METRICS]
        columns.append(snapshot.value_error or [math.nan] * len(snapshot.seeds))
        seconds = f"{snapshot.seconds:g}"
        return Entry(
            rows=[(seconds, *row) for row in zip(snapshot.seeds, *columns, strict=True)],
            scalars=self._scalars(snapshot, episodes),
            step=round(snapshot.seconds),
            line=self._line(snapshot),
            episodes=[(snapshot.seeds[e.row], e) for e in episodes],
        )

    def _scalars(self, snapshot: Snapshot, episodes: Sequence[Episode]) -> dict[str, float]:
        scalars: dict[str, float] = {
            "learning/value": median_known(snapshot.value),
            "learning/gradient": median_known(snapshot.gradient),
            "learning/model_error": median_known(snapshot.error),
            "learning/policy_norm": median_known(snapshot.policy_norm),
            "population/active": float(sum(snapshot.active)),
        }
        if snapshot.value_error is not None:
            scalars["learning/value error estimate"] = median_known(snapshot.value_error)
        words = self._words
        named = {words.failures: snapshot.failures, words.successes: snapshot.successes}
        for name, numbers in named.items():
            counts = [float(v) for v in numbers]
            scalars |= {
                f"{name}/median": median_known(counts),
                f"{name}/min": min(counts),
                f"{name}/max": max(counts),
            }
        if episodes:
            lengths = [e.seconds for e in episodes]
            scalars |= {
                "episodes/seconds_median": median_known(lengths),
                "episodes/seconds_max": max(lengths),
                "episodes/return": median_known([e.total_reward for e in episodes]),
            }
            for measure in episodes[0].measures:
                scalars[f"episodes/{measure}"] = median_known(
                    [e.measures[measure] for e in episodes]
                )
        return scalars

    def _line(self, snapshot: Snapshot) -> str:
        now = time.monotonic()
        speed = (snapshot.seconds - self._last_seconds) / max(now - self._last_time, 1e-9)
        self._last_seconds, self._last_time = snapshot.seconds, now
        return (
            f"{snapshot.seconds:6.0f} s  {self._counts(snapshot)}  "
            f"value {median_known(snapshot.value):.3g}  "
            f"{sum(snapshot.active)}/{len(snapshot.seeds)} learning  {speed:.0f} s per s"
        )

    def _counts(self, snapshot: Snapshot) -> str:
        counted = (
            (self._words.failures, snapshot.failures),
            (self._words.successes, snapshot.successes),
        )
        told = [
            f"{name} {_spread(counts)}"
            for (name, counts), declared in zip(counted, self._declared, strict=True)
            if declared or (any(counts) and any(snapshot.failures))
        ]
        return "  ".join(told) or f"episodes {_spread(snapshot.episodes)}"


def _spread(counts: Sequence[int]) -> str:
    return f"{median_known(counts):g} [{min(counts)}, {max(counts)}]"
