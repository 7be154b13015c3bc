"""A tick as a compiled program: exported once, compiled by Inductor ahead of time, kept on disk.

The program is that of the pure functions of ``edtorch.tick``, for a tile of a fixed number of
learners.  Shapes are what they are everywhere, ``[B, ...]``; only the storage is turned about, so
that the learners lie side by side and every operation is a run of vector instructions over them.
What the library would do with matrices (``bmm``, ``cat`` along rows) is rewritten for that
(``DECOMPOSITIONS``); nothing else differs from the tick that runs operation by operation.
"""

from __future__ import annotations

import hashlib
import io
import os
import pickle
import platform
import sys
import tempfile
import time
import warnings
from collections.abc import Callable
from dataclasses import dataclass, fields, is_dataclass
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch._inductor import aoti_compile_and_package, aoti_load_package
from torch.utils import _pytree as pytree

from edtorch.compilation import CannotCompile, check_compiler
from edtorch.streams import Draw
from edtorch.tick import Population, Tick

OPTIONS = {"memory_planning": True, "cpp.threads": 1}
"""Of the compiler: one allocation for all intermediate results of a tick; one thread."""

aten = torch.ops.aten


def last(tensor: Tensor) -> Tensor:
    """``[B, ...]`` stored with the batch innermost: contiguous ``[..., B]``."""
    return tensor.movedim(0, -1).contiguous()


def first(tensor: Tensor) -> Tensor:
    """``[..., B]`` seen as ``[B, ...]``."""
    return tensor.movedim(-1, 0)


def _stored(tensor: Tensor) -> Tensor:
    """``last``, as a tensor of its own in any case."""
    return tensor.movedim(0, -1).clone(memory_format=torch.contiguous_format)


def _sum_of_products(a: Tensor, b: Tensor) -> Tensor:
    """``bmm`` of matrices too small for a library."""
    a, b = a.movedim(0, -1), b.movedim(0, -1)
    return first((a.unsqueeze(2) * b.unsqueeze(0)).sum(1))


def _sum_of_products_and(
    c: Tensor, a: Tensor, b: Tensor, *, beta: float = 1, alpha: float = 1
) -> Tensor:
    return beta * c + alpha * _sum_of_products(a, b)


def _reduced(reduce: Callable[..., Tensor]) -> Callable[..., Tensor]:
    """A reduction over other axes than the batch."""

    def over(tensor: Tensor, dim: list[int], keepdim: bool = False, **more: Any) -> Tensor:
        axes = [d % tensor.ndim - 1 for d in dim]
        if min(axes) < 0:
            return reduce(tensor, dim, keepdim, **more)
        return first(reduce(tensor.movedim(0, -1), axes, keepdim, **more))

    return over


def _joined(tensors: list[Tensor], dim: int = 0) -> Tensor:
    """``cat`` along another axis than the batch."""
    axis = dim % tensors[0].ndim - 1
    if axis < 0:
        return torch.cat(tensors)
    rows = torch.cat([t.movedim(0, -1).movedim(axis, 0) for t in tensors])
    return first(rows.movedim(0, axis))


def _stacked(tensors: list[Tensor], dim: int = 0) -> Tensor:
    """``stack`` along another axis than the batch."""
    if dim % (tensors[0].ndim + 1) == 0:
        return torch.stack(tensors)
    return _joined([t.unsqueeze(dim) for t in tensors], dim)


RULES: dict[Any, Callable[..., Tensor]] = {
    aten.bmm.default: _sum_of_products,
    aten.baddbmm.default: _sum_of_products_and,
    aten.sum.dim_IntList: _reduced(torch.sum),
    aten.mean.dim: _reduced(torch.mean),
    aten.cat.default: _joined,
    aten.stack.default: _stacked,
    aten.view.default: torch.reshape,
}
"""Operations that are done otherwise when the batch is the innermost axis."""

