"""Kernels as modules: Python text, compiled by numba, kept on disk.

A module's name is a hash of everything that it is made of: its text, what its maker says that it
depends on beside it, numba, and the processor.  So a stale or foreign module is never found, and no
two modules share the name of a compiled symbol.
"""

from __future__ import annotations

import hashlib
import importlib
import importlib.metadata
import logging
import os
import platform
import shutil
import sys
import types
from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import filelock

from edtorch.errors import Unavailable

logger = logging.getLogger("edtorch")

LEAST_NUMBA = (0, 65)
"""The first version of numba that is tested."""


def cache_folder() -> Path:
    """Where modules are kept: ``EDTORCH_CACHE``, else ``edtorch`` in the user's cache folder."""
    named = os.environ.get("EDTORCH_CACHE")
    home = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(named) if named else Path(home) / "edtorch"


def numba() -> Any:
    """The module numba, with SVML off: its sines differ in the last digit from lane to lane.

    Raises Unavailable where it is missing, too old, or has been set up otherwise.
    """
    os.environ.setdefault("NUMBA_DISABLE_INTEL_SVML", "1")
    try:
        found: Any = importlib.import_module("numba")
    except ImportError as error:
        raise Unavailable(f"numba cannot be imported ({error}): pip install numba") from error
    version = tuple(int(part) for part in found.__version__.split(".")[:2])
    if version < LEAST_NUMBA:
        least = ".".join(map(str, LEAST_NUMBA))
        raise Unavailable(f"numba {found.__version__}: expected {least} or newer")
    if found.config.DISABLE_JIT:
        raise Unavailable("NUMBA_DISABLE_JIT is set: unset it")
    if found.config.USING_SVML:
        raise Unavailable(
            "numba was imported before edtorch with Intel's SVML: set NUMBA_DISABLE_INTEL_SVML=1"
        )
    return found


def _machine() -> str:
    """What a module is compiled by and for."""
    from llvmlite import binding

    cpu = f"{binding.get_host_cpu_name()} {binding.get_host_cpu_features().flatten()}"
    versions = (numba().__version__, importlib.metadata.version("llvmlite"))
    return f"{versions} {platform.python_version()} {platform.machine()} {cpu}"


@dataclass(frozen=True)
class ModuleSource:
    """text: of the module; key: what else it is made of; parts: what it finds beside its own."""

    text: str
    key: str
    parts: Mapping[str, Any]

    @property
    def name(self) -> str:
        """Of the module, and of its folder."""
        content = "\n".join((self.text, self.key, _machine()))
        return f"edtorch_{hashlib.sha256(content.encode()).hexdigest()[:24]}"


def load_kernel(
    source: ModuleSource, entries: Mapping[str, Sequence[object]], what: str
) -> list[Any]:
    """Functions of a module, each compiled for arguments like these; from disk if they were
    compiled before, on this machine or another process of it.

    entries: their names, and the arguments; what: they are called in messages.  Raises Unavailable
    if they do not compile.
    """
    found = numba()
    signatures = {name: tuple(map(found.typeof, given)) for name, given in entries.items()}
    folder = cache_folder() / "native" / source.name
    try:
        with _locked(folder):
            return _compiled(source, signatures, folder, what)
    except OSError as error:
        logger.warning(
            "EDTORCH_CACHE=%s: cannot be used (%s); kernels are compiled in every process",
            cache_folder(),
            error.strerror or error,
        )
        return _compiled(source, signatures, None, what)


@contextmanager
def _locked(folder: Path) -> Iterator[None]:
    """One process at a time: the others wait, and find what it has compiled."""
    folder.mkdir(parents=True, exist_ok=True)
    with filelock.FileLock(folder / "lock"):
        yield


def _compiled(
    source: ModuleSource, signatures: Mapping[str, tuple[Any, ...]], folder: Path | None, what: str
) -> list[Any]:
    sums = None if folder is None else folder / "sums"
    if folder is not None and not _is_whole(folder):
        _clear(folder)
    if folder is None or not (folder / "sums").exists():
        logger.info("compiling %s (once; up to two minutes)...", what)
    try:
        module = _module(source, folder, signatures)
        functions = [module.__dict__[name] for name in signatures]
        for function, signature in zip(functions, signatures.values(), strict=True):
            function.compile(signature)
    except OSError:
        raise
    except Exception as error:
        # Whatever numba cannot type or lower, and a damaged index: many kinds of exceptions.
        raise Unavailable(f"{what}: does not compile: {_cause(error)}") from error
    if folder is not None and sums is not None and not sums.exists():
        sums.write_text(_sums(folder), encoding="utf-8")
    return functions


def _cause(error: Exception) -> str:
    """The one line of numba's pages that says what is wrong."""
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    causes = [
        line for line in lines if "Error: " in line or line.startswith(("Untyped", "Unknown"))
    ]
    return (causes or lines or [type(error).__name__])[-1]


def _sums(folder: Path) -> str:
    files = sorted(path for path in folder.rglob("*") if path.suffix in (".py", ".nbi", ".nbc"))
    return "\n".join(f"{f.name} {hashlib.sha256(f.read_bytes()).hexdigest()}" for f in files)


def _is_whole(folder: Path) -> bool:
    """Whether the files are those that were written."""
    sums = folder / "sums"
    return sums.exists() and sums.read_text(encoding="utf-8") == _sums(folder)


def _clear(folder: Path) -> None:
    for path in folder.iterdir():
        if path.is_dir():
            shutil.rmtree(path)
        elif path.name != "lock":
            path.unlink()


def _module(
    source: ModuleSource, folder: Path | None, entries: Collection[str]
) -> types.ModuleType:
    """Only ``entries`` can be called from Python: the wrappers of the others would take as long to
    compile as they do."""
    name = source.name
    if name in sys.modules:
        return sys.modules[name]
    jit = numba().njit
    module = types.ModuleType(name)
    module.__dict__.update(source.parts)
    module.__dict__["inner"] = jit(error_model="numpy", forceinline=True)

    def outer(function: Callable[..., Any]) -> Any:
        inside = function.__name__ not in entries
        options = {"no_cpython_wrapper": inside, "no_cfunc_wrapper": True}
        kept = folder is not None
        return jit(error_model="numpy", nogil=True, cache=kept, **options)(function)

    module.__dict__["outer"] = outer
    file = Path(f"<{name}>")
    if folder is not None:
        file = folder / f"{name}.py"
        if not file.exists():
            file.write_text(source.text, encoding="utf-8")
    sys.modules[name] = module
    try:
        exec(compile(source.text, str(file), "exec"), module.__dict__)
    except BaseException:
        del sys.modules[name]
        raise
    return module
