"""Stops and strikes: does one smooth model predict a walker, or does a hybrid one?

Table ``prediction``: the walker of ``sims.tasks.walker`` is moved by random gaits with noise of 20
N m on the torques, readings err by 0.001 rad and 0.005 rad/s.  Models are fitted to 40 episodes of
1.2 s at most and compared on 20 others, from true states: one tick by kind of tick, and half a
second with a strike in it.

- hybrid: the planar chain, fitted to ticks of free motion; stops; strike map
  (``edtorch.search.hybrid_fit``).  Told: which components are angles of links in space, the knees'
  stops, the height of the foot, which components change places at a strike.
- chain on all ticks: the same terms, fitted to all ticks, without stops and map.
- implicit, products: ``edtorch.model.terms`` of degree 1, on all ticks.

To the last three the strikes are told, and labels changed back for their fit: a strike is a jump of
the rates for them, no other legs.

    python -m studies.contact prediction --keep runs/reference/contact
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
import torch
from matplotlib.figure import Figure
from torch import Tensor

from edtorch.app.rundir import versions
from edtorch.model.chain import impact_terms
from edtorch.model.families import ChainModel, ImplicitModel, ProductModel
from edtorch.model.mechanism import Structure, runge_kutta
from edtorch.model.path_fit import fit_paths
from edtorch.model.stops import Stops
from edtorch.model.strike import Strike
from edtorch.model.told import Told
from edtorch.policy.phase import PhaseGait, PhasePolicy
from edtorch.policy.squash import Squash
from edtorch.report.canvas import HUES, WIDE, blank, styled
from edtorch.search.hybrid_fit import learn_hybrid
from edtorch.search.striking import StrikingModel, struck_states
from edtorch.search.tick_model import TickModel
from edtorch.types import Transition
from sims.base import Outcome
from sims.tasks.walker import Walker

FITTED, TESTED, TICKS = 40, 20, 120
"""Episodes of each, and ticks of an episode at most."""
WINDOW, EVERY = 50, 10
"""Ticks of a prediction with events, and between the starts of two."""
FAR = 5e-3
"""rad: a knee this far from its stop at both ends of a tick did not hit it."""
LEGS = ("stance", "swing")
KINDS = ("free", "knee hit", "locked", "strike")
Step = Callable[[Tensor, Tensor], Tensor]

SIM = Walker()
TOLD = Told.of(SIM.spec, ignored=("steps", "force_x", "force_y"))
UNIT = torch.tensor([q.scale for q in SIM.spec.state]).double()
HIGH = torch.tensor([q.high for q in SIM.spec.action]).double()
NOISE = torch.tensor([1e-3, 5e-3] * 5 + [0.0] * 3).double() / UNIT
GAIT = PhaseGait(
    phase={"stance_shank": 0.5, "stance_thigh": 0.5},
    start=-0.2,
    width=0.45,
    spread=0.0,
    joints={
        "stance_knee": dict(
            of={"stance_shank": 1.0, "stance_thigh": -1.0},
            drives={"stance_knee": 1.0},
            stiffness=12.0,
            damping=0.8,
            points=(0.08, 0.09, 0.07, 0.07),
            spread=0.03,
        ),
        "torso": dict(
            of={"torso": 1.0},
            drives={"stance_hip": -1.0},
            stiffness=2.7,
            damping=0.27,
            points=(0.19,),
            spread=0.1,
        ),
        "swing_thigh": dict(
            of={"swing_thigh": 1.0},
            drives={"swing_hip": 1.0},
            stiffness=2.0,
            damping=0.1,
            points=(0.0, -0.46, -0.27, -0.33),
            spread=0.1,
        ),
        "swing_knee": dict(
            of={"swing_shank": 1.0, "swing_thigh": -1.0},
            drives={"swing_knee": 1.0},
            stiffness=4.0,
            damping=0.32,
            points=(0.5, 0.54, 0.39, 0.15),
            spread=0.15,
        ),
    },
)


@dataclass(frozen=True)
class Walks:
    """Episodes, ticks first: true states ``[T + 1, E, 17]``, readings ``[T + 1, E, 13]`` scaled,
    actions ``[T, E, 4]`` scaled, moved: bool ``[T, E]``, the ticks without a fall."""

    true: Tensor
    read: Tensor
    action: Tensor
    moved: Tensor

    def of(self, episodes: slice) -> Walks:
        """Some of them."""
        return Walks(*(p[:, episodes] for p in (self.true, self.read, self.action, self.moved)))

    @property
    def seen(self) -> Tensor:
        """True states as they would be read, ``[T + 1, E, 13]``, scaled."""
        return SIM.observe(self.true) / UNIT


def main() -> None:
    """Make the table."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("table", choices=("prediction",))
    parser.add_argument("--seeds", type=int, nargs="+", default=list(range(1000, 1005)))
    parser.add_argument("--keep", type=Path, help="folder for results")
    parser.add_argument("--figure", type=Path, help="a picture of the table")
    options = parser.parse_args()
    walks, each = walked(options.seeds), FITTED + TESTED
    results = []
    for k, seed in enumerate(options.seeds):
        own = walks.of(slice(k * each, (k + 1) * each))
        results.append(
            {"seed": seed, **predicted(own.of(slice(FITTED)), own.of(slice(FITTED, each)))}
        )
        print(json.dumps(results[-1]), flush=True)
    content = {
        "command": " ".join(["python -m studies.contact", *sys.argv[1:]]),
        "versions": versions(),
        "results": results,
    }
    print(table(results))
    if options.keep:
        options.keep.mkdir(parents=True, exist_ok=True)
        text = json.dumps(content, indent=1) + "\n"
        (options.keep / "prediction.json").write_text(text, encoding="utf-8")
    if options.figure:
        picture(results).savefig(options.figure, dpi=110)


