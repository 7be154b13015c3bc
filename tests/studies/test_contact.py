"""What the tables of ``studies.contact`` are made of, on fewer and shorter episodes."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from torch import Tensor

from studies import contact
from studies.contact import KINDS, NOISE, Walks, kinds_of, later_error, table


@pytest.fixture(scope="module")
def walks() -> Walks:
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(contact, "TICKS", 60)
        return contact.walked([3])


def test_readings_err_as_told_and_ticks_are_of_one_kind(walks: Walks) -> None:
    error = (walks.read - walks.seen)[..., :10].flatten(0, 1)
    assert error.std(0).numpy() == pytest.approx(NOISE[:10].numpy(), rel=0.06)
    kinds = torch.stack(list(kinds_of(walks).values()))
    assert bool((kinds.sum(0) <= 1).all()) and bool(kinds.flatten(1).any(1).all())
    assert not bool((kinds.any(0) & ~walks.moved).any())
    struck = (walks.true[1:, :, 11] > walks.true[:-1, :, 11]) & walks.moved
    assert torch.equal(kinds[KINDS.index("strike")], struck)


def test_at_a_knee_hit_its_rate_drops_to_zero(walks: Walks) -> None:
    """In free ticks no knee is shut, in locked ones one of them is all the time."""
    kinds = kinds_of(walks)
    gaps = torch.stack([walks.true[..., 0] - walks.true[..., 2],
                        walks.true[..., 8] - walks.true[..., 6]], -1)  # fmt: skip
    rates = torch.stack([walks.true[..., 1] - walks.true[..., 3],
                         walks.true[..., 9] - walks.true[..., 7]], -1)  # fmt: skip
    assert float(gaps[:-1][kinds["free"]].min()) > contact.FAR
    hit = kinds["knee hit"]
    shut = gaps[1:][hit].abs() < 1e-9
    assert bool(shut.any(-1).all())
    assert float(rates[1:][hit][shut].abs().max()) < 1e-9
    # A knee that was opening may turn within the tick.
    assert float(rates[:-1][hit][shut].median()) < -1
    assert float(rates[1:][kinds["locked"]].abs().min(-1).values.max()) < 1e-9


def test_the_walker_itself_errs_by_nothing_later(walks: Walks, monkeypatch: Any) -> None:
    monkeypatch.setattr(contact, "TICKS", 60)
    struck = walks.true[1:, :, 11] != walks.true[:-1, :, 11]
    full = {tuple(row.tolist()): k for k, row in enumerate(walks.seen.flatten(0, 1))}

    def step(state: Tensor, action: Tensor) -> Tensor:
        rows = torch.tensor([full[tuple(row.tolist())] for row in state])
        return walks.seen.flatten(0, 1)[rows + walks.seen.shape[1]]

    assert later_error(walks, step, None, struck) == 0.0
    assert later_error(walks, lambda state, _: state, None, struck) > 0.1


@pytest.mark.long
def test_a_hybrid_model_predicts_events_and_smooth_ones_do_not(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The goals of docs/contact.md: 20 times less error at a knee hit, 10 times at a strike."""
    monkeypatch.setattr(contact, "TICKS", 60)
    kept, picture = tmp_path / "kept", tmp_path / "prediction.png"
    arguments = ["contact", "prediction", "--seeds", "3", "--keep", str(kept)]
    monkeypatch.setattr("sys.argv", [*arguments, "--figure", str(picture)])
    contact.main()
    content = json.loads((kept / "prediction.json").read_text(encoding="utf-8"))
    (found,) = content["results"]
    errors = found["one_tick"]
    smooth = ("chain on all ticks", "implicit", "products")
    for kind, factor in (("knee hit", 20), ("strike", 10)):
        assert factor * errors["hybrid"][kind] < min(errors[name][kind] for name in smooth)
    # Half a second of the products explodes in some seeds: infinite is a figure, too.
    assert found["half_second"]["hybrid"] < 0.1 < found["half_second"]["chain on all ticks"]
    assert table(content["results"]) in capsys.readouterr().out
    assert picture.stat().st_size > 10_000


def test_the_table_has_medians_over_the_seeds() -> None:
    def of(seed: int, error: float) -> dict[str, object]:
        return {
            "seed": seed,
            "ticks": dict.fromkeys(KINDS, 1),
            "one_tick": {"one": dict.fromkeys(KINDS, error)},
            "half_second": {"one": 10 * error},
        }

    last = table([of(0, 0.1), of(1, 0.3), of(2, np.inf)]).splitlines()[-1]
    assert last == "| one | 0.3 | 0.3 | 0.3 | 0.3 | 3 |"
