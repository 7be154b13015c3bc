"""A mechanism model from all transitions so far, as a configuration names its fit."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

from torch import Tensor

from edtorch.model.evidence import Posterior, Updates, ard, ridge
from edtorch.model.held_out import ModelChoice, choose_model
from edtorch.model.mechanism import Structure, runge_kutta
from edtorch.model.path_fit import LEAST_ROWS, fit_paths, usable
from edtorch.model.stop_fit import find_events
from edtorch.model.stops import Stops
from edtorch.types import Transition

PRIORS: Mapping[str, Callable[..., Posterior]] = {"ard": ard, "ridge": ridge}


@dataclass(frozen=True)
class LearnedModel:
    """name: of the structure; reading_noise ``[n]``: standard deviations of the errors of readings,
    scaled, from what is left of the changes in a tick; error: root of the mean square of those, in
    all components; count: transitions used; stops: those that were hit, with their levels, None
    where none is told; notes: for people."""

    name: str
    posterior: Posterior
    reading_noise: Tensor
    error: float
    count: int
    stops: Stops | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class PathFit:
    """``edtorch.model.path_fit.fit_paths`` with ``passes`` regressions; prior: ``ard``, a precision
    for each weight, or ``ridge``, one for all of an output; updates, noise: those of
    ``edtorch.model.evidence.Updates``."""

    passes: int = 4
    prior: Literal["ard", "ridge"] = "ard"
    updates: int = 30
    noise: float = 0.1

    def __post_init__(self) -> None:
        """Refuse impossible settings."""
        for name in ("passes", "updates"):
            if getattr(self, name) < 1:
                raise ValueError(f"{name}={getattr(self, name)}: expected an integer >= 1")
        if not 0 < self.noise <= 1:
            raise ValueError(f"noise={self.noise}: expected a share in (0, 1]")
        if self.prior not in PRIORS:
            raise ValueError(f"prior={self.prior}: expected one of {', '.join(PRIORS)}")

    def learn(
        self,
        structures: Mapping[str, Structure],
        transition: Transition,
        episode: Tensor,
        stops: Stops | None = None,
    ) -> LearnedModel:
        """The posterior of the structure that predicts held-out data best, from rows in order of
        time and the number ``[N]`` of the episode of each.  One structure is fitted to rows that
        are too few to hold some out.  With ``stops`` the ticks in which one is hit are left out
        (``edtorch.model.stop_fit``).

        Errors as of ``edtorch.model.held_out.choose_model``, and of ``find_events``.
        """
        updates = Updates(self.updates, self.noise)
        evidence = partial(PRIORS[self.prior], updates=updates)
        fit = partial(fit_paths, passes=self.passes, evidence=evidence)
        notes: list[str] = []
        if stops is not None:
            richest = list(structures.values())[-1]
            events = find_events(richest, stops, transition, fit)
            stops, transition = events.stops, replace(transition, valid=events.free)
            notes += events.notes
        if len(structures) == 1 and int(transition.valid.sum()) < 2 * LEAST_ROWS:
            ((name, structure),) = structures.items()
            posterior = fit(structure, transition)
        else:
            choice = choose_model(structures, transition, episode, fit=fit)
            name, structure, posterior = choice.name, choice.structure, choice.posterior
            notes += _notes(choice, told=len(structures) > 1)
        left = one_tick_errors(structure, posterior.weight, transition)
        # Of two readings each, so that a difference has twice the variance of an error; the median
        # of |x| is .674 of a normal standard deviation.
        noise = 1.483 * left.abs().median(0).values / 2**0.5
        error = float(left.square().mean().sqrt())
        return LearnedModel(name, posterior, noise, error, len(left), stops, tuple(notes))


def _notes(choice: ModelChoice, *, told: bool) -> list[str]:
    """What to say of a choice; told: also where all is well."""
    if not choice.better_than_constant:
        return [
            f"{choice.words}: no better than a constant; more random exploration may help"
            " (search.random, search.random_trials)"
        ]
    return [choice.words] if told else []


def one_tick_errors(structure: Structure, weight: Tensor, transition: Transition) -> Tensor:
    """Readings less predictions from the readings a tick before, ``[N, n]``, of valid rows; finite
    ones only."""
    data = usable(transition)
    predicted = runge_kutta(structure, weight, data.state, data.action, data.dt)
    left = structure.difference(data.next_state, predicted)
    return left[left.isfinite().all(-1)]