CONVERSIONS = {aten._to_copy.default, aten.to.dtype}
"""Elementwise operations that torch does not tag as such."""


class _Innermost(torch.fx.Interpreter):
    """Runs a graph of ``[B, ...]`` so that whatever it stores has the batch innermost.

    The compiler lays a result out as its logical shape says: operations on ``[B, ...]`` are done on
    ``[..., B]``, and looked at the other way round afterwards, which costs nothing.
    """

    def __init__(self, module: torch.fx.GraphModule, size: int) -> None:
        super().__init__(module)
        self._size = size

    def call_function(self, target: Any, args: Any, kwargs: Any) -> Any:
        """One operation."""
        tensors = [x for x in pytree.tree_leaves(args) if isinstance(x, Tensor)]
        rank = max((x.ndim for x in tensors), default=0)
        is_batched = any(x.ndim == rank and x.shape[0] == self._size for x in tensors if x.ndim)
        if not is_batched:
            return super().call_function(target, args, kwargs)
        if target in RULES:
            return RULES[target](*args, **kwargs)
        if rank > 1 and (torch.Tag.pointwise in target.tags or target in CONVERSIONS):

            def turned(x: Any) -> Any:
                if not isinstance(x, Tensor) or x.ndim == 0:
                    return x
                return x[(None,) * (rank - x.ndim)].movedim(0, -1)

            return first(target(*pytree.tree_map(turned, args), **kwargs))
        return super().call_function(target, args, kwargs)


class _Graph(torch.nn.Module):
    """One tick of a tile as a function of flat lists of tensors stored batch last."""

    def __init__(self, tick: Tick, spec: pytree.TreeSpec) -> None:
        super().__init__()
        self.tick, self.spec = tick, spec

    def forward(self, leaves: list[Tensor], uniform: Tensor, normal: Tensor, clock: Tensor) -> Any:
        here: Population = pytree.tree_unflatten([first(leaf) for leaf in leaves], self.spec)
        draw = Draw(first(uniform), first(normal))
        here, outcome = self.tick.live(here, draw, clock)
        world = here.worlds.world
        here = self.tick.turn(here, outcome, draw, clock)
        return [_stored(leaf) for leaf in pytree.tree_leaves(here)], outcome, _stored(world)


class _Turned(torch.nn.Module):
    """An exported graph, run by ``_Innermost``."""

    def __init__(self, module: torch.fx.GraphModule, size: int) -> None:
        super().__init__()
        self.module, self.size = module, size

    def forward(self, *arguments: Any) -> Any:
        flat = pytree.tree_leaves(arguments)
        return _Innermost(self.module, self.size).run(*flat)


@dataclass(frozen=True)
class Program:
    """A compiled tick for tiles of ``size`` learners.

    ``run`` takes the leaves of a ``Population`` (``last``), uniform ``[u, B]``, normal ``[m, B]``
    and the number of the tick (int64 ``[]``) as one list, and returns the new leaves, the outcomes
    ``[B]`` and the worlds ``[k, B]`` before new episodes began.  seconds: what compiling took, None
    for a program that was on disk.
    """

    run: Callable[[list[Tensor]], list[Tensor]]
    size: int
    spec: pytree.TreeSpec
    seconds: float | None


def cache_folder() -> Path:
    """Where programs are kept: ``EDTORCH_CACHE``, else ``edtorch`` in the user's cache folder."""
    named = os.environ.get("EDTORCH_CACHE")
    home = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(named) if named else Path(home) / "edtorch"


def _processor() -> str:
    """What the compiler builds for: programs of another processor would not run here."""
    flags = [platform.machine(), torch.backends.cpu.get_cpu_capability()]
    cpuinfo = Path("/proc/cpuinfo")
    if cpuinfo.exists():
        lines = cpuinfo.read_text(encoding="utf-8", errors="replace").splitlines()
        flags += [line for line in lines if line.startswith(("flags", "Features"))][:1]
    return "\n".join(flags)


