"""Beliefs across a guard: what each transform makes of a rod that hits a stop and of a ball that
bounces, beside particles.

The rod is that of ``sims.tasks.stop_pendulum``, without torque; the ball keeps 0.7 of its speed.
A tick is 0.05 s, and only the start is random.  Makes a table of docs/contact.md, and JSON:

    python -m studies.crossing [--json FILE] [--docs docs/contact.md]
"""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from benchmarks.timing import write_json
from edtorch.derivatives import StateFunction, loop_jacobian, rowwise_jacobian
from edtorch.flow import flow
from edtorch.transform import ConstantNoise, Cubature, FirstOrder, MonteCarlo, Transform
from edtorch.transform.guarded import Event, Guarded, crossing_probability
from edtorch.types import Belief
from studies.bounds import insert
from tests.guards import ball, rod

SAMPLES, SEED = 50_000, 1000
MARK = "<!-- crossing table -->"
SECONDS = 0.05
METHODS = ("saltation", "no saltation", "cubature", "draws")
"""First order with and without the saltation matrix; 2n points; 2,000 points."""


@dataclass(frozen=True)
class Case:
    """An event, mean and standard deviations ``[n]`` of the start, and the ticks that are looked
    at: the last one is well after the guard."""

    event: Event
    mean: tuple[float, ...]
    deviation: tuple[float, ...]
    ticks: int

    @property
    def start(self) -> Belief:
        """The belief at first."""
        deviation = torch.tensor(self.deviation, dtype=torch.float64)
        return Belief(torch.tensor(self.mean, dtype=torch.float64), torch.diag(deviation.square()))


CASES = {
    "rod": Case(rod(), (-0.1, -1.5, 0.0), (0.02, 0.1, 0.0), 9),
    "ball": Case(ball(0.7), (0.8, 0.0), (0.02, 0.05), 14),
}


@dataclass(frozen=True)
class Unsalted:
    """A tick with a derivative that takes the time of the event for a constant."""

    tick: Guarded

    def __call__(self, state: Tensor) -> Tensor:
        """As the tick."""
        return self.tick(state)

    def jacobian(self, state: Tensor) -> Tensor:
        """Phi_+ Dg Phi_-."""
        event, until = self.tick.event, self.tick.until(state).detach()

        def moved(s: Tensor) -> Tensor:
            reached = flow(event.before, s, until)
            after = flow(event.after, event.reset(reached), SECONDS - until)
            return torch.where(self.tick.crosses(state).unsqueeze(-1), after, reached)

        return rowwise_jacobian(moved, state)


def methods(tick: Guarded, states: int) -> Mapping[str, tuple[Transform, StateFunction]]:
    """Transform and closed loop by the names of ``METHODS``."""
    draws = MonteCarlo(2000, states, torch.Generator().manual_seed(SEED))
    first, points = FirstOrder(), Cubature()
    every = ((first, tick), (first, Unsalted(tick)), (points, tick), (draws, tick))
    return dict(zip(METHODS, every, strict=True))


def course(case: Case, transform: Transform, loop: StateFunction, mean: Tensor) -> list[Belief]:
    """Beliefs after each tick."""
    belief, found = Belief(mean, case.start.cov), list[Belief]()
    for _ in range(case.ticks):
        belief = transform.move(belief, loop, ConstantNoise(torch.zeros_like(belief.cov)))
        found.append(belief)
    return found


def cloud(case: Case, tick: Guarded, mean: Tensor) -> tuple[list[Belief], list[float]]:
    """The moments of particles after each tick, and which part of them the tick took across."""
    start = case.start
    draws = torch.randn(
        SAMPLES, len(mean), generator=torch.Generator().manual_seed(SEED), dtype=torch.float64
    )
    state, found, crossing = mean + draws * start.cov.diag().sqrt(), list[Belief](), list[float]()
    for _ in range(case.ticks):
        crossing.append(tick.crosses(state).double().mean().item())
        state = tick(state)
        found.append(Belief(state.mean(0), torch.cov(state.mT)))
    return found, crossing


def central(function: Callable[[Tensor], Tensor], mean: Tensor, step: float = 1e-2) -> Tensor:
    """Derivative ``[n, 2]`` by central differences, of position and rate."""
    moves = step * torch.eye(len(mean), dtype=torch.float64)[:2]
    each = [(function(mean + move) - function(mean - move)) / (2 * step) for move in moves]
    return torch.stack(each, dim=-1)


