"""What every sim must keep to, as a check that anyone who writes one can run."""

from __future__ import annotations

import math
from collections.abc import Callable
from importlib.util import find_spec
from typing import Any, cast

import torch
from torch import Tensor

from sims.base import (
    Judged,
    Lasting,
    Losing,
    Outcome,
    Remembering,
    Rewarded,
    Sim,
    Spec,
    spec_index,
)
from sims.rows import NoRows, torch_rows_of

Shape = tuple[int, ...]


def check(
    sim: Sim | Callable[[], Sim],
    *,
    batches: tuple[Shape, ...] = ((), (1,), (5,)),
    steps: int = 20,
    seed: int = 0,
    compiled: bool = True,
) -> None:
    """Raise an AssertionError that says what is wrong with ``sim``, if anything is.

    Checked, with random actions, in float64: the spec; shapes for every batch of ``batches``;
    finite states; the same uniforms giving the same digits; rows of a batch equal, bit for bit, to
    batches of one; arguments left as they were; restarts of some rows only, which leave alone what
    lasts (``sims.base.Lasting``); outcomes; rewards, successes and faults, where offered; measures;
    observations within their periods and bounds; goals constant during an episode; that a sim which
    recalls where it was (``sims.base.Remembering``) goes on with the same digits.

    A sim with ``rows`` (``sims.rows``) is compiled where numba is installed, which takes seconds,
    and each of its functions held equal to its tensor functions to 1e-12 of 1 + |x|.

    ``sim``: a sim, or a function that makes one, for sims with a memory of their own; ``compiled``:
    whether rows are compiled.
    """

    def make() -> Sim:
        return sim() if callable(sim) else cast(Sim, sim)

    spec = make().spec
    _check_spec(spec)
    written = make()
    if hasattr(written, "rows"):
        _check_rows(written)
    generator = torch.Generator().manual_seed(seed)
    names: set[str] | None = None
    for batch in batches:
        measures = _check_batch(make, batch, steps, generator)
        names = set(measures) if names is None else names
        _expect(set(measures) == names, spec, f"measures: {set(measures)} and {names}")
    declared = {measure.name for measure in spec.measures} | ({spec.shortest} - {""})
    missing = declared - (names or set())
    _expect(not missing, spec, f"spec.measures: {missing} not among the measures")
    if (5,) in batches and (1,) in batches:
        _check_singles(make, steps, generator)
    if compiled and hasattr(written, "rows") and find_spec("numba") is not None:
        _check_compiled(written, steps, generator)


def _check_spec(spec: Spec) -> None:
    for which in ("state", "action"):
        quantities = getattr(spec, which)
        names = [quantity.name for quantity in quantities]
        _expect(len(names) > 0, spec, f"spec.{which}: empty")
        _expect(len(set(names)) == len(names), spec, f"spec.{which}: a name twice in {names}")
        for quantity in quantities:
            where = f"spec.{which}.{quantity.name}"
            scale = quantity.scale
            _expect(math.isfinite(scale) and scale > 0, spec, f"{where}: scale {scale}")
            _expect(quantity.low < quantity.high, spec, f"{where}: low is not below high")
            _expect(quantity.period >= 0, spec, f"{where}: period {quantity.period}")
    _expect(math.isfinite(spec.dt) and spec.dt > 0, spec, f"spec.dt: {spec.dt}")
    _expect(spec.time_limit >= spec.dt, spec, f"spec.time_limit: {spec.time_limit}, below dt")
    _expect(spec.reset_dim >= 0, spec, f"spec.reset_dim: {spec.reset_dim}")
    _expect(spec.disturbance_dim >= 0, spec, f"spec.disturbance_dim: {spec.disturbance_dim}")
    known = [quantity.name for quantity in spec.state]
    _expect(spec.headline in known, spec, f"spec.headline: {spec.headline!r} is not in {known}")
    for which in ("goal", "tracked"):
        for name in getattr(spec, which):
            _expect(name in known, spec, f"spec.{which}: {name!r} is not in {known}")
    pairs = f"{spec.goal} and {spec.tracked}"
    _expect(len(spec.goal) == len(spec.tracked), spec, f"spec.goal, spec.tracked: {pairs}")
    _expect(not set(spec.goal) & set(spec.tracked), spec, f"spec.goal, spec.tracked: {pairs}")
    for quantity in spec.state:
        of = quantity.rate_of
        _expect(of in ("", *known), spec, f"spec.state.{quantity.name}: rate_of {of!r}")


