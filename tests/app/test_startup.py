"""What starting does not load, and what it finds whatever is on the path."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

HEAVY = (
    "torch._inductor",
    "torch._dynamo",
    "matplotlib",
    "tensorboard",
    "stable_baselines3",
    "sklearn",
    "pybullet",
    "numba",
    "PIL",
)
LOADED = f"print('loaded:', *(name for name in {HEAVY!r} if name in sys.modules), file=sys.stderr)"
REFUSED = f"""
import sys, edtorch, sims.bicycle
{LOADED}
from edtorch.app.train import main
sys.argv = ["edtorch-train", "step.alpa=1"]
try:
    main()
except SystemExit as end:
    print("status", end.code, file=sys.stderr)
{LOADED}
"""


def _errors(code: str, *, folder: Path, path: Path | None = None) -> list[str]:
    """Lines of stderr of a process that runs ``code`` in ``folder``."""
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    if path is not None:
        environment["PYTHONPATH"] = str(path)
    done = subprocess.run(
        [sys.executable, "-c", code], cwd=folder, env=environment, capture_output=True, text=True
    )
    return done.stderr.splitlines()


@pytest.mark.oracle
def test_importing_and_refusing_a_key_load_nothing_heavy(tmp_path: Path) -> None:
    imported, line, status, loaded = _errors(REFUSED, folder=tmp_path)
    assert imported == "loaded:"
    assert line.startswith("edtorch-train: step.alpa=1: unknown key; did you mean step.alpha?")
    assert (status, loaded) == ("status 1", "loaded:")
    assert list(tmp_path.iterdir()) == []


@pytest.fixture
def shadow(tmp_path: Path) -> Path:
    """A folder with packages of the user's called like edtorch's."""
    for name in ("conf", "sims"):
        (tmp_path / "path" / name).mkdir(parents=True)
        (tmp_path / "path" / name / "__init__.py").write_text("")
    (tmp_path / "path" / "sims" / "mine.py").write_text("class Cart: ...\n")
    return tmp_path / "path"


@pytest.mark.oracle
def test_folders_of_the_same_names_break_nothing(tmp_path: Path, shadow: Path) -> None:
    code = (
        "import sys, edtorch, gymnasium\n"
        "from edtorch.app.build import build\n"
        "from edtorch.app.compose import compose\n"
        "build(compose(['experiment=bicycle', 'compute.native=off']))\n"
        "gymnasium.make('edtorch/Bicycle-v0').reset()\n"
        "try:\n"
        "    build(compose(['domain._target_=sims.mine.Cart']))\n"
        "except Exception as error:\n"
        "    print(error, file=sys.stderr)\n"
    )
    *_, line = _errors(code, folder=tmp_path, path=shadow)
    assert line.startswith("domain._target_=sims.mine.Cart: expected the full name of a class")
    assert line.endswith(
        f"{shadow / 'sims'} is hidden by edtorch's package of that name, rename it)"
    )


@pytest.mark.oracle
def test_another_package_called_sims_is_named(tmp_path: Path, shadow: Path) -> None:
    *_, last = _errors("import sims, edtorch", folder=tmp_path, path=shadow)
    assert last.startswith(f"ImportError: {shadow / 'sims'}: expected no other package called sims")
