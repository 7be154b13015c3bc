"""A hybrid model from transitions: free motion, and what strikes do.

Free motion is fitted to the ticks without an event alone, and the strikes with its inertia.  Stops
need no data: their forces and impulses act like actions (``edtorch.model.stops``).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from edtorch.errors import FitError
from edtorch.model.event_free import free_ticks
from edtorch.model.evidence import Posterior
from edtorch.model.impact import fit_impact, no_jump
from edtorch.model.mechanism import Structure
from edtorch.model.path_fit import fit_paths
from edtorch.model.stops import Stops
from edtorch.model.strike import Strike
from edtorch.model.terms import Terms
from edtorch.model.ties import Ties
from edtorch.search.kinks import kinks_of
from edtorch.search.striking import StrikingModel
from edtorch.search.tick_model import TickModel
from edtorch.types import Transition

LEAST_FREE = 30
"""Ticks of free motion, at least."""


@dataclass(frozen=True, eq=False)
class LearnedHybrid:
    """posterior: of the weights of free motion, whose mean ``model`` has; free, strikes: ticks that
    were used for each."""

    model: StrikingModel
    posterior: Posterior
    free: int
    strikes: int


def learn_hybrid(
    model: TickModel,
    strike: Strike,
    features: tuple[Terms, Ties] | None,
    transition: Transition,
    noise: Tensor,
    *,
    fit: Callable[[Structure, Transition], Posterior] = fit_paths,
) -> LearnedHybrid:
    """``model``, whose weights are not used, with weights from ``transition``; ``strike`` with the
    height learned if it is nan.

    features: of the jump of the rates, such as ``edtorch.model.chain.impact_terms``, None where
    they do not jump; transition:
    ``[N]`` rows, scaled, of one dt; noise ``[n]``: standard deviations of readings, scaled.  Raises
    FitError where too few ticks are free of events or strikes.
    """
    struck = strike.happened(transition.state, transition.next_state) & transition.valid
    if 2 * int(struck.sum()) > int(transition.valid.sum()):
        raise FitError(
            f"told.strike.counter: it changes in {int(struck.sum())} of"
            f" {int(transition.valid.sum())} ticks; expected a component that counts strikes"
        )
    stops = model.stops or Stops.none(len(model.structure.source))
    free = free_ticks(transition, stops, strike, noise)
    count = int(free.sum())
    if count < LEAST_FREE:
        raise FitError(
            f"transitions: {count} of {int(transition.valid.sum())} are clear of stops and strikes,"
            f" expected {LEAST_FREE} or more; let more be tried first"
        )
    posterior = fit(model.structure, replace(transition, valid=free))
    known = replace(model, weight=posterior.weight.numpy())
    kinks = kinks_of(known, strike, transition, noise)
    if np.isnan(strike.height).any():
        # Places are changed back by changing them again.
        strike = strike.with_height(model.structure, strike.relabelled(kinks.before))
    columns = torch.from_numpy(stops.column)
    if features is None:
        impact = no_jump(model.structure, posterior.weight)
    else:
        impact = fit_impact(model.structure, posterior.weight, kinks, columns, *features)
    return LearnedHybrid(StrikingModel(known, strike, impact), posterior, count, len(kinks.before))
