"""Keeping the best policy: judged by episodes that are not reported, learner by learner."""

from __future__ import annotations

import torch

from edtorch.app.best import Kept, better, score
from edtorch.run.episodes import Episode
from sims.base import Outcome


def _episodes(*errors: float, failed: int = 0) -> list[Episode]:
    return [
        Episode(
            row=0,
            number=k,
            start=0.0,
            seconds=2.0,
            outcome=Outcome.FAILED if k < failed else Outcome.SUCCEEDED,
            measures={"joint_error_rad": error, "joint_speed_rad_s": 9.0},
        )
        for k, error in enumerate(errors)
    ]


def _offer(old: Kept | None, minutes: float, judged: list[list[Episode]]) -> Kept:
    parameters = {"weight": torch.full((len(judged), 2), minutes)}
    return better(old, parameters, minutes, judged, [_episodes(minutes) for _ in judged])


def test_a_score_is_the_share_that_failed_and_then_the_mean_error() -> None:
    assert score(_episodes(0.1, 0.3)) == (0.0, 0.2)
    assert score(_episodes(0.1, 0.3, failed=1)) == (0.5, 0.2)
    assert score(_episodes(9.0, 9.0)) < score(_episodes(0.0, 0.0, failed=1))


def test_each_learner_keeps_its_own_best() -> None:
    kept = _offer(None, 1.0, [_episodes(0.3, 0.3), _episodes(0.1, 0.1)])
    kept = _offer(kept, 2.0, [_episodes(0.2, 0.2), _episodes(0.2, 0.2)])
    kept = _offer(kept, 3.0, [_episodes(0.0, 0.0, failed=1), _episodes(0.1, 0.1)])
    assert kept.minutes == [2.0, 1.0]
    assert kept.parameters["weight"].tolist() == [[2.0, 2.0], [1.0, 1.0]]
    figures = kept.as_json()
    assert figures["minutes"]["per_seed"] == [2.0, 1.0]
    assert figures["joint_error_rad"]["per_seed"] == [2.0, 1.0]  # of the episodes to report
