"""When an episode is a success.

The sim decides first, by ``Outcome.SUCCEEDED`` or ``sims.base.Judged``.  Where it does not, a
return of at least ``SuccessRule.least_return`` is a success.  Where no such return is known either,
an episode that reached the time limit without a failure is a success if the domain can fail.  A
success is never also a failure.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Tensor

from edtorch.run.episodes import Episode
from sims.base import Judged, Outcome, Sim, Spec

OPEN = -1
"""Whether the episode was a success depends on the other episodes of the run."""


@dataclass(frozen=True)
class SuccessRule:
    """least_return, survival: as ``success_return`` and ``survival`` of ``sims.base.Spec``."""

    least_return: float | None = None
    survival: bool | None = None

    @classmethod
    def of(cls, spec: Spec, least_return: float | None = None) -> SuccessRule:
        """That of a domain; least_return: instead of the domain's, None keeps that."""
        if least_return is None:
            least_return = spec.success_return
        return cls(least_return, spec.survival if least_return is None else False)

    def outcome(self, sim: Sim, state: Tensor, outcome: Tensor, earned: Tensor | None) -> Tensor:
        """``outcome`` ``[B]`` with SUCCEEDED for each ended episode that this rule, or the sim,
        takes for a success; state ``[B, k]``: the last one; earned ``[B]``: the return, None where
        there is none."""
        ended = outcome != int(Outcome.RUNNING)
        silent = ended
        if isinstance(sim, Judged):
            said = sim.succeeded(state)
            silent = ended & (said == OPEN)
            outcome = torch.where(ended & (said == 1), int(Outcome.SUCCEEDED), outcome)
        if self.least_return is not None and earned is not None:
            good = silent & (earned >= self.least_return)
            outcome = torch.where(good, int(Outcome.SUCCEEDED), outcome)
        return outcome

    def success(self, sim: Sim, state: Tensor, outcome: Tensor) -> Tensor:
        """Int64 ``[B]``: 1 for episodes that ended as a success, by ``outcome`` ``[B]`` from above,
        0 for others, ``OPEN``."""
        late = {True: 1, False: 0, None: OPEN}[self.survival]
        found = torch.where(
            outcome == int(Outcome.TIMED_OUT), late, (outcome == int(Outcome.SUCCEEDED)).long()
        )
        if isinstance(sim, Judged):
            found = torch.where((found == OPEN) & (sim.succeeded(state) == 0), 0, found)
        return found


def as_success(found: int) -> bool | None:
    """A number of ``SuccessRule.success`` as ``Episode.success``."""
    return None if found == OPEN else bool(found)


def settled(episodes: Sequence[Episode], among: Sequence[Episode]) -> list[Episode]:
    """``episodes`` with what was open decided; among: all episodes of the run.

    A time-out is no success where one of those reached a goal; otherwise it is one where one of
    them failed.
    """
    own = any(e.outcome is Outcome.SUCCEEDED for e in among)
    if not (own or any(e.outcome is Outcome.FAILED for e in among)):
        return list(episodes)
    return [replace(e, success=not own) if e.success is None else e for e in episodes]


def all_settled(
    found: Sequence[Sequence[Episode]], among: Sequence[Episode] = ()
) -> list[list[Episode]]:
    """``settled`` for the episodes of each policy; among: further episodes of the run."""
    everything = [*among, *(e for own in found for e in own)]
    return [settled(own, everything) for own in found]