class _Draws:
    """The random numbers of one episode of some steps."""

    def __init__(self, spec: Spec, batch: Shape, steps: int, generator: torch.Generator) -> None:
        def uniform(*shape: int) -> Tensor:
            return torch.rand(*shape, generator=generator, dtype=torch.float64)

        m = len(spec.action)
        low = torch.tensor([max(q.low, -q.scale) for q in spec.action], dtype=torch.float64)
        high = torch.tensor([min(q.high, q.scale) for q in spec.action], dtype=torch.float64)
        self.starts = uniform(*batch, spec.reset_dim)
        self.restarts = uniform(*batch, spec.reset_dim)
        self.actions = [low + (high - low) * uniform(*batch, m) for _ in range(steps)]
        self.disturbances = [uniform(*batch, spec.disturbance_dim) for _ in range(steps)]

    def row(self, k: int) -> _Draws:
        """Those of row k alone, as a batch of one."""
        one = object.__new__(_Draws)
        one.starts, one.restarts = self.starts[k : k + 1], self.restarts[k : k + 1]
        one.actions = [action[k : k + 1] for action in self.actions]
        one.disturbances = [uniforms[k : k + 1] for uniforms in self.disturbances]
        return one


def _episode(sim: Sim, draws: _Draws) -> list[Tensor]:
    spec = sim.spec
    states = [sim.initial(draws.starts)]
    for action, disturbance in zip(draws.actions, draws.disturbances, strict=True):
        state = states[-1]
        arguments = [state, action, disturbance]
        before = [argument.clone() for argument in arguments]
        states.append(sim.step(*arguments))
        for name, old, new in zip(("state", "action", "uniforms"), before, arguments, strict=True):
            same = torch.allclose(old, new, 0.0, 0.0, equal_nan=True)
            _expect(same, spec, f"step: changes its argument {name} in place")
    return states


def _check_batch(
    make: Callable[[], Sim], batch: Shape, steps: int, generator: torch.Generator
) -> dict[str, Tensor]:
    sim = make()
    spec = sim.spec
    draws = _Draws(spec, batch, steps, generator)
    states = _episode(sim, draws)
    size = states[0].shape[-1] if states[0].ndim else 0
    low = torch.tensor([q.low for q in spec.state], dtype=torch.float64)
    high = torch.tensor([q.high for q in spec.state], dtype=torch.float64)
    half = torch.tensor([q.period / 2 or math.inf for q in spec.state], dtype=torch.float64)
    for k, state in enumerate(states):
        where = f"batch {batch}, step {k}"
        _expect(state.shape == (*batch, size), spec, f"{where}: state of shape {_of(state)}")
        _expect(bool(state.isfinite().all()), spec, f"{where}: state is not finite")
        seen = sim.observe(state)
        n = len(spec.state)
        _expect(seen.shape == (*batch, n), spec, f"{where}: observation of shape {_of(seen)}")
        _expect(bool((seen.abs() <= half).all()), spec, f"{where}: observation beyond its period")
        inside = ((seen >= low) & (seen <= high)).all()
        _expect(bool(inside), spec, f"{where}: observation out of its bounds")
        outcome = sim.outcome(state)
        _expect(outcome.shape == batch, spec, f"{where}: outcome of shape {_of(outcome)}")
        _expect(outcome.dtype == torch.int64, spec, f"{where}: outcome is {outcome.dtype}")
        known = all(int(value) in list(Outcome) for value in outcome.reshape(-1))
        _expect(known, spec, f"{where}: outcome {outcome.tolist()} is not an Outcome")
        _check_judgement(sim, state, where)
    goal = spec_index(spec, spec.goal)
    for k, state in enumerate(states):
        same = torch.equal(sim.observe(state)[..., goal], sim.observe(states[0])[..., goal])
        _expect(same, spec, f"batch {batch}, step {k}: the goal has moved")
    running = bool((sim.outcome(states[0]) == int(Outcome.RUNNING)).all())
    _expect(running, spec, f"batch {batch}: a start that is not RUNNING")

    seconds = torch.full(batch, steps * spec.dt, dtype=torch.float64)
    measures = sim.measures(states[0], states[-1], seconds)
    for name, value in measures.items():
        _expect(value.shape == batch, spec, f"measures.{name}: shape {_of(value)}, batch {batch}")
        _expect(value.is_floating_point(), spec, f"measures.{name}: {value.dtype}")

    _check_restart(make, sim, states[-1], batch, draws)
    again = _episode(make(), draws)
    same = all(torch.equal(a, b) for a, b in zip(states, again, strict=True))
    _expect(same, spec, f"batch {batch}: other digits from the same uniforms and actions")
    _check_memory(make, draws)
    return measures


def _check_memory(make: Callable[[], Sim], draws: _Draws) -> None:
    sim = make()
    if not isinstance(sim, Remembering):
        return
    moves = list(zip(draws.actions, draws.disturbances, strict=True))
    half = len(moves) // 2
    state = sim.initial(draws.starts)
    for move in moves[:half]:
        state = sim.step(state, *move)
    memory, mask = sim.memory(), torch.ones(state.shape[:-1], dtype=torch.bool)

    def rest(sim: Sim, state: Tensor) -> list[Tensor]:
        states = [state]
        for move in moves[half:]:
            states.append(sim.step(states[-1], *move))
        return [*states, sim.restart(states[-1], mask, draws.restarts)]

    wanted, other = rest(sim, state), make()
    assert isinstance(other, Remembering)
    for k, (a, b) in enumerate(zip(rest(other, other.recall(state, memory)), wanted, strict=True)):
        _expect(torch.equal(a, b), sim.spec, f"recall: other digits, {k} steps after")


