"""The protocol that every simulator follows, and the types that describe a simulator.

A sim is a set of functions of tensors with any leading batch dimensions.  It draws no random
numbers: its caller passes uniform numbers in [0, 1), so that the same numbers give the same
episode in any batch.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import TYPE_CHECKING, Literal, Protocol, runtime_checkable

import numpy as np
from torch import Tensor

if TYPE_CHECKING:
    from sims.kinematics import Chain


class SimulatorFailed(RuntimeError):
    """A simulator of somebody else's cannot go on; one line that says which one and why."""


class Outcome(IntEnum):
    """How an episode stands."""

    RUNNING = 0
    FAILED = 1
    """The bicycle fell, the arm hit itself..."""
    SUCCEEDED = 2
    """The goal was reached; a sim whose goal is to be held decides so at the time limit."""
    TIMED_OUT = 3
    """The time limit came first."""


@dataclass(frozen=True)
class Quantity:
    """One component of the observed state or of the action.

    ``scale`` divides it on its way to a learner, which sees numbers of order one; ``period`` is
    that of an angle that wraps (2 pi), 0 for anything else; ``low`` and ``high`` bound it (an
    action is clipped to them where ``Spec.clip_action`` says so); ``middle``: of the range of an
    angle, which wraps half a period from it; an episode fails where a
    component of the state is farther than ``limit`` from zero.  All in ``unit``.  ``rate_of``
    names the component whose time derivative this one is, if one is.
    """

    name: str
    unit: str
    scale: float = 1.0
    low: float = float("-inf")
    high: float = float("inf")
    period: float = 0.0
    rate_of: str = ""
    limit: float = float("inf")
    middle: float = 0.0


@dataclass(frozen=True)
class Measure:
    """A figure of finished episodes that a sim gives (``Sim.measures``).

    name: its key there, with the unit as suffix; label: words for tables and axes; unit: "" for a
    pure number; better: which direction is.  successes: whether it describes only episodes that
    end ``SUCCEEDED`` (a time to the goal); reports give the median of those, and of any other
    measure the mean over all episodes.  median: key of the median beside that mean; pooled: key
    of median, 95th percentile and greatest over the episodes of all seeds; "" for none.
    """

    name: str
    label: str
    unit: str = ""
    better: Literal["lower", "higher", "neither"] = "neither"
    successes: bool = False
    median: str = ""
    pooled: str = ""

    @property
    def with_unit(self) -> str:
        """The label, with its unit where it has one."""
        return f"{self.label}, {self.unit}" if self.unit else self.label


@dataclass(frozen=True)
class Words:
    """What a failure and a success of a domain are called, one and many, and the past tense of the
    verbs: "fell", "rode".  Lower case; they are also part of keys."""

    failure: str = "failure"
    failures: str = "failures"
    success: str = "success"
    successes: str = "successes"
    failed: str = "failed"
    succeeded: str = "succeeded"


DEFAULT_WORDS = Words()


@dataclass(frozen=True)
class Spec:
    """The facts of a domain.

    ``state``: the components of the observation, in order; ``action``: those of the action;
    ``dt``: seconds per step; ``time_limit``: seconds after which an episode ends;
    ``disturbance_dim`` and ``reset_dim``: how many uniform numbers a step and a restart consume;
    ``clip_action``: whether actions are clipped to their bounds before they act;
    ``headline``: name of the state component that a figure of one episode should show.

    A family of tasks has a goal among its state components, constant during an episode: ``goal``
    names them, and ``tracked``, of the same length, the components that they are wanted values of.
    ``measures``: the figures of an episode that reports show; ``words``: what its ends are called.
    ``shortest``: name of the measure that is the least time in which an episode can succeed, s, ""
    where the sim knows none.

    What makes an episode a success, beside ``Outcome.SUCCEEDED`` (``edtorch.run.success``):
    ``success_return``: a return of at least this much; ``survival``: whether reaching the time
    limit without a failure is one, None: it is if some episode of the run has failed.
    ``can_fail``: whether an episode can fail at all, so that none that did is worth telling; with
    ``survival`` it can; None: told only where one has.
    """

    name: str
    state: tuple[Quantity, ...]
    action: tuple[Quantity, ...]
    dt: float
    time_limit: float
    disturbance_dim: int
    reset_dim: int
    clip_action: bool
    headline: str
    goal: tuple[str, ...] = ()
    tracked: tuple[str, ...] = ()
    measures: tuple[Measure, ...] = ()
    words: Words = DEFAULT_WORDS
    survival: bool | None = None
    can_fail: bool | None = None
    shortest: str = ""
    success_return: float | None = None


