"""The packages installed beside this one, whatever folders of their names lie on the path."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def claim(name: str) -> None:
    """Let ``import name`` mean the package beside this one, also where a folder of the user's that
    has the same name comes first on the path.

    Raises ImportError if that folder has been imported already.
    """
    ours = ROOT / name
    loaded = sys.modules.get(name)
    if loaded is not None:
        places = [str(place) for place in getattr(loaded, "__path__", [])]
        if ours not in [Path(place).resolve() for place in places]:
            raise ImportError(
                f"{places[0] if places else name}: expected no other package called {name}, which"
                " edtorch has as well; rename it, or import edtorch first"
            )
        return
    spec = importlib.util.spec_from_file_location(
        name, ours / "__init__.py", submodule_search_locations=[str(ours)]
    )
    if spec is None or spec.loader is None or not (ours / "__init__.py").is_file():
        raise ImportError(f"{ours}: expected edtorch's package {name}; install edtorch again")
    module = importlib.util.module_from_spec(spec)
    sys.modules[name] = module
    try:
        spec.loader.exec_module(module)
    except BaseException:
        del sys.modules[name]
        raise


def hidden(name: str) -> Path | None:
    """A folder on the path that cannot be imported as ``name``, which is a package beside this."""
    folders = (Path(place or ".").resolve() / name for place in sys.path)
    return next((f for f in folders if f.is_dir() and f != ROOT / name), None)