def walked(seeds: Sequence[int]) -> Walks:
    """``FITTED + TESTED`` episodes of each seed, one seed after the other."""
    squash = Squash(torch.zeros(4).double(), torch.ones(4).double())
    policy = PhasePolicy(GAIT, TOLD.names, TOLD.unit, TOLD.rate, TOLD.actions, squash)
    count = FITTED + TESTED
    drawn = [np.random.default_rng(seed) for seed in seeds]
    parameters = [policy.random(count, 1.0, generator) for generator in drawn]
    theta = {name: torch.cat([p[name] for p in parameters]) for name in parameters[0]}

    def numbers(*shape: int, normal: bool = True) -> Tensor:
        rows = [(g.standard_normal if normal else g.random)((count, *shape)) for g in drawn]
        return torch.from_numpy(np.concatenate(rows))

    state = SIM.initial(numbers(10, normal=False))
    none = torch.zeros(len(state), 0).double()
    true, read, actions, moved = [state], [], [], []
    for _ in range(TICKS):
        read.append(SIM.observe(state) / UNIT + NOISE * numbers(13))
        action = policy.action(theta, read[-1]) + 20.0 * numbers(4) / HIGH
        actions.append(action.clamp(-1, 1))
        runs = SIM.outcome(state) == int(Outcome.RUNNING)
        state = SIM.step(state, actions[-1] * HIGH, none)
        true.append(state)
        moved.append(runs & (state[:, 12] < 0.5))
    read.append(SIM.observe(state) / UNIT + NOISE * numbers(13))
    return Walks(*(torch.stack(parts) for parts in (true, read, actions, moved)))


def predicted(fitted: Walks, tested: Walks) -> Mapping[str, object]:
    """Errors of each model, and how many ticks they are of."""
    chain = ChainModel().structures(TOLD)["chain"]
    strike = Strike.of(
        TOLD,
        chain.lift,
        height={f"{leg}_{link}": sign * 0.4 for leg, sign in zip(LEGS, (1, -1), strict=True)
                for link in ("shank", "thigh")},
        swap={f"stance_{part}": f"swing_{part}" for part in ("shank", "thigh", "knee", "hip")},
        counter="steps",
    )  # fmt: skip
    data = Transition(
        fitted.read[:-1].flatten(0, 1),
        fitted.action.flatten(0, 1),
        fitted.read[1:].flatten(0, 1),
        torch.tensor(SIM.spec.dt).double(),
        fitted.moved.flatten(),
    )
    models = hybrids(chain, strike, data) | smooth(strike, data)
    kinds = kinds_of(tested)
    start, end = tested.seen[:-1], tested.seen[1:]
    struck = strike.happened(start, end)
    one_tick: dict[str, dict[str, float]] = {}
    later: dict[str, float] = {}
    rates = UNIT[1] * torch.eye(13).double()[1:10:2]
    for name, (step, relabels) in models.items():
        after = step(start, tested.action)
        if not relabels:
            after = torch.where(struck.unsqueeze(-1), strike.relabelled(after), after)
        wrong = (after - end) @ rates.mT
        one_tick[name] = {
            kind: float(wrong[rows].square().mean().sqrt()) for kind, rows in kinds.items()
        }
        later[name] = later_error(tested, step, None if relabels else strike, struck)
    counts = {kind: int(rows.sum()) for kind, rows in kinds.items()}
    return {"ticks": counts, "one_tick": one_tick, "half_second": later}


def hybrids(structure: Structure, strike: Strike, data: Transition) -> dict[str, tuple[Step, bool]]:
    """The hybrid model, and it with the height of the foot learned; True: it relabels itself."""
    told = {
        f"{leg}_knee": {
            "of": {f"{leg}_shank": 1.0, f"{leg}_thigh": -1.0},
            "column": f"{leg}_knee",
            "at": 0.0,
        }
        for leg in LEGS
    }
    none = np.zeros((len(structure.learned), structure.terms.count))
    bounds = np.zeros(4), np.ones(4)
    model = TickModel(structure, none, SIM.spec.dt, *bounds, 1, Stops.of(TOLD, told))
    unknown = replace(strike, height=np.nan * strike.height)
    found = {}
    for name, own in (("hybrid", strike), ("hybrid, height learned", unknown)):
        learned = learn_hybrid(
            model,
            own,
            impact_terms(TOLD, structure.lift),
            data,
            NOISE,
            fit=partial(fit_paths, passes=2),
        )

        def step(state: Tensor, action: Tensor, learned: StrikingModel = learned.model) -> Tensor:
            flat = state.flatten(0, -2).numpy(), action.flatten(0, -2).unsqueeze(1).numpy()
            after = torch.from_numpy(struck_states(learned, *flat))[:, 1]
            return after.view(state.shape)

        found[name] = (step, True)
    return found


