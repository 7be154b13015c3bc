"""What a search knows, and that it survives a checkpoint."""

from __future__ import annotations

import torch

from edtorch.run.state_file import load_state, save_state
from edtorch.search.knowledge import WARM, Knowledge
from tests.systems import normal


def _knowledge() -> Knowledge:
    g, known = torch.Generator().manual_seed(0), Knowledge()
    for ticks in (4, 2):
        known = known.with_trial(
            normal(g, ticks + 1, 3), normal(g, ticks, 1), torch.arange(ticks) != 1
        )
    for _ in range(WARM + 1):
        known = known.with_plan({"raw": normal(g, 5, 1)})
    return known


def test_transitions_do_not_cross_from_trial_to_trial() -> None:
    known = _knowledge()
    found = known.transitions(0.1)
    first, second = known.readings
    assert torch.equal(found.state, torch.cat([first[:-1], second[:-1]]))
    assert torch.equal(found.next_state, torch.cat([first[1:], second[1:]]))
    assert found.valid.tolist() == [True, False, True, True, True, False]


def test_the_last_plans_are_kept_the_last_one_first() -> None:
    known = _knowledge()
    again = known.with_plan({"raw": torch.zeros(5, 1)})
    assert len(again.plans) == WARM
    assert torch.equal(again.plans[0]["raw"], torch.zeros(5, 1))
    assert torch.equal(again.plans[1]["raw"], known.plans[0]["raw"])


def test_it_survives_a_checkpoint(tmp_path) -> None:
    known, path = _knowledge(), tmp_path / "state.safetensors"
    save_state(path, {"known": known.state()})
    again = Knowledge.of_state(load_state(path)["known"])
    for name in ("readings", "actions", "valid"):
        pairs = zip(getattr(known, name), getattr(again, name), strict=True)
        assert all(torch.equal(a, b) for a, b in pairs)
    for one, other in zip(known.plans, again.plans, strict=True):
        assert torch.equal(one["raw"], other["raw"]) and one.keys() == other.keys()