def _check_judgement(sim: Sim, state: Tensor, where: str) -> None:
    """What a sim may say of reward, success and faults."""
    offered: dict[str, tuple[Tensor, torch.dtype]] = {}
    if isinstance(sim, Rewarded):
        offered["total_reward"] = sim.total_reward(state), torch.float64
    if isinstance(sim, Judged):
        offered["succeeded"] = sim.succeeded(state), torch.int64
    if isinstance(sim, Losing):
        offered["lost"] = sim.lost(state), torch.bool
    for name, (found, dtype) in offered.items():
        right = (found.shape, found.dtype) == (state.shape[:-1], dtype)
        expected = f"expected {_of(state[..., 0])} of {dtype}"
        _expect(right, sim.spec, f"{where}: {name}: {_of(found)} of {found.dtype}, {expected}")
    if "succeeded" in offered:
        found = offered["succeeded"][0]
        known = bool(((found >= -1) & (found <= 1)).all())
        _expect(known, sim.spec, f"{where}: succeeded: expected -1, 0 or 1, not {found.tolist()}")


def _check_restart(
    make: Callable[[], Sim], sim: Sim, state: Tensor, batch: Shape, draws: _Draws
) -> None:
    spec = sim.spec
    old = state.clone()
    mask = torch.arange(math.prod(batch)).reshape(batch) % 2 == 0
    new = sim.restart(state, mask, draws.restarts)
    _expect(torch.equal(old, state), spec, "restart: changes its argument state in place")
    _expect(new.shape == state.shape, spec, f"restart: state of shape {_of(new)}")
    _expect(torch.equal(new[~mask], old[~mask]), spec, "restart: changed a row outside the mask")
    fresh = make().initial(draws.restarts)
    lasting = list(sim.lasting) if isinstance(sim, Lasting) else []
    if lasting:
        kept = torch.equal(new[..., lasting], old[..., lasting])
        _expect(kept, spec, "restart: changed what lasts")
        # A new start in the same life: the state before it was another one, but for what lasts.
        fresh[..., lasting] = old[..., lasting]
        fresh = sim.restart(fresh, torch.ones_like(mask), draws.restarts)
    _expect(torch.equal(new[mask], fresh[mask]), spec, "restart: a row in the mask is no new start")


def _check_singles(make: Callable[[], Sim], steps: int, generator: torch.Generator) -> None:
    spec = make().spec
    draws = _Draws(spec, (5,), steps, generator)
    sim = make()
    together = _episode(sim, draws)
    for k in range(5):
        alone = _episode(make(), draws.row(k))
        for t, (one, all_) in enumerate(zip(alone, together, strict=True)):
            same = torch.equal(one[0], all_[k])
            _expect(same, spec, f"step {t}: row {k} of a batch of 5 has other digits than alone")
            seen = torch.equal(sim.observe(one)[0], sim.observe(all_)[k])
            _expect(seen, spec, f"step {t}: observation of row {k} has other digits than alone")


def _check_rows(sim: Any) -> None:
    try:
        torch_rows_of(sim)
    except NoRows:
        return
    except ValueError as error:
        raise AssertionError(f"{sim.spec.name}: {error}") from error


def _check_compiled(sim: Any, steps: int, generator: torch.Generator) -> None:
    # numba takes seconds to import.
    from sims.compiled_rows import compiled, first_difference

    spec: Spec = sim.spec
    draws = _Draws(spec, (5,), steps, generator)
    states = _episode(sim, draws)
    before, after = torch.cat(states[:-1]), torch.cat(states[1:])
    moves = (before, torch.cat(draws.actions), torch.cat(draws.disturbances))
    redrawn = draws.restarts.repeat(steps, 1)
    everywhere = torch.ones(len(after), dtype=torch.bool)
    try:
        rows = compiled(sim, "conformance")
        pairs: list[tuple[str, tuple[Tensor, ...], Tensor]] = [
            ("birth", (draws.starts,), states[0])
            if rows.birth is not None
            else ("start", (torch.zeros_like(states[0]), draws.starts), states[0]),
            ("start", (after, redrawn), sim.restart(after, everywhere, redrawn)),
            ("step", moves, after),
            ("observe", (after,), sim.observe(after)),
            ("outcome", (after,), sim.outcome(after)),
        ]
        if rows.stepped is not None:
            pairs.append(("stepped", (after,), sim.stepped(after)))
        for member, arguments, wanted in pairs:
            difference = first_difference(rows, member, arguments, wanted)
            _expect(difference is None, spec, f"rows: {difference}")
    except NoRows:
        return
    except ValueError as error:
        raise AssertionError(f"{spec.name}: {error}") from error


def _of(tensor: Tensor) -> Shape:
    return tuple(tensor.shape)


def _expect(holds: bool, spec: Spec, message: str) -> None:
    if not holds:
        raise AssertionError(f"{spec.name}: {message}")
