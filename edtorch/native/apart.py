"""The learner in kernels, apart from its world: for environments of any kind.

``Apart`` holds learners in the memory of kernels; ``Halves`` is a ``Stage`` whose worlds step in
torch; ``RealTime`` is one learner whose world is elsewhere.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

import numpy as np
import torch
from numpy.typing import ArrayLike, NDArray
from torch import Tensor

from edtorch.compiled import load_kernel
from edtorch.learner.learner import AnyLearner
from edtorch.native.layout import RowLayout
from edtorch.native.plan import KernelPlan, add_units, learner_plan
from edtorch.native.source import source_of
from edtorch.native.stage import lanes_for
from edtorch.run.random import BLOCK, Streams, draw_block, learning_keys
from edtorch.run.recorder import Recorder
from edtorch.run.scaled_sim import World
from edtorch.run.tick import Population, Source, Tick
from edtorch.run.training import Eager, Note
from edtorch.types import LearnerState, Metrics, Transition, replace


class Apart:
    """B learners in the memory of kernels, and two functions of contiguous float64 arrays.

    ``acts(observation, normal, action)`` writes actions ``[B, m]`` for observations ``[B, n]`` and
    standard normal numbers ``[B, m]``.  ``learns(state, action, following, valid, said, improve)``
    learns from transitions, ``valid`` ``[B]`` bool, and writes whether transition, fit and unroll
    were finite, error, value and gradient to ``said`` ``[B, 6]``.  Observation, state and action
    may be ``[0, ...]``: what followed before, and what was done.
    """

    def __init__(
        self,
        learner: Source[LearnerState],
        world: World,
        state: LearnerState,
        *,
        units: Callable[[KernelPlan, World], None] | None = None,
        lanes: int | None = None,
    ) -> None:
        """units: adds others than those of ``World`` to a plan; lanes: see ``Native``.

        Raises NoKernel, and Unavailable.
        """
        self._size, n, m = len(state.tick), len(world.spec.state), len(world.spec.action)
        self._seen = torch.zeros(self._size, n, dtype=torch.float64)
        self._layout = RowLayout.of(self._tree(state))
        plan = learner_plan(learner, world, self._layout)
        if units is not None:
            units(plan, world)
        self._lanes = lanes = lanes_for(plan, self._size) if lanes is None else lanes
        source, number, _ = source_of(plan, None, lanes)
        numbers, self._counters = self._layout.pack(self._tree(state), lanes)
        scratch = np.zeros(plan.constants["SCRATCH"] * lanes)
        tape = np.zeros((int(plan.numbers["STEPS"]) + 1) * plan.constants["TAPE"] * lanes)
        w = np.concatenate((scratch, numbers.reshape(-1), number, tape))
        self._numbers = w[len(scratch) :][: numbers.size].reshape(numbers.shape)
        k = self._counters.reshape(-1)
        seen, done, said = np.zeros((1, n)), np.zeros((1, m)), np.zeros((1, 6))
        entries = {
            "acts": (w, k, seen, done, done),
            "learns": (w, k, seen, done, seen, np.ones(1, dtype=bool), said, True),
        }
        what = f"learners for {world.spec.name}, {lanes} at a time"
        acts, learns = load_kernel(source, entries, what)
        self.acts, self.learns = partial(acts, w, k), partial(learns, w, k)

    def _tree(self, state: LearnerState) -> dict[str, Any]:
        return {"learners": state, "worlds": {"observation": self._seen}}

    @property
    def state(self) -> LearnerState:
        """What they know."""
        return self._layout.unpack(self._numbers, self._counters, self._size)["learners"]

    def replace(self, state: LearnerState) -> None:
        """Go on with others, as many."""
        self._numbers[:], self._counters[:] = self._layout.pack(self._tree(state), self._lanes)


class _Source:
    """Learners in kernels as a source of actions; the memory passed in is returned unchanged."""

    def __init__(self, apart: Apart) -> None:
        self._apart = apart

    def begin(self, memory: LearnerState, fresh: Tensor, observation: Tensor, /) -> LearnerState:
        return memory

    def act(self, memory: LearnerState, observation: Tensor, normal: Tensor, /) -> Tensor:
        action = np.empty(normal.shape)
        self._apart.acts(_array(observation), _array(normal), action)
        return torch.from_numpy(action)

    def step(
        self, memory: LearnerState, transition: Transition, /, *, improve: bool
    ) -> tuple[LearnerState, Metrics]:
        said = np.empty((len(transition.valid), 6))
        self._apart.learns(
            _array(transition.state),
            _array(transition.action),
            _array(transition.next_state),
            _array(transition.valid),
            said,
            improve,
        )
        sound, fit_ok, value_ok, error, value, gradient = torch.from_numpy(said).unbind(-1)
        if not improve:
            finite = torch.stack([sound, fit_ok, torch.ones_like(sound)]) > 0
            return memory, Metrics(None, None, error, finite, None)
        finite = torch.stack([sound, fit_ok, value_ok]) > 0
        return memory, Metrics(value, gradient, error, finite, None)


def _array(tensor: Tensor) -> NDArray[Any]:
    return np.ascontiguousarray(tensor.detach().numpy())


class Halves:
    """A ``Stage`` whose learners are in kernels and whose worlds step in torch.

    recorder: see ``Eager``.
    """

    piece = Eager.piece

    def __init__(
        self,
        tick: Tick[LearnerState],
        population: Population[LearnerState],
        streams: Streams,
        recorder: Recorder | None = None,
        lanes: int | None = None,
    ) -> None:
        """Raises NoKernel, and Unavailable; lanes: see ``Native``."""
        self._apart = Apart(tick.learner, tick.world, population.learners, lanes=lanes)
        source = _Source(self._apart)
        halved = Tick(
            source, tick.world, tick.most_episodes, tick.most_successes, tick.schedule, tick.view
        )
        self._worlds = Eager(halved, population, streams, recorder)

    @property
    def population(self) -> Population[LearnerState]:
        """See ``Stage``."""
        return replace(self._worlds.population, learners=self._apart.state)

    @property
    def done(self) -> bool:
        """See ``Stage``."""
        return self._worlds.done

    def replace(self, population: Population[LearnerState]) -> None:
        """See ``Stage``."""
        self._apart.replace(population.learners)
        self._worlds.replace(population)

    def run(self, clock: int, ticks: int, stride: int, note: Note) -> int:
        """See ``Stage``."""
        return self._worlds.run(clock, ticks, stride, note)


class RealTime:
    """One learner in real time: the caller steps the world, and passes each observation on.

    Observations and actions are in the units of ``world.spec``, angles wrapped; its exploration is
    that of a training with the same seed.  The time between two ticks is ``world.dt``, whatever
    the calls take.
    """

    def __init__(
        self,
        learner: AnyLearner,
        world: World,
        seed: int = 0,
        state: LearnerState | None = None,
    ) -> None:
        """state: of one learner, to go on with; None for one that knows nothing yet.

        Raises NoKernel for parts that have none, and Unavailable where nothing can be compiled.
        """
        first = learner.initial([seed]) if state is None else state
        self._apart = apart = Apart(learner, world, first, units=add_units)
        self._acts, self._learns = apart.acts, apart.learns
        self._drawn = learning_keys([seed]), world.uniforms, len(world.spec.action)
        self._clock = int(first.tick)
        self._normal = self._block()
        n, m = len(world.spec.state), len(world.spec.action)
        self._seen, self._begun = np.zeros((1, n)), np.zeros((1, n))
        self._nothing, self._done = np.zeros((0, n)), np.zeros((0, m))
        self._from, self._action = self._begun, np.zeros((1, m))
        self._said, self._valid = np.ones((1, 6)), np.ones(1, dtype=bool)

    def _block(self) -> NDArray[np.float64]:
        """Numbers of the ticks of a block, ``[BLOCK, 1, m]``."""
        _, normal = draw_block(*self._drawn, (self._clock + 1) // BLOCK)
        return np.ascontiguousarray(normal.transpose(1, 0, 2))

    def begin(self, observation: ArrayLike) -> None:
        """The first observation ``[n]`` of an episode.  ValueError for other shapes."""
        given = np.asarray(observation, dtype=np.float64)
        if given.shape != self._begun.shape[1:]:
            raise ValueError(
                f"observation: has shape {given.shape}, expected {self._begun.shape[1:]}"
            )
        self._begun[0], self._from = given, self._begun

    def act(self) -> NDArray[np.float64]:
        """What to do now, ``[m]``, exploration included; the next call writes to it again."""
        self._acts(self._from, self._normal[(self._clock + 1) % BLOCK], self._action)
        self._from = self._nothing
        return self._action[0]

    def learn(self, observation: ArrayLike, *, improve: bool = True, valid: bool = True) -> None:
        """From what was observed, done, and is observed now, ``[n]``; improve: whether the policy
        is improved as well; valid: false where nothing is to be learned from this tick."""
        self._seen[0], self._valid[0] = observation, valid
        self._learns(self._nothing, self._done, self._seen, self._valid, self._said, improve)
        self._clock += 1
        if (self._clock + 1) % BLOCK == 0:
            self._normal = self._block()

    @property
    def finite(self) -> NDArray[np.bool_]:
        """Of the last tick, by place (``edtorch.learner.learner.Check``)."""
        return self._said[0, :3] > 0

    @property
    def state(self) -> LearnerState:
        """What it knows: ``learner.acting(state)`` are the parameters of its policy."""
        return self._apart.state