def deviations(beliefs: list[Belief], component: int) -> list[float]:
    """Standard deviations of a component after each tick."""
    return [belief.cov[component, component].sqrt().item() for belief in beliefs]


def costs(beliefs: list[Belief], event: Event) -> Tensor:
    """E[distance^2 + .1 rate^2] after each tick, distance from the guard."""
    means = [event.guard(b.mean).square() + 0.1 * b.mean[1].square() for b in beliefs]
    spread = [b.cov[0, 0] + 0.1 * b.cov[1, 1] for b in beliefs]
    return torch.stack(means) + torch.stack(spread)


def slope_of(case: Case, transform: Transform, loop: StateFunction) -> Tensor:
    """How the last mean depends on the first one, ``[n, 2]``: what gains are made of."""
    mean = case.start.mean
    if getattr(transform, "at_mean", False):
        places = [mean, *(belief.mean for belief in course(case, transform, loop, mean)[:-1])]
        chain = torch.eye(len(mean), dtype=torch.float64)
        for place in places:
            chain = loop_jacobian(loop, place) @ chain
        return chain[:, :2]
    return rowwise_jacobian(lambda m: course(case, transform, loop, m)[-1].mean, mean)[:, :2]


def across(case: Case, belief: Belief, transform: Transform) -> float:
    """The probability that a tick from this belief crosses the guard."""
    still = ConstantNoise(torch.zeros_like(belief.cov))
    free = transform.move(belief, lambda s: flow(case.event.before, s, SECONDS), still)
    return crossing_probability(free, case.event).item()


def tried(case: Case) -> dict[str, dict[str, Any]]:
    """Figures by method, those of ``particles`` among them."""
    tick, mean = Guarded(case.event, SECONDS), case.start.mean
    true, crossing = cloud(case, tick, mean)
    slope = central(lambda m: cloud(case, tick, m)[0][-1].mean, mean)
    found = {"particles": figures(case, true, crossing, slope)}
    for name, (transform, loop) in methods(tick, len(mean)).items():
        beliefs = course(case, transform, loop, mean)
        crosses = [across(case, b, transform) for b in [case.start, *beliefs[:-1]]]
        found[name] = figures(case, beliefs, crosses, slope_of(case, transform, loop))
    return found


def figures(
    case: Case, beliefs: list[Belief], crossing: list[float], slope: Tensor
) -> dict[str, Any]:
    """What is written for a method: lists over ticks, and the slope."""
    return {
        "crossing": crossing,
        "position": deviations(beliefs, 0),
        "rate": deviations(beliefs, 1),
        "cost": costs(beliefs, case.event).tolist(),
        "slope": slope.tolist(),
    }


def table(name: str, found: Mapping[str, Mapping[str, Any]]) -> list[str]:
    """Rows of a case: the tick at which the most particles have not all crossed, and the last."""
    true = found["particles"]
    event = max(range(len(true["rate"])), key=true["rate"].__getitem__)
    lines = list[str]()
    for method, own in found.items():
        cost = [sum(each["cost"][event:]) for each in (own, true)]
        far = (torch.tensor(own["slope"]) - torch.tensor(true["slope"])).norm().item()
        cells = (
            name,
            method,
            f"{own['crossing'][event]:.2f}",
            f"{own['rate'][event]:.2f}",
            f"{own['rate'][-1]:.3f}",
            f"{own['position'][-1]:.4f}",
            f"{own['cost'][event] / true['cost'][event] - 1:+.1%}",
            f"{cost[0] / cost[1] - 1:+.1%}",
            f"{far:.3f}",
        )
        lines.append(f"| {' | '.join(cells)} |")
    return lines


COLUMNS = (
    *("case", "belief by", "crosses in the tick of the event", "deviation of the rate there"),
    *("of the rate at last", "of the position at last", "error of the cost there"),
    *("and from there on", "error of the slope"),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("--json", type=Path)
    parser.add_argument("--docs", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    found = {name: tried(case) for name, case in CASES.items()}
    write_json(options.json, {"samples": SAMPLES, "seed": SEED, **found})
    rows = [line for name, own in found.items() for line in table(name, own)]
    head = [f"| {' | '.join(COLUMNS)} |", f"|{' --- |' * len(COLUMNS)}"]
    text = "\n".join((*head, *rows))
    print(text)
    if options.docs is not None:
        insert(options.docs, MARK, text)


if __name__ == "__main__":
    main()