def are_names(names: Sequence[object]) -> bool:
    """Whether these can name components: different texts that are not empty, without dots, which
    part the levels of keys such as ``reward.state.NAME``."""
    texts = all(isinstance(name, str) and name and "." not in name for name in names)
    return texts and len(set(names)) == len(names)


def spec_index(spec: Spec, names: Iterable[str]) -> list[int]:
    """Where in the observation the components called ``names`` are, in the order of ``names``.

    So that weights published for another order of features are applied by name:
    ``observation[..., spec_index(spec, names)]`` has the components in the order of ``names``.
    """
    known = [quantity.name for quantity in spec.state]
    chosen = list(names)
    for name in chosen:
        if name not in known:
            raise ValueError(
                f"names={name!r}: no state component of {spec.name}; expected one of"
                f" {', '.join(known)}"
            )
    return [known.index(name) for name in chosen]


def expect_action(state: Tensor, action: Tensor, size: int) -> None:
    """ValueError unless ``action`` is ``[*batch, size]`` for states ``[*batch, k]``: another shape
    may broadcast, and then moves every row alike."""
    if action.shape != (*state.shape[:-1], size):
        raise ValueError(
            f"action: has shape {tuple(action.shape)}, expected {(*state.shape[:-1], size)} for"
            f" states of shape {tuple(state.shape)}"
        )


class Sim(Protocol):
    """A world to learn in.

    ``state`` below is the sim's own full state, ``[*batch, k]``; what a learner sees of it is
    ``observe(state)``, ``[*batch, n]``.  A sim that wraps a world with a memory of its own (a
    physics engine) may treat the tensor as a view of it; it then accepts only the state that it
    returned last (and see ``Remembering``).

    A sim whose functions are of tensors alone (no conversions to numbers, no branches on them, no
    libraries) may say so by an attribute ``traceable = True``: rivals may then differentiate its
    steps, and step any rows together.  ``sims.rows`` is the way to compiled ticks.
    ``sims.rows.RowSim`` makes these functions from ones of single components.
    """

    @property
    def spec(self) -> Spec:
        """The facts of the domain."""
        ...

    def initial(self, uniforms: Tensor) -> Tensor:
        """Start states ``[*batch, k]`` of episodes, from uniforms ``[*batch, reset_dim]``."""
        ...

    def restart(self, state: Tensor, mask: Tensor, uniforms: Tensor) -> Tensor:
        """``state`` with a new start where ``mask`` ``[*batch]``, unchanged elsewhere."""
        ...

    def step(self, state: Tensor, action: Tensor, uniforms: Tensor) -> Tensor:
        """The state ``spec.dt`` later; action ``[*batch, m]`` in physical units, already clipped
        where the domain clips; uniforms ``[*batch, disturbance_dim]``."""
        ...

    def observe(self, state: Tensor) -> Tensor:
        """What a learner sees, ``[*batch, n]``, in the units of ``spec.state``."""
        ...

    def outcome(self, state: Tensor) -> Tensor:
        """``Outcome`` of each episode as int64 ``[*batch]``, without the time limit (the caller
        counts the seconds, unless the sim does)."""
        ...

    def measures(self, start: Tensor, final: Tensor, seconds: Tensor) -> dict[str, Tensor]:
        """Figures of finished episodes, each ``[*batch]``, by name with the unit as suffix."""
        ...


@runtime_checkable
class Actuated(Protocol):
    """A sim that knows what its actuators did: where the disturbance is on the action, a learner
    that fits actions to accelerations wants the action that acted, not the one it asked for."""

    def applied(self, state: Tensor) -> Tensor:
        """The action ``[*batch, m]``, physical units, that the step to ``state`` really applied."""
        ...


