"""What the rerun says: the paper's footnotes and the table of methods, beside what is published."""

from __future__ import annotations

import json
import math
import shlex
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
import yaml

from edtorch.app.rundir import git_commit, json_text, versions
from edtorch.report import samples
from edtorch.report.document import median_cell, proportion, ranges
from edtorch.report.proportions import Proportion, holm, same_rate
from edtorch.report.runs import STATUS, FinishedRun, shares_of
from edtorch.report.statistics import Spread
from edtorch.report.tables import Table, as_markdown
from edtorch.run.files import write_text
from studies.footnote_2 import Falls, zero_policy_falls
from studies.rerun_methods import FIGURE_2, TO_STABLE, Material, estimates, learnt, methods
from studies.rerun_methods import blocks as blocks_of_methods

PUBLISHED = Path(__file__).with_name("published.yaml")
COMMAND = "python -m studies.rerun"
CONDITIONS = ("five_features", "six_features")
SHARES = {"goal": "goal", "stable": "stable_not_to_the_goal"}
"""Of footnote 1: their names here and in the summary of a search."""
SIGNIFICANT = 0.01
NEAR_M = 3.0
"""What footnote 1 is held to: p above the one (Holm), distances within the other."""
PEGASUS, STABLE = "methods/bicycle_pegasus", "stable"
CAPTIONS = {
    "figure_2_upper": "Length of episode against training time; dashed: the median over starts of"
    " the shortest possible time",
    "figure_2_lower": "Angle to the goal in one episode of the first seed after its training",
    "figure_3": "Cardea: error and speed of the joints and share of crashes at the ends of the"
    " episodes; medians and quartiles over the seeds",
}


@dataclass(frozen=True)
class Test:
    """One share of footnote 1 beside another's; p: of two proportions; adjusted: Holm's."""

    condition: str
    share: str
    ours: Proportion
    theirs: Proportion
    p: float
    adjusted: float

    def as_json(self) -> dict[str, Any]:
        return {
            "condition": self.condition,
            "share": self.share,
            "here": self.ours.as_json(),
            "there": self.theirs.as_json(),
            "difference": self.ours.rate - self.theirs.rate,
            "p": self.p,
            "p_holm": self.adjusted,
            "compatible": self.adjusted > SIGNIFICANT,
        }


def beside(here: Mapping[str, Mapping[str, Proportion]], there: Mapping[str, Any]) -> list[Test]:
    """Every share of ``here`` (by condition and name) beside the counts of ``there``."""
    pairs = [
        (condition, name, own, Proportion(*there[condition][name]))
        for condition, shares in here.items()
        for name, own in shares.items()
    ]
    p = [same_rate(own, theirs) for _, _, own, theirs in pairs]
    return [
        Test(*pair, value, adjusted)
        for pair, value, adjusted in zip(pairs, p, holm(p), strict=True)
    ]


def _shares(run: FinishedRun) -> dict[str, Proportion]:
    found = shares_of(run.summary)
    return {
        name: Proportion(found[key]["count"], found[key]["total"]) for name, key in SHARES.items()
    }


def footnote_1(material: Material, published: Mapping[str, Any]) -> dict[str, Any] | None:
    """Both conditions; None unless both are there."""
    found = {name: material.runs.get(f"footnote_1/{name}", ()) for name in CONDITIONS}
    if not all(found.values()):
        return None
    runs = {name: own[0] for name, own in found.items()}
    here = {name: _shares(run) for name, run in runs.items()}
    distances = {
        name: run.summary["median_of_goal_policies"]["path_length_m"] for name, run in runs.items()
    }
    result: dict[str, Any] = {
        "here": {
            name: {
                **{key: share.as_json() for key, share in here[name].items()},
                "distance_m": distances[name],
                "seed": runs[name].summary["seed"],
                "wall_s": runs[name].summary["wall_s"],
                "cpu_s": runs[name].summary["cpu_s"],
            }
            for name in CONDITIONS
        }
    }
    for other in ("preset", "paper"):
        theirs = published[other]
        result[other] = {
            "source": theirs["source"],
            "tests": [test.as_json() for test in beside(here, theirs)],
            "distances": {
                name: _distance(distances[name], theirs[name]["distance_m"]) for name in CONDITIONS
            },
        }
    return result


def _distance(here: float | None, there: float) -> dict[str, Any]:
    difference = None if here is None else here - there
    near = difference is not None and abs(difference) <= NEAR_M
    return {"here": here, "there": there, "difference_m": difference, "within_3_m": near}


