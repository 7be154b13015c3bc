"""A public name of a module means one thing in all of edtorch."""

from __future__ import annotations

import ast
from collections import defaultdict
from pathlib import Path

import edtorch

ENTRY_POINTS = {"main"}


def _public(path: Path) -> set[str]:
    """The classes, functions and constants that a module defines."""
    found: set[str] = set()
    for node in ast.parse(path.read_text()).body:
        if isinstance(node, ast.ClassDef | ast.FunctionDef):
            found.add(node.name)
        targets = node.targets if isinstance(node, ast.Assign) else []
        targets = [node.target] if isinstance(node, ast.AnnAssign) else targets
        found |= {target.id for target in targets if isinstance(target, ast.Name)}
    return {name for name in found if not name.startswith("_")} - {"logger"} - ENTRY_POINTS


def test_no_public_name_is_defined_twice() -> None:
    root, modules = Path(edtorch.__file__).parent, defaultdict[str, list[str]](list)
    # Kernels are text that is not imported: their functions are called as what they compute.
    for path in sorted(path for path in root.rglob("*.py") if path.parent.name != "kernels"):
        for name in _public(path):
            modules[name].append(str(path.relative_to(root)))
    assert {name: places for name, places in modules.items() if len(places) > 1} == {}