@runtime_checkable
class Fallible(Protocol):
    """A sim whose steps may fail to happen: nothing is to be learned from such a one."""

    def stepped(self, state: Tensor) -> Tensor:
        """Whether the step to ``state`` was one, bool ``[*batch]``."""
        ...


@runtime_checkable
class Rewarded(Protocol):
    """A sim with a reward of its own."""

    def total_reward(self, state: Tensor) -> Tensor:
        """Sum of the rewards of the episode up to ``state``, float64 ``[*batch]``."""
        ...


@runtime_checkable
class Judged(Protocol):
    """A sim that may know whether an episode succeeds without ending it for that."""

    def succeeded(self, state: Tensor) -> Tensor:
        """Int64 ``[*batch]``: 1 if an episode that ends in ``state`` is a success, 0 if not, -1 if
        the sim does not know."""
        ...


@runtime_checkable
class JudgesStates(Protocol):
    """A sim that tells from the true states alone whether an episode succeeded: also one that was
    only imagined, in a learned model."""

    def judge(self, states: Tensor) -> Tensor:
        """Whether an episode with these true states ``[*batch, T + 1, n]``, in the units of
        ``spec.state``, one per tick from its start, is a success: bool ``[*batch]``."""
        ...


@runtime_checkable
class Losing(Protocol):
    """A sim whose episodes can be lost to a fault of the simulator: they count for nothing."""

    def lost(self, state: Tensor) -> Tensor:
        """Whether the episode that is in ``state`` was lost, bool ``[*batch]``."""
        ...


@runtime_checkable
class Remembering(Protocol):
    """A sim with a memory of its own, that can be brought back to where it was.  What any other sim
    returns is to depend on its arguments alone."""

    def memory(self) -> dict[str, Tensor]:
        """What is needed for that, beside the state that was returned last."""
        ...

    def recall(self, state: Tensor, memory: dict[str, Tensor]) -> Tensor:
        """Go on, in a sim newly built, from ``state`` ``[*batch, k]``, the one that another had
        returned last when this was its ``memory``.  Returns that state, in which episodes that
        could not be brought back are lost (``Losing``)."""
        ...


@runtime_checkable
class Lasting(Protocol):
    """A sim of which something lasts a learner's whole life, from its first episode on: constants
    drawn for it, a clock.  ``restart`` leaves that as it is, and a new start depends on the state
    before it through that alone."""

    @property
    def lasting(self) -> tuple[int, ...]:
        """Which components of the full state last; none: all of a new start is drawn."""
        ...


@runtime_checkable
class Invertible(Protocol):
    """A sim that offers its true inverse dynamics, for baselines only."""

    def inverse_dynamics(self, state: Tensor, acceleration: Tensor) -> Tensor:
        """The action ``[*batch, m]`` that gives the components ``spec.tracked`` the second
        derivatives ``acceleration`` ``[*batch, len(tracked)]`` in ``state``, not clipped."""
        ...


Controller = Callable[[Tensor], Tensor]


@runtime_checkable
class Measured(Protocol):
    """A sim that has controllers of its own to compare learners with."""

    def baselines(self) -> Mapping[str, Controller]:
        """By name: full states ``[*batch, k]`` to actions ``[*batch, m]``, physical units."""
        ...


def baselines_of(sim: Sim) -> Mapping[str, Controller]:
    """The sim's own controllers by name, none if it has none.

    A method ``yardsticks``, the name before 0.1.0, is accepted too.
    """
    offered = getattr(sim, "baselines", None) or getattr(sim, "yardsticks", None)
    return {} if offered is None else offered()


@runtime_checkable
class Jointed(Protocol):
    """A sim whose components ``spec.tracked`` are the joints of a chain: an arm."""

    def chain(self) -> Chain:
        """The chain, for forward and inverse kinematics."""
        ...


@runtime_checkable
class Pictured(Protocol):
    """A sim that can draw itself."""

    def frame(self, trail: Tensor) -> np.ndarray:
        """RGB picture (uint8 ``[height, width, 3]``) of the last state of ``trail`` ``[T, k]``, the
        states of one episode so far."""
        ...