def footnote_2(
    material: Material, published: Mapping[str, Any], falls: Falls, weights: int
) -> dict[str, Any]:
    """What one gradient costs PEGASUS; weights: of our policies, five features by two actions."""
    runs = published["runs"]
    costs = [
        ("the paper", published["weights"], published["simulations"], published["fall_s"]),
        ("its count, our fall", published["weights"], published["simulations"], falls.mean_s),
        ("our policy, base counted", weights, runs * (weights + 1), falls.mean_s),
    ]
    first = _first_gradient(material)
    return {
        "zero_policy": falls.as_json(),
        "gradients": [
            {"what": what, "weights": k, "simulations": n, "fall_s": s, "seconds": n * s}
            for what, k, n, s in costs
        ],
        "first_checkpoint_of_pegasus": first,
        "published_seconds": published["seconds"],
        "published_essential_dynamics_s": published["essential_dynamics_s"],
    }


def _first_gradient(material: Material) -> dict[str, Any] | None:
    """What PEGASUS had paid at its first checkpoint, medians over the seeds."""
    firsts = [
        run.summary["checkpoints"][0]
        for run in material.runs.get(PEGASUS, ())
        if run.summary.get("checkpoints")
    ]
    if not firsts:
        return None
    pooled = {
        key: Spread([v for first in firsts for v in first[key]["per_seed"]]).median
        for key in ("episodes", "seconds")
    }
    return {"simulations": pooled["episodes"], "seconds": pooled["seconds"]}


def _footnote_1_blocks(found: Mapping[str, Any] | None) -> list[str]:
    if found is None:
        return ["Missing: see below."]
    blocks: list[str] = []
    for other, title in (
        ("preset", "Beside the figures given for these settings"),
        ("paper", "Beside the paper's own, whose settings are not known"),
    ):
        own = found[other]
        rows = [_test_row(test, own["distances"]) for test in own["tests"]]
        header = ("features", "share", "here", "there", "difference, points", "p", "p (Holm)")
        header += ("compatible", "median distance here, there")
        blocks += [f"### {title}", as_markdown(Table(title, header, tuple(rows)))]
        blocks.append(_verdict(own, other))
    return blocks


def _proportion(found: Mapping[str, Any]) -> Proportion:
    return Proportion(found["count"], found["total"])


def _test_row(test: Mapping[str, Any], distances: Mapping[str, Any]) -> tuple[str, ...]:
    here, there = _proportion(test["here"]), _proportion(test["there"])
    distance = distances[test["condition"]]
    metres = "none" if distance["here"] is None else f"{distance['here']:.1f}"
    names = {"goal": "goal in every run", "stable": "stable, not always to the goal"}
    return (
        test["condition"].removesuffix("_features"),
        names[test["share"]],
        f"{here.count:,}: {proportion(here)}",
        f"{there.count:,} of {there.total:,}: {proportion(there)}",
        f"{100 * test['difference']:+.3f}",
        f"{test['p']:.2g}",
        f"{test['p_holm']:.2g}",
        "yes" if test["compatible"] else "no",
        f"{metres} m, {distance['there']} m" if test["share"] == "goal" else "",
    )


def _verdict(own: Mapping[str, Any], other: str) -> str:
    """The difference, plainly."""
    differ = [test for test in own["tests"] if not test["compatible"]]
    far = [name for name, d in own["distances"].items() if not d["within_3_m"]]
    said = (
        f"All four shares are compatible (Holm's p > {SIGNIFICANT})"
        if not differ
        else "Not compatible: "
        + "; ".join(
            f"{t['condition'].replace('_', ' ')}, {t['share']}: {100 * t['here']['rate']:.3f} %"
            f" against {100 * t['there']['rate']:.3f} %, p = {t['p_holm']:.2g}"
            for t in differ
        )
    )
    ways = "both distances are within" if not far else f"{' and '.join(far)}: not within"
    return f"{said}; {ways} {NEAR_M:.0f} m. There: {own['source']}." + (
        "" if other == "preset" else " The paper does not say its scaling, clipping and goal."
    )


def _footnote_2_blocks(found: Mapping[str, Any], stable: str) -> list[str]:
    falls = found["zero_policy"]
    rows = [
        (
            g["what"],
            str(g["weights"]),
            str(g["simulations"]),
            f"{g['fall_s']:.3f}",
            f"{g['seconds']:.0f}",
        )
        for g in found["gradients"]
    ]
    first = found["first_checkpoint_of_pegasus"]
    if first is None:
        rows.append(("bicycle_pegasus as run, its first checkpoint", "", "missing", "", ""))
    else:
        told = (f"{first['simulations']:.0f}", "", f"{first['seconds']:.0f}")
        rows.append(("bicycle_pegasus as run, its first checkpoint", "", *told))
    header = ("one gradient", "weights", "simulations", "a fall, s", "simulated seconds")
    return [
        f"Untouched, the bicycle falls after {falls['mean_s']:.3f} s (mean of {falls['runs']:,}"
        f" runs, 95 % interval {falls['low_s']:.3f} to {falls['high_s']:.3f}; one run varies by"
        f" {falls['deviation_s']:.2f} s); the paper says 1.74 s.",
        as_markdown(Table("footnote 2", header, tuple(rows))),
        "Essential Dynamics to stable riding: about"
        f" {found['published_essential_dynamics_s']} s published; rerun (bicycle_paper): {stable}.",
    ]


