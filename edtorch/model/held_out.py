r"""Which model predicts best what it was not fitted to.

The rows are parted into contiguous blocks.  For each block, each candidate is fitted to the others
and rolled from every reading of the block for half a second under the recorded actions.  The error
of such a window is the mean of the squared differences from the readings, over its ticks and over
the components that move, in scaled units, on the circle for angles; that of a candidate is the
geometric mean over the windows, on which a single wild one has little weight.

A simpler candidate, one with fewer weights for each output, is preferred where it is within one
standard error of the best (Breiman et al., "Classification and regression trees", 1984), that of
the mean difference of the logarithms.  Windows overlap: as many count as independent as would fit
without.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from edtorch.errors import FitError
from edtorch.model.evidence import Posterior
from edtorch.model.mechanism import Structure, runge_kutta
from edtorch.model.path_fit import LEAST_ROWS, fit_paths, usable
from edtorch.types import Transition

CONSTANT, CONSTANT_RATES = "constant", "constant rates"
"""What a model has to be better than: a state that stays, and one whose rates stay."""
_LEAST, _MOST = 1e-24, 1e24
"""Squared errors beyond these, and those that are not finite, count as these."""

FitModel = Callable[[Structure, Transition], Posterior]


@dataclass(frozen=True)
class HeldOutScore:
    """error: root of the geometric mean of the squared error, scaled units; behind: mean logarithm
    of its ratio to the best candidate's squared error, and that mean's standard error; terms:
    weights for each output."""

    error: float
    terms: float
    behind: float = 0.0
    standard_error: float = 0.0


@dataclass(frozen=True)
class ModelChoice:
    """The candidate chosen, fitted to all rows.

    scores: by name, of candidates and of ``CONSTANT`` and ``CONSTANT_RATES``; best: the candidate
    with the least error; seconds: of the windows.
    """

    name: str
    structure: Structure
    posterior: Posterior
    scores: Mapping[str, HeldOutScore]
    best: str
    seconds: float

    @property
    def better_than_constant(self) -> bool:
        """Whether the best candidate predicts better than both constants, by more than a standard
        error."""
        constants = (self.scores[name] for name in (CONSTANT, CONSTANT_RATES))
        return all(score.behind > score.standard_error for score in constants)

    @property
    def words(self) -> str:
        """One line for a log."""
        chosen = self.scores[self.name]
        others = ", ".join(
            f"{name} {score.error:.3g}" for name, score in self.scores.items() if name != self.name
        )
        tie = ""
        if self.name != self.best:
            tie = f"; within one standard error of {self.best}, and simpler"
        return (
            f"model={self.name}: error {chosen.error:.3g} over {self.seconds:g} s held out"
            f" ({others}){tie}"
        )


def choose_model(
    candidates: Mapping[str, Structure],
    transition: Transition,
    episode: Tensor,
    *,
    fit: FitModel = fit_paths,
    seconds: float = 0.5,
    blocks: int = 4,
) -> ModelChoice:
    """The best of the ``candidates``, as described above.

    transition: N rows in order of time, scaled units; episode: int64 ``[N]``, the same number for
    rows of one episode; blocks: at most, of ``LEAST_ROWS`` or more.  Windows are shorter than
    ``seconds`` where blocks or episodes are too short for as many windows as blocks.  A candidate
    that cannot be fitted without some block has an infinite error.  Raises FitError for fewer
    valid rows than two blocks have, and if no candidate can be fitted.
    """
    data, episode = usable(transition), _unbroken(transition.valid, episode)
    rows = len(episode)
    if rows < 2 * LEAST_ROWS:
        raise FitError(
            f"transitions: got {rows}, expected at least {2 * LEAST_ROWS} to hold some of them out:"
            " more random exploration"
        )
    blocks = min(blocks, rows // LEAST_ROWS)
    block = torch.arange(rows) * blocks // rows
    ticks = max(1, min(round(seconds / float(data.dt.mean())), rows // blocks))
    while len(starts := _starts(episode, block, ticks)) < blocks:
        ticks -= 1  # of one tick there are as many as rows
    first = next(iter(candidates.values()))
    zero = torch.zeros(first.allowed.shape, dtype=data.state.dtype)
    errors = {
        CONSTANT: _errors(first, lambda s, u, dt: s, data, starts, ticks),
        CONSTANT_RATES: _errors(first, _model(first, zero), data, starts, ticks),
    } | {
        name: _held_out(structure, fit, data, block, starts, ticks)
        for name, structure in candidates.items()
    }
    best = min(candidates, key=lambda name: float(errors[name].mean()))
    scores = {}
    for name, log in errors.items():
        behind = log - errors[best]
        apart = max(1.0, len(starts) / ticks)
        allowed = candidates[name].allowed if name in candidates else zero[:, :0]
        scores[name] = HeldOutScore(
            error=math.exp(float(log.mean()) / 2),
            terms=float(allowed.sum() / len(allowed)),
            behind=float(behind.mean()),
            standard_error=float(behind.std(correction=0)) / math.sqrt(apart),
        )
    # The best itself is among them, whatever rounding does.
    tied = [
        name
        for name in candidates
        if name == best or scores[name].behind <= scores[name].standard_error
    ]
    name = min(tied, key=lambda name: (scores[name].terms, scores[name].behind))
    chosen = candidates[name]
    return ModelChoice(name, chosen, fit(chosen, data), scores, best, ticks * float(data.dt.mean()))


def _unbroken(valid: Tensor, episode: Tensor) -> Tensor:
    """The episodes of the valid rows; where rows are left out, another one begins."""
    return (episode + (episode.max() + 1) * (~valid).cumsum(0))[valid]


def _starts(episode: Tensor, block: Tensor, ticks: int) -> Tensor:
    """The first rows of windows of ``ticks`` rows of one episode and one block."""
    place = torch.stack([episode, block], dim=-1).unfold(0, ticks, 1)
    return (place == place[..., :1]).all(-1).all(-1).nonzero().squeeze(-1)


def _model(structure: Structure, weight: Tensor) -> Callable[[Tensor, Tensor, Tensor], Tensor]:
    return lambda state, action, dt: runge_kutta(structure, weight, state, action, dt)


def _held_out(
    structure: Structure, fit: FitModel, data: Transition, block: Tensor, starts: Tensor, ticks: int
) -> Tensor:
    """Log squared errors ``[W]``, each under the weights fitted without its block."""
    found = torch.full(starts.shape, math.log(_MOST), dtype=data.state.dtype)
    for k in block.unique():
        try:
            weight = fit(structure, replace(data, valid=block != k)).weight
        except FitError:
            continue
        here = block[starts] == k
        found[here] = _errors(structure, _model(structure, weight), data, starts[here], ticks)
    return found


def _errors(
    structure: Structure,
    step: Callable[[Tensor, Tensor, Tensor], Tensor],
    data: Transition,
    starts: Tensor,
    ticks: int,
) -> Tensor:
    """Log mean squared errors ``[W]`` of windows that begin in rows ``starts`` ``[W]``."""
    moving = torch.from_numpy(structure.source >= 0)
    moving[torch.from_numpy(structure.learned)] = True
    state, total = data.state[starts], torch.zeros(starts.shape, dtype=data.state.dtype)
    for k in range(ticks):
        row = starts + k
        state = step(state, data.action[row], data.dt[row])
        error = structure.difference(state, data.next_state[row])[:, moving]
        total = total + error.square().mean(-1) / ticks
    return total.nan_to_num(_MOST).clamp(_LEAST, _MOST).log()
