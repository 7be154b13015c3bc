"""Every pair of kinds of parts in some kernel that equals the eager tick (make test-long)."""

from __future__ import annotations

from itertools import combinations, product

import pytest

from tests.native.kinds import LINEAR, farthest, lives, native, training_of

Choice = dict[str, str]

FACTORS: dict[str, tuple[str, ...]] = {
    "form": ("model=derivative", "model=next_state"),
    "model": ("model.features=identity", "model.features=affine"),
    "policy": ("policy=linear", "policy=affine"),
    "fit": tuple(
        f"fit={name}"
        for name in ("absolute", "absolute_decaying", "squared", "normalised", "least_squares")
    )
    + ("fit=adaptive",),
    "transform": ("transform=mean_only", "transform=first", "unroll.direction=regulator"),
    "step": ("step=saturated", "step=decaying", "step=plain", "step=full"),
    "start": ("unroll.start=state", "unroll.start=origin"),
    "cost": ("", "+reward.action.action_0=0.3", "+reward.target.state_0=0.4"),
    "command": ("command=free", "command=ramp", "command=safe"),
    "exploration": ("exploration.start=null", "exploration.start=1.0"),
    "lanes": ("1", "32"),
}


def makes_sense(choice: Choice) -> bool:
    """Whether the configuration allows it, as far as it says."""
    affine = "affine" in choice.get("model", "") or "affine" in choice.get("policy", "")
    if choice.get("command") == "command=safe" and affine:
        return False
    regulated = choice.get("transform") == "unroll.direction=regulator"
    if regulated and choice.get("cost") in ("", "+reward.target.state_0=0.4"):
        return False
    if (
        regulated
        and "affine" in choice.get("model", "")
        and choice.get("policy") == "policy=linear"
    ):
        return False
    # A whole step goes to where a direction leads: only Riccati's leads somewhere.
    if "transform" in choice and "step" in choice:
        return regulated == (choice["step"] == "step=full")
    return True


def covering() -> list[Choice]:
    """Choices, made one after the other, each with as many new pairs as can be."""
    names = list(FACTORS)
    wanted = {
        ((a, x), (b, y))
        for a, b in combinations(names, 2)
        for x, y in product(FACTORS[a], FACTORS[b])
        if makes_sense({a: x, b: y})
    }
    rows: list[Choice] = []
    while wanted:
        row = dict(min(wanted))
        for name in names:
            if name in row:
                continue
            options = [x for x in FACTORS[name] if makes_sense({**row, name: x})]
            row[name] = max(options, key=lambda x: len(new_pairs({**row, name: x}) & wanted))
        found = new_pairs(row) & wanted
        if not found:
            # What a third part forbids.
            wanted.discard(min(wanted))
            continue
        wanted -= found
        rows.append(row)
    return rows


def new_pairs(row: Choice) -> set[tuple[tuple[str, str], tuple[str, str]]]:
    ordered = [(name, row[name]) for name in FACTORS if name in row]
    return set(combinations(ordered, 2))


@pytest.mark.long
@pytest.mark.parametrize("row", covering(), ids=lambda row: "-".join(filter(None, row.values())))
def test_every_pair_of_kinds(row: Choice) -> None:
    parts = [part for name, part in row.items() if name != "lanes" and part]
    parts.sort(key=lambda part: part.count("."))
    more = (
        ["+command.component=state_1", "command.horizon=4"] if "free" not in row["command"] else []
    )
    if row["command"] == "command=safe":
        more.append("+command.limits.state_0=5.0")
    how = [*LINEAR, "seeds=3", "train.seconds=1000", "schedule.first=10", *parts, *more]
    eager, compiled = training_of(*how), native(training_of(*how), lanes=int(row["lanes"]))
    for training in (eager, compiled):
        training.advance(300)
    assert lives(compiled) == lives(eager)
    worst = farthest(compiled, eager)
    assert max(worst.values()) < 1e-9, worst