def smooth(strike: Strike, data: Transition) -> dict[str, tuple[Step, bool]]:
    """Models without events, of all ticks, those with strikes with the labels from before."""
    struck = strike.happened(data.state, data.next_state).unsqueeze(-1)
    same = torch.where(struck, strike.relabelled(data.next_state), data.next_state)
    families = {
        "chain on all ticks": ChainModel().structures(TOLD)["chain"],
        "implicit": ImplicitModel(1).structures(TOLD)["implicit"],
        "products": ProductModel(1).structures(TOLD)["products"],
    }
    found = {}
    for name, structure in families.items():
        weight = fit_paths(structure, replace(data, next_state=same), passes=1).weight
        step = partial(_ticked, structure, weight)
        found[name] = (step, False)
    return found


def _ticked(structure: Structure, weight: Tensor, state: Tensor, action: Tensor) -> Tensor:
    return runge_kutta(structure, weight, state, action, SIM.spec.dt)


def kinds_of(walks: Walks) -> dict[str, Tensor]:
    """Ticks ``[T, E]`` of each of ``KINDS``."""
    gaps = torch.stack(
        [walks.true[..., 2 * a] - walks.true[..., 2 * b] for a, b in ((0, 1), (4, 3))], dim=-1
    )
    shut = gaps.abs() < 1e-9
    strikes = walks.true[1:, :, 11] != walks.true[:-1, :, 11]
    hit = (~shut[:-1] & shut[1:]).any(-1)
    far = ((gaps[:-1] > FAR) & (gaps[1:] > FAR)).all(-1)
    still = (shut[:-1] & shut[1:]).any(-1)
    rest = walks.moved & ~strikes
    masks = (rest & far, rest & hit, rest & still & ~hit, walks.moved & strikes)
    return dict(zip(KINDS, masks, strict=True))


def later_error(walks: Walks, step: Step, strike: Strike | None, struck: Tensor) -> float:
    """Median over windows with a strike of the error of the angles after ``WINDOW`` ticks: rms of
    five, rad.  strike: for models without it, labels change when they did."""
    seen, found = walks.seen, []
    for first in range(0, TICKS - WINDOW, EVERY):
        rows = walks.moved[first : first + WINDOW].all(0)
        rows = rows & struck[first : first + WINDOW].any(0)
        if not bool(rows.any()):
            continue
        state = seen[first, rows]
        for t in range(first, first + WINDOW):
            state = step(state, walks.action[t, rows])
            if strike is not None:
                now = struck[t, rows].unsqueeze(-1)
                state = torch.where(now, strike.relabelled(state), state)
        wrong = (state - seen[first + WINDOW, rows])[:, 0:10:2]
        found.append(wrong.square().mean(-1).sqrt().nan_to_num(torch.inf))
    return float(torch.cat(found).median())


def table(results: Sequence[Mapping[str, Any]]) -> str:
    """Medians over the seeds, as rows of Markdown."""
    lines = [f"| model | {' | '.join(KINDS)} | .5 s, rad |", "|---" * (len(KINDS) + 2) + "|"]
    for name in _names(results):
        cells = [np.median(_values(results, name, kind)) for kind in KINDS]
        cells.append(np.median([r["half_second"][name] for r in results]))
        lines.append(f"| {name} | {' | '.join(f'{cell:.2g}' for cell in cells)} |")
    return "\n".join(lines)


def _names(results: Sequence[Mapping[str, Any]]) -> list[str]:
    return list(results[0]["one_tick"])


def _values(results: Sequence[Mapping[str, Any]], name: str, kind: str) -> list[float]:
    return [r["one_tick"][name][kind] for r in results]


def picture(results: Sequence[Mapping[str, Any]]) -> Figure:
    """One-tick errors of the rates by kind of tick; a dot is a seed, none above 1000."""
    with styled(WIDE):
        figure = blank(WIDE, 3.6)
        axes, names = figure.subplots(), _names(results)
        for k, name in enumerate(names):
            for at, kind in enumerate(KINDS):
                values = _values(results, name, kind)
                x = at + 0.8 * ((k + 0.5) / len(names) - 0.5)
                label = name if at == 0 else None
                color = HUES[k % len(HUES)]
                axes.plot([x] * len(values), values, "o", ms=4, color=color, alpha=0.6, label=label)
                axes.plot(x, np.median(values), "_", ms=14, color=color)
        axes.set_yscale("log")
        axes.set_xticks(range(len(KINDS)), KINDS)
        axes.set_ylabel("error of the rates after a tick, rad/s (rms)")
        axes.legend(frameon=False, ncols=3, loc="upper left")
        # A model that explodes is above.
        axes.set_ylim(5e-4, 1e3)
    return figure


if __name__ == "__main__":
    main()
