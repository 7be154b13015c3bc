"""Physics written once: the functions of a simulator over rows, for torch and for numba.

A row is one component: a float64 number in compiled code, a tensor ``[*batch]`` in torch.  A
simulator that writes ``rows(xp)`` with the functions of a ``Namespace`` is batched and
differentiable in torch, through ``RowSim``, and compiled to scalar code by
``sims.compiled_rows.compiled``.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from types import SimpleNamespace
from typing import Any, Protocol, cast

import torch
from torch import Tensor

from sims.base import Spec, expect_action

Row = Any
"""A number or a tensor ``[*batch]``."""

Function = Callable[..., Any]


class NoRows(ValueError):
    """A simulator cannot be written over rows as it is configured; one sentence that says why."""


class Namespace(Protocol):
    """The functions that the text of a simulator may use beside arithmetic and comparisons.

    NaN is passed on by ``minimum`` and ``maximum``; ``sign(NaN)`` is 0; ``round`` is to the even
    number at a half.  Masks are results of comparisons, and are combined by ``both``, ``either``
    and ``negated``.  Branches are ``where``, both sides of which are computed.
    """

    sin: Function
    cos: Function
    tan: Function
    tanh: Function
    atan: Function
    asin: Function
    sqrt: Function
    exp: Function
    log: Function
    log1p: Function
    floor: Function
    round: Function
    abs: Function
    sign: Function
    minimum: Function
    maximum: Function
    isfinite: Function
    where: Function
    """(mask, a, b): a where the mask holds, else b."""
    both: Function
    either: Function
    negated: Function
    as_number: Function
    """1.0 where a mask holds, else 0.0."""
    tiny: Function
    """The least normal positive number of the type of a row."""
    jit: Function
    """Decorates every function that another one calls: compiles it in numba, returns it in
    torch."""


def _of_rows(function: Function) -> Function:
    """``function`` of a tensor, also for a number, such as a constant of the simulator."""

    def of_row(x: Row) -> Tensor:
        return function(x if isinstance(x, Tensor) else torch.tensor(x, dtype=torch.float64))

    return of_row


def _where(mask: Tensor, a: Row, b: Row) -> Row:
    if not (isinstance(a, Tensor) or isinstance(b, Tensor)):
        if a == b:
            return a
        if isinstance(a, float) or isinstance(b, float):
            # torch would make float32 of two numbers.
            a = torch.tensor(a, dtype=torch.float64, device=mask.device)
    return torch.where(mask, a, b)


def _minimum(a: Row, b: Row) -> Row:
    if not isinstance(a, Tensor):
        a, b = b, a
    if not isinstance(a, Tensor):
        return min(a, b)
    return torch.minimum(a, b) if isinstance(b, Tensor) else a.clamp(max=b)


def _maximum(a: Row, b: Row) -> Row:
    if not isinstance(a, Tensor):
        a, b = b, a
    if not isinstance(a, Tensor):
        return max(a, b)
    return torch.maximum(a, b) if isinstance(b, Tensor) else a.clamp(min=b)


_ELEMENTWISE = "sin cos tan tanh atan asin sqrt exp log log1p floor round abs sign isfinite".split()

TORCH = cast(
    Namespace,
    SimpleNamespace(
        **{name: _of_rows(getattr(torch, name)) for name in _ELEMENTWISE},
        minimum=_minimum,
        maximum=_maximum,
        where=_where,
        both=torch.logical_and,
        either=torch.logical_or,
        negated=torch.logical_not,
        as_number=lambda mask: mask.to(torch.float64),
        tiny=lambda x: torch.finfo(x.dtype).tiny,
        jit=lambda function: function,
    ),
)

_OTHER = cast(Namespace, SimpleNamespace(**vars(TORCH)))
"""Not ``TORCH``: what a simulator raises for it, it raises for numba's."""


@dataclass(frozen=True)
class Rows:
    """A simulator over rows.

    ``state``, ``action`` and ``uniforms`` below are tuples of rows, those of ``sims.base.Sim`` one
    component after the other; so are the results but for ``outcome`` and ``stepped``, which are one
    row.  A row of a result may be a number.

    ``constants``: floats, best a NamedTuple, the last argument of every function: all numbers that
    one may change without compiling again.  Empty is replaced by (0.0,), which has a type for
    numba.  ``width``: rows of a full state.

    ``step(state, action, uniforms, constants)``: the full state ``spec.dt`` later; action in
    physical units.
    ``observe(state, constants)``: the components of ``spec.state``, in its units.
    ``outcome(state, constants)``: a code of ``sims.base.Outcome``, integer.
    ``start(state, uniforms, constants)``: a new start; keeps what lasts a life from ``state``.
    ``birth(uniforms, constants)``: the first start of a life; None: ``start`` from zeros.
    ``stepped(state, constants)``: whether the step to ``state`` was one (``sims.base.Fallible``);
    None where all are.
    """

    width: int
    step: Function
    observe: Function
    outcome: Function
    start: Function
    birth: Function | None = None
    stepped: Function | None = None
    constants: tuple[Any, ...] = (0.0,)

    def __post_init__(self) -> None:
        """Refuse what is no function, and give empty constants a number."""
        for name in ("step", "observe", "outcome", "start"):
            if not callable(getattr(self, name)):
                raise ValueError(f"expected a function `{name}`")
        for name in ("birth", "stepped"):
            if not (getattr(self, name) is None or callable(getattr(self, name))):
                raise ValueError(f"expected a function `{name}` or None")
        if len(self.constants) == 0:
            object.__setattr__(self, "constants", (0.0,))


