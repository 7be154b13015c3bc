"""Functions of a population as compiled programs, made by Inductor ahead of time, kept on disk.

A program is made of the same pure functions that run uncompiled (``edtorch.run.tick``), for a
batch of a fixed size that is the innermost axis of everything it stores
(``edtorch.compiled.innermost``).
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
from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from pathlib import Path
from typing import Any

import torch
from torch import Tensor
from torch.utils import _pytree as pytree

from edtorch.compiled.compilation import CannotCompile, check_compiler
from edtorch.compiled.innermost import Turned, first, stored
from edtorch.learner.learner import Learner
from edtorch.learner.schedule import ALWAYS
from edtorch.run.random import Draw
from edtorch.run.tick import Population, Tick

OPTIONS = {"memory_planning": True, "cpp.threads": 1}
"""Of the compiler: one allocation for all intermediate results of a tick; one thread."""


class _Graph(torch.nn.Module):
    """One tick of a tile as a function of flat lists of tensors stored batch last."""

    def __init__(self, tick: Tick, spec: pytree.TreeSpec, *, improve: bool) -> None:
        super().__init__()
        self.tick, self.spec, self.improve = tick, spec, improve

    def forward(self, leaves: list[Tensor], uniform: Tensor, normal: Tensor, clock: Tensor) -> Any:
        here: Population = pytree.tree_unflatten([first(leaf) for leaf in leaves], self.spec)
        draw = Draw(first(uniform), first(normal))
        here, _, outcome = self.tick.live(here, draw, clock, improve=self.improve)
        world, earned = here.worlds.world, here.worlds.earned
        here = self.tick.turn(here, outcome, draw, clock)
        return [stored(leaf) for leaf in pytree.tree_leaves(here)], outcome, stored(world), earned


@dataclass(frozen=True)
class Program:
    """A compiled function of a batch of ``size``.

    run: takes one flat list of tensors, stored batch last, and returns one; seconds: what compiling
    took, None for a program that was on disk.
    """

    run: Callable[[list[Tensor]], list[Tensor]]
    size: int
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


def _source_files(parts: Sequence[object]) -> list[Path]:
    """The code of a function: edtorch, sims, and wherever else its ``parts`` come from."""
    packages = {type(part).__module__.partition(".")[0] for part in parts}
    files: set[Path] = set()
    for name in packages | {"edtorch", "sims"}:
        path = getattr(sys.modules.get(name), "__file__", None)
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
        if isinstance(obj, torch.nn.Module):
            # Modules keep names in sets, which come out in another order in every process.
            state = vars(obj).items()
            return type(obj), (), {k: sorted(v) if isinstance(v, set) else v for k, v in state}
        if not isinstance(obj, Tensor):
            return NotImplemented
        numbers = obj.detach().cpu().contiguous().view(-1).view(torch.uint8).numpy().tobytes()
        return str, (f"{obj.dtype} {tuple(obj.shape)} {numbers.hex()}",)


def program_name(function: object, parts: Sequence[object], tensors: Sequence[Tensor]) -> str:
    """A name for the program of ``function``, made of everything that it depends on."""
    content = hashlib.sha256()
    for file in _source_files(parts):
        content.update(file.read_bytes())
    description = io.BytesIO()
    pickler = _Description(description)
    # Without a memo: whether two equal strings are one object depends on how a module was loaded.
    pickler.fast = True
    try:
        pickler.dump(function)
    except (pickle.PicklingError, AttributeError, TypeError, RecursionError) as error:
        raise CannotCompile(f"its parts cannot be pickled ({error})") from error
    content.update(description.getvalue())
    layout = [(tuple(x.shape), str(x.dtype), str(x.device)) for x in tensors]
    versions = (torch.__version__, platform.python_version(), repr(OPTIONS))
    content.update(repr((layout, versions, _processor())).encode())
    return content.hexdigest()[:32]


def _make(graph: torch.nn.Module, arguments: tuple[Any, ...], size: int, path: Path) -> None:
    """Export, turn, compile, and move the result into place."""
    # The compiler takes seconds to import; only runs that compile pay for it.
    from torch._inductor import aoti_compile_and_package

    with torch.no_grad(), warnings.catch_warnings():
        warnings.simplefilter("ignore")
        exported = torch.export.export(graph, arguments, strict=False).run_decompositions({})
        turned = Turned(exported.module(), size)
        exported = torch.export.export(turned, arguments, strict=False).run_decompositions({})
        path.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=path.parent) as folder:
            # A copy: torch writes into it, and the options are part of every program's name.
            made = aoti_compile_and_package(
                exported, package_path=f"{folder}/tick.pt2", inductor_configs=dict(OPTIONS)
            )
            os.replace(made, path)


def compile_graph(
    graph: torch.nn.Module,
    function: object,
    parts: Sequence[object],
    arguments: tuple[Any, ...],
    size: int,
) -> Program:
    """The program of ``graph``, from disk if it has been made before.

    graph: a module that takes ``arguments``, tensors (and lists of them) stored batch last, and
    returns the like; function: what it computes, parts: the objects whose code it runs, both to
    know it again.  Raises CannotCompile.
    """
    from torch._inductor import aoti_load_package

    check_compiler()
    tensors = pytree.tree_leaves(arguments)
    path = cache_folder() / f"{program_name(function, parts, tensors)}.pt2"
    seconds = None
    if not path.exists():
        began = time.monotonic()
        try:
            _make(graph, arguments, size, path)
        except OSError:
            raise
        except Exception as error:
            # Whatever the exporter or the compiler cannot do: many kinds of exceptions.
            line = str(error).strip().partition("\n")[0]
            raise CannotCompile(f"{type(error).__name__}: {line}") from error
        seconds = time.monotonic() - began
    try:
        model = aoti_load_package(str(path), run_single_threaded=True)
    except RuntimeError as error:
        raise CannotCompile(f"{path}: not a program that runs here; remove it") from error
    return Program(model.loader.boxed_run, size, seconds)


def compile_tick(tick: Tick, tile: Population, draw: Draw, *, improve: bool) -> Program:
    """The program of ``tick`` for populations of the size of ``tile``, one that improves policies
    or one that leaves them as they are.

    It takes the leaves of a ``Population``, uniform ``[u, B]``, normal ``[m, B]`` and the number of
    the tick (int64 ``[]``), and returns the new leaves, the outcomes ``[B]``, and the worlds
    ``[k, B]`` and returns ``[B]`` before new episodes began.  draw: of any tick, for its shapes.
    Raises CannotCompile.
    """
    learner = tick.learner
    if not isinstance(learner, Learner):
        raise CannotCompile(f"{type(learner).__name__} asks tensors for numbers")
    leaves, spec = pytree.tree_flatten(tile)
    clock = torch.ones((), dtype=torch.int64, device=leaves[0].device)
    arguments = (
        [stored(leaf) for leaf in leaves],
        stored(draw.uniform),
        stored(draw.normal),
        clock,
    )
    parts = (tick.world.sim, learner.model, learner.policy, learner.fit, learner.step_rule)
    graph = _Graph(tick, spec, improve=improve)
    # When policies are improved is not the program's business.
    function = (replace(tick, schedule=ALWAYS), improve)
    return compile_graph(graph, function, parts, arguments, leaves[0].shape[0])