def _source_files(tick: Tick) -> list[Path]:
    """The code that a tick is made of: edtorch, sims, and wherever else its parts come from."""
    parts = (tick.world.sim, tick.learner.model.features, tick.learner.policy, tick.learner.fit)
    packages = {type(part).__module__.partition(".")[0] for part in parts}
    files: set[Path] = set()
    for name in packages | {"edtorch", "sims"}:
        module = sys.modules.get(name)
        path = getattr(module, "__file__", None)
        if path is None:
            raise CannotCompile(f"the source of the package {name} cannot be found")
        file = Path(path)
        files |= set(file.parent.rglob("*.py")) if file.name == "__init__.py" else {file}
    return sorted(files)


class _Description(pickle.Pickler):
    """Pickles of equal objects that are equal; tensors by their numbers, dataclasses by fields."""

    def reducer_override(self, obj: Any) -> Any:
        """What stands for an object."""
        if is_dataclass(obj) and not isinstance(obj, type):
            return type(obj), tuple(getattr(obj, f.name) for f in fields(obj))
        if not isinstance(obj, Tensor):
            return NotImplemented
        numbers = obj.detach().cpu().contiguous().view(-1).view(torch.uint8).numpy().tobytes()
        return str, (f"{obj.dtype} {tuple(obj.shape)} {numbers.hex()}",)


def _key(tick: Tick, leaves: list[Tensor]) -> str:
    """A name for the program, of everything that it depends on."""
    content = hashlib.sha256()
    for file in _source_files(tick):
        content.update(file.read_bytes())
    description = io.BytesIO()
    _Description(description).dump(tick)
    content.update(description.getvalue())
    layout = [(tuple(leaf.shape), str(leaf.dtype), str(leaf.device)) for leaf in leaves]
    versions = (torch.__version__, platform.python_version(), repr(OPTIONS))
    content.update(repr((layout, versions, _processor())).encode())
    return content.hexdigest()[:32]


def _make(graph: _Graph, arguments: tuple[Any, ...], size: int, path: Path) -> None:
    """Export, turn, compile, and move the result into place."""
    with torch.no_grad(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        exported = torch.export.export(graph, arguments, strict=False).run_decompositions({})
        turned = _Turned(exported.module(), size)
        exported = torch.export.export(turned, arguments, strict=False).run_decompositions({})
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent) as folder:
            made = aoti_compile_and_package(
                exported, package_path=f"{folder}/tick.pt2", inductor_configs=OPTIONS
            )
            os.replace(made, path)


def compile_tick(tick: Tick, tile: Population, draw: Draw) -> Program:
    """The program of ``tick`` for populations of the size of ``tile``.

    draw: of any tick, for its shapes.  Raises CannotCompile.
    """
    check_compiler()
    leaves, spec = pytree.tree_flatten(tile)
    size = leaves[0].shape[0]
    stored = [_stored(leaf) for leaf in leaves]
    clock = torch.ones((), dtype=torch.int64, device=stored[0].device)
    arguments = (stored, _stored(draw.uniform), _stored(draw.normal), clock)
    try:
        path = cache_folder() / f"tick-{_key(tick, stored)}.pt2"
    except (pickle.PicklingError, AttributeError, TypeError) as error:
        raise CannotCompile(f"the parts of this learner cannot be pickled: {error}") from error
    seconds = None
    if not path.exists():
        began = time.monotonic()
        try:
            _make(_Graph(tick, spec), arguments, size, path)
        except OSError:
            raise
        except Exception as error:
            first_line = str(error).strip().partition("\n")[0]
            raise CannotCompile(f"{type(error).__name__}: {first_line}") from error
        seconds = time.monotonic() - began
    model = aoti_load_package(str(path), run_single_threaded=True)
    return Program(model.loader.boxed_run, size, spec, seconds)
