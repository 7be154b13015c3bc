"""Keeping the best policy: judged by episodes that are not reported, learner by learner."""

from __future__ import annotations

import math

import torch

from edtorch.app.best import Kept, better, score
from edtorch.report.domain import Domain
from edtorch.run.episodes import Episode
from sims.base import DEFAULT_WORDS, Measure, Outcome

ARM = Domain("arm", DEFAULT_WORDS, (Measure("error_rad", "error", "rad", "lower"),), False)
ENDS = {True: Outcome.SUCCEEDED, False: Outcome.FAILED, None: Outcome.TIMED_OUT}


def _episodes(*returns: float, ends: tuple[bool | None, ...] = ()) -> list[Episode]:
    """By default all come to the time limit, of which nothing is known."""
    return [
        Episode(0, k, 0.0, 2.0, ENDS[end], {"error_rad": -total}, total, end)
        for k, (total, end) in enumerate(zip(returns, ends or (None,) * len(returns), strict=True))
    ]


def _offer(old: Kept | None, minutes: float, judged: list[list[Episode]]) -> Kept:
    parameters = {"weight": torch.full((len(judged), 2), minutes)}
    return better(old, parameters, minutes, judged, [_episodes(minutes) for _ in judged])


def test_by_success_then_without_failure_then_by_return() -> None:
    assert score(_episodes(-1.0, -3.0)) == (0, 1, -2)
    assert score(_episodes(-1.0, -3.0, ends=(True, False))) == (0.5, 0.5, -2)
    successful = score(_episodes(-9.0, -9.0, ends=(True, False)))
    assert successful > score(_episodes(-1.0, -1.0))
    # A crash ends the costs of an episode; that does not make it better.
    assert score(_episodes(-9.0, -9.0)) > score(_episodes(-1.0, -1.0, ends=(None, False)))
    assert score(_episodes(-1.0)) > score(_episodes(-2.0))
    assert score(_episodes(math.nan)) == (0, 1, -math.inf)


def test_each_learner_keeps_its_own_best() -> None:
    kept = _offer(None, 1.0, [_episodes(-3.0, -3.0), _episodes(-1.0, -1.0)])
    kept = _offer(kept, 2.0, [_episodes(-2.0, -2.0), _episodes(-2.0, -2.0)])
    crash = _episodes(0.0, 0.0, ends=(None, False))
    kept = _offer(kept, 3.0, [crash, _episodes(-1.0, -1.0)])
    assert kept.minutes == [2.0, 1.0]
    assert kept.parameters["weight"].tolist() == [[2.0, 2.0], [1.0, 1.0]]
    figures = kept.as_json(ARM)
    assert figures["minutes"]["per_seed"] == [2.0, 1.0]
    assert figures["return"]["per_seed"] == [2.0, 1.0]  # of the episodes to report
    assert figures["error_rad"]["per_seed"] == [-2.0, -1.0]