def _cells(material: Material) -> dict[str, Any]:
    """Of every run: what made it, and how long that took."""
    cells: dict[str, Any] = {}
    for row, runs in material.runs.items():
        for run in runs:
            name = row if len(runs) == 1 else f"{row}/{run.path.name}"
            about = {**run.about, **run.summary}
            status = run.path / STATUS
            seconds = json.loads(status.read_text())["seconds"] if status.exists() else None
            cells[name] = {
                "command": about.get("command"),
                "seeds": run.seeds,
                "versions": about.get("versions"),
                "git": about.get("git"),
                "wall_s": seconds,
                "cpu_s": about.get("cpu_s"),
            }
    return cells


def _cells_table(cells: Mapping[str, Any]) -> Table:
    rows = [
        (
            name,
            ranges(cell["seeds"]),
            "" if cell["wall_s"] is None else f"{cell['wall_s'] / 60:.1f}",
            f"`{cell['command']}`",
        )
        for name, cell in cells.items()
    ]
    return Table("Cells", ("cell", "seeds", "min", "command"), tuple(rows))


def write(material: Material, folder: Path, drawn: Sequence[str], *, quick: bool) -> None:
    """``paper.md`` and ``paper.json``."""
    published = yaml.safe_load(PUBLISHED.read_text(encoding="utf-8"))
    torch.set_num_threads(1)
    first = footnote_1(material, published["footnote_1"])
    falls = zero_policy_falls(episodes=10 if quick else 500)
    second = footnote_2(material, published["footnote_2"], falls, weights=10)
    rows = published["rows"]
    learning = learnt(material, rows)
    cells = _cells(material)
    walls = [cell["wall_s"] for cell in cells.values() if cell["wall_s"] is not None]
    stable = estimates(list(material.runs.get(FIGURE_2, ()))).get(TO_STABLE[1].name)
    missing_figures = [name for name in CAPTIONS if name not in drawn]
    for name in missing_figures:  # of a former rerun
        for kind in ("png", "svg"):
            (folder / f"{name}.{kind}").unlink(missing_ok=True)
    numbers = {
        "quick": quick,
        "footnote_1": first,
        "footnote_2": second,
        "methods": methods(material, rows),
        "learning": learning,
        "cells": cells,
        "wall_s": math.fsum(walls),
        "figures": list(drawn),
        "missing": {**material.missing, **{name: "no runs" for name in missing_figures}},
        "bootstrap": {"resamples": samples.RESAMPLES, "seed": samples.SEED},
        "versions": versions(),
        "git": git_commit(),
        "command": " ".join([COMMAND, *map(shlex.quote, sys.argv[1:])]),
    }
    write_text(folder / "paper.json", json_text(numbers))
    blocks = [
        "# The paper, rerun",
        *(["**A quick run: it shows that this works, and its figures mean nothing.**"] * quick),
        *(f"![{CAPTIONS[name]}]({name}.png)\n\n{CAPTIONS[name]}." for name in drawn),
        "## Footnote 1: random policies",
        *_footnote_1_blocks(first),
        "## Footnote 2: what a gradient costs",
        *_footnote_2_blocks(second, "missing" if stable is None else f"{median_cell(stable)} s"),
        "## Methods",
        *blocks_of_methods(material, rows, learning),
        "## Cells",
        as_markdown(_cells_table(cells)),
        _time(walls),
    ]
    if numbers["missing"]:
        lines = [f"* {name}: {why}" for name, why in numbers["missing"].items()]
        blocks += ["## Missing", "\n".join(lines)]
    blocks.append(f"Made by edtorch {versions()['edtorch']}: `{numbers['command']}`")
    write_text(folder / "paper.md", "\n\n".join(blocks) + "\n")


def _time(walls: Sequence[float]) -> str:
    if not walls:
        return "No cell is there."
    total, longest = math.fsum(walls) / 3600, max(walls) / 60
    return f"{len(walls)} runs, {total:.1f} h of wall time in all, the longest {longest:.0f} min."
