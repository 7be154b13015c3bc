"""Every pair of kinds of parts in some kernel that equals the eager tick (make test-long)."""

from __future__ import annotations

from itertools import combinations, product

import pytest

from tests.native.kinds import LINEAR, farthest, lives, native, training_of

Choice = dict[str, str]
Pair = tuple[tuple[str, str], tuple[str, str]]

CALM = (
    *LINEAR,
    "domain.state_matrix=[[0.95,0.1],[0.0,0.9]]",
    "unroll.horizon=5",
    "schedule.first=60",
    "seeds=3",
    "train.seconds=1000",
)
"""Where learners neither explode nor flip signs at the last digit, which no two ways share."""
RATES = {
    "fit=absolute": 0.01,
    "fit=absolute_decaying": 0.01,
    "fit=squared": 0.1,
    "fit=normalised": 0.5,
}

FACTORS: dict[str, tuple[str, ...]] = {
    "form": ("model=derivative", "model=next_state"),
    "model": ("model.features=identity", "model.features=affine"),
    "policy": ("policy=linear", "policy=affine"),
    "fit": (
        "fit=absolute",
        "fit=absolute_decaying",
        "fit=squared",
        "fit=normalised",
        "fit=least_squares",
        "fit=adaptive",
    ),
    "transform": ("transform=mean_only", "transform=first", "unroll.direction=regulator"),
    "step": ("step=saturated", "step=decaying", "step=plain", "step=full"),
    "start": ("unroll.start=state", "unroll.start=origin"),
    "cost": ("", "+reward.action.action_0=0.3", "+reward.target.state_0=0.4"),
    "command": ("command=free", "command=ramp"),
    "exploration": ("exploration.start=null", "exploration.start=1.0"),
    "lanes": ("1", "32"),
}


def makes_sense(choice: Choice) -> bool:
    """Whether the configuration allows it, as far as it says."""
    regulated = choice.get("transform", "") == "unroll.direction=regulator"
    priced = choice.get("cost", "+reward.action").startswith("+reward.action")
    fits = choice.get("model") != "model.features=affine" or choice.get("policy") != "policy=linear"
    if regulated and not (priced and fits):
        return False
    # A whole step goes to where a direction leads: only Riccati's leads somewhere.
    return not {"transform", "step"} <= choice.keys() or regulated == (
        choice["step"] == "step=full"
    )


def completed(row: Choice, wanted: set[Pair]) -> Choice | None:
    """The rest of a configuration, with as many wanted pairs as can be; None if there is none."""
    missing = [name for name in FACTORS if name not in row]
    if not missing:
        return row
    name = missing[0]
    options = [x for x in FACTORS[name] if makes_sense({**row, name: x})]
    options.sort(key=lambda x: -len(pairs_of({**row, name: x}) & wanted))
    found = (completed({**row, name: x}, wanted) for x in options)
    return next((whole for whole in found if whole is not None), None)


def covering() -> list[Choice]:
    """Configurations in which every pair of kinds occurs that is allowed, made one by one."""
    wanted = {
        pair
        for a, b in combinations(FACTORS, 2)
        for pair in product(((a, x) for x in FACTORS[a]), ((b, y) for y in FACTORS[b]))
        if makes_sense(dict(pair))
    }
    rows: list[Choice] = []
    while wanted:
        row = completed(dict(min(wanted)), wanted)
        if row is None:
            wanted.discard(min(wanted))
            continue
        wanted -= pairs_of(row)
        rows.append(row)
    return rows


def pairs_of(row: Choice) -> set[Pair]:
    ordered = [(name, row[name]) for name in FACTORS if name in row]
    return set(combinations(ordered, 2))


@pytest.mark.long
@pytest.mark.parametrize("row", covering(), ids=lambda row: "-".join(filter(None, row.values())))
def test_every_pair_of_kinds(row: Choice) -> None:
    parts = [part for name, part in row.items() if name != "lanes" and part]
    parts.sort(key=lambda part: part.count("."))
    if row["command"] != "command=free":
        parts.append("command.component=state_1")
    if row["step"] != "step=full":
        parts.append("step.alpha=0.01")
    if row["fit"] in RATES:
        rule = "fit.rule.rate" if row["fit"] == "fit=absolute_decaying" else "fit.rate"
        parts.append(f"{rule}={RATES[row['fit']]}")
    how = [*CALM, *parts]
    eager, compiled = training_of(*how), native(training_of(*how), lanes=int(row["lanes"]))
    for training in (eager, compiled):
        training.advance(300)
    assert lives(compiled) == lives(eager)
    worst = farthest(compiled, eager)
    assert max(worst.values()) < 1e-9, worst