class HasRows(Protocol):
    """A simulator with rows."""

    @property
    def spec(self) -> Spec:
        """The facts of the domain."""
        ...

    def rows(self, xp: Namespace) -> Rows:
        """Its functions, with those of ``xp``; raises NoRows where there are none."""
        ...


def torch_rows_of(sim: HasRows) -> Rows:
    """``sim.rows(TORCH)``, tried on zeros.

    ValueError, one line, names the first member that is missing or returns something else than
    ``Rows`` says.
    """
    name = type(sim).__name__
    try:
        rows = sim.rows(TORCH)
    except NoRows:
        raise
    except (TypeError, ValueError) as error:
        missing = str(error).partition("required positional argument")[2].strip(": '")
        reason = f"expected a function `{missing}`" if missing else str(error)
        raise ValueError(f"{name}.rows: {reason}") from error
    if not isinstance(rows, Rows):
        raise ValueError(f"{name}.rows: returned {type(rows).__name__}, expected Rows")
    if rows.stepped is not None and not hasattr(sim, "stepped"):
        raise ValueError(f"{name}.rows: gives `stepped`, expected {name} to be a FallibleRowSim")
    _try(name, rows, sim.spec)
    return rows


def rows_of(sim: HasRows) -> Rows:
    """The rows in torch of a simulator whose rows can be compiled, found out without compiling.

    NoRows where it has none in other namespaces, its constants are no numbers, or a subclass
    overrides one of the tensor functions alone; ValueError as ``torch_rows_of``.
    """
    rows, kind = torch_rows_of(sim), type(sim)
    sim.rows(_OTHER)
    if rows.stepped is None and hasattr(sim, "stepped"):
        raise NoRows(f"{kind.__name__}: its `stepped` is not among its rows")
    written = kind.__mro__.index(next(c for c in kind.__mro__ if "rows" in vars(c)))
    for c in kind.__mro__[:written]:
        for member in ("initial", "restart", "step", "observe", "outcome", "stepped"):
            if member in vars(c):
                raise NoRows(f"{kind.__name__}: overrides `{member}` and not `rows`")
    names = getattr(rows.constants, "_fields", range(len(rows.constants)))
    for name, value in zip(names, rows.constants, strict=True):
        if not isinstance(value, float | int):
            raise NoRows(
                f"{kind.__name__}.rows: constants.{name} is a {type(value).__name__}:"
                " compiled code takes numbers"
            )
    return rows


def _try(name: str, rows: Rows, spec: Spec) -> None:
    """ValueError where a function does not return what ``Rows`` says."""

    def zeros(count: int) -> tuple[Tensor, ...]:
        return (torch.zeros((), dtype=torch.float64),) * count

    state, draws = zeros(rows.width), zeros(spec.reset_dim)
    step = (state, zeros(len(spec.action)), zeros(spec.disturbance_dim))
    wanted = f"width={rows.width}"
    for member, arguments, count, expected in (
        ("step", step, rows.width, wanted),
        ("observe", (state,), len(spec.state), f"{len(spec.state)}, as spec.state"),
        ("start", (state, draws), rows.width, wanted),
        ("birth", (draws,), rows.width, wanted),
        ("outcome", (state,), None, "one row of whole numbers"),
        ("stepped", (state,), None, "one row of true or false"),
    ):
        function = getattr(rows, member)
        if function is None:
            continue
        where = f"{name}.rows: {member}"
        try:
            got = function(*arguments, rows.constants)
        except Exception as error:
            # Whatever the text of a user's simulator raises.
            line = str(error).partition("\n")[0]
            raise ValueError(f"{where} failed: {type(error).__name__}: {line}") from error
        if count is None:
            found = got.dtype if isinstance(got, Tensor) else type(got)
            right = (torch.int64, int) if member == "outcome" else (torch.bool, bool)
            if found not in right:
                raise ValueError(f"{where} returned {found}, expected {expected}")
        elif not isinstance(got, tuple):
            raise ValueError(f"{where} returned {type(got).__name__}, expected a tuple of rows")
        elif len(got) != count:
            raise ValueError(f"{where} returned {len(got)} rows, expected {expected}")


def joined(xp: Namespace, *functions: Function) -> Function:
    """The function whose tuple is those of ``functions``, all of the same arguments, one after the
    other: numba builds no tuple in a loop."""
    if len(functions) == 1:
        return functions[0]
    if len(functions) > 4:
        return joined(xp, joined(xp, *functions[:4]), *functions[4:])
    # Of four, the last of which may add nothing.
    nothing = xp.jit(lambda *arguments: ())
    a, b, c, d = (*functions, nothing, nothing, nothing, nothing)[:4]
    return xp.jit(lambda *s: (*a(*s), *b(*s), *c(*s), *d(*s)))


def first_over(xp: Namespace, count: int) -> Function:
    """The first ``count`` of some rows."""
    if not count:
        return xp.jit(lambda s: ())
    return joined(xp, *(xp.jit(lambda s, i=i: (s[i],)) for i in range(count)))


def unstacked(tensor: Tensor) -> tuple[Tensor, ...]:
    """The components ``[*batch]`` of ``[*batch, k]``.

    Each is one run of memory, so that elementwise functions of it have the same digits for any
    batch.  What ``stacked`` returns is laid out so already and is not copied.
    """
    return tensor.movedim(-1, 0).contiguous().unbind(0)


def stacked(rows: tuple[Row, ...], like: Tensor) -> Tensor:
    """Rows, some of which may be numbers, as ``[*batch, k]`` of the batch and type of ``like``
    ``[*batch, n]``, each component in one run of memory."""
    return torch.stack([_expanded(row, like) for row in rows]).movedim(0, -1)


def _expanded(row: Row, like: Tensor) -> Tensor:
    batch = like.shape[:-1]
    if not isinstance(row, Tensor):
        return torch.full(batch, row, dtype=like.dtype, device=like.device)
    row = row.to(like.dtype)
    return row if row.shape == batch else row.expand(batch)


class RowSim:
    """The tensor functions of ``sims.base.Sim`` from ``rows``, for a class that has ``spec``,
    ``rows`` and ``measures``; ``FallibleRowSim`` where ``rows`` gives ``stepped``."""

    traceable = True

    def rows(self, xp: Namespace) -> Rows:
        """To be written."""
        raise NotImplementedError(f"{type(self).__name__}: expected a function `rows`")

    @cached_property
    def _rows(self) -> Rows:
        return torch_rows_of(cast(HasRows, self))

    def __getstate__(self) -> dict[str, Any]:
        """Without the functions, which cannot be pickled."""
        return {name: value for name, value in vars(self).items() if name != "_rows"}

    def initial(self, uniforms: Tensor) -> Tensor:
        """Start states ``[*batch, k]`` from uniforms ``[*batch, reset_dim]``."""
        rows, draws = self._rows, unstacked(uniforms)
        if rows.birth is not None:
            return stacked(rows.birth(draws, rows.constants), uniforms)
        nothing = torch.zeros(uniforms.shape[:-1], dtype=uniforms.dtype, device=uniforms.device)
        return stacked(rows.start((nothing,) * rows.width, draws, rows.constants), uniforms)

    def restart(self, state: Tensor, mask: Tensor, uniforms: Tensor) -> Tensor:
        """``state`` with a new start where ``mask`` ``[*batch]``, unchanged elsewhere."""
        rows = self._rows
        start = rows.start(unstacked(state), unstacked(uniforms), rows.constants)
        return torch.where(mask[..., None], stacked(start, state), state)

    def step(self, state: Tensor, action: Tensor, uniforms: Tensor) -> Tensor:
        """The state ``spec.dt`` later; action ``[*batch, m]`` in physical units; uniforms
        ``[*batch, disturbance_dim]``."""
        spec: Spec = cast(Any, self).spec
        expect_action(state, action, len(spec.action))
        rows = self._rows
        moved = rows.step(unstacked(state), unstacked(action), unstacked(uniforms), rows.constants)
        return stacked(moved, state)

    def observe(self, state: Tensor) -> Tensor:
        """What a learner sees, ``[*batch, n]``, in the units of ``spec.state``."""
        rows = self._rows
        return stacked(rows.observe(unstacked(state), rows.constants), state)

    def outcome(self, state: Tensor) -> Tensor:
        """``Outcome`` of each episode as int64 ``[*batch]``, without the time limit."""
        rows = self._rows
        outcome = rows.outcome(unstacked(state), rows.constants)
        return _expanded(outcome, state.new_empty((), dtype=torch.int64).expand(state.shape))


class FallibleRowSim(RowSim):
    """A ``RowSim`` whose steps may fail to happen (``sims.base.Fallible``)."""

    def stepped(self, state: Tensor) -> Tensor:
        """Whether the step to ``state`` was one, bool ``[*batch]``."""
        rows = self._rows
        if rows.stepped is None:
            raise ValueError(f"{type(self).__name__}.rows: expected a function `stepped`")
        return rows.stepped(unstacked(state), rows.constants)
