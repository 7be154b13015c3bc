"""Kernels on disk: found again, told apart, and done without where there is trouble."""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from edtorch.compiled import ModuleSource, cache_folder, load_kernel
from edtorch.compiled import numba as checked_numba
from edtorch.errors import Unavailable

DOUBLE = (
    "@inner\ndef twice(x):\n    return 2.0 * x\n\n@outer\ndef entry(x):\n    return twice(x[0])\n"
)
GIVEN = (np.array([1.5]),)


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("EDTORCH_CACHE", str(tmp_path / "cache"))
    before = set(sys.modules)
    yield tmp_path / "cache"
    for name in set(sys.modules) - before:
        if name.startswith("edtorch_"):
            del sys.modules[name]


def forgotten(source: ModuleSource) -> None:
    """As in a new process."""
    sys.modules.pop(source.name, None)


def loaded(source: ModuleSource) -> Any:
    return load_kernel(source, {"entry": GIVEN}, "an example")[0]


def test_a_kernel_is_found_on_disk(caplog: pytest.LogCaptureFixture) -> None:
    source = ModuleSource(DOUBLE, "", {})
    caplog.set_level("INFO", "edtorch")
    assert loaded(source)(*GIVEN) == 3.0 and "compiling an example" in caplog.text
    caplog.clear()
    forgotten(source)
    again = loaded(source)
    assert again(*GIVEN) == 3.0 and not caplog.text
    assert sum(again.stats.cache_hits.values()) == 1


def test_other_text_key_or_machine_is_another_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    names = {ModuleSource(DOUBLE, key, {}).name for key in ("", "a")}
    names.add(ModuleSource(DOUBLE.replace("2.0", "3.0"), "", {}).name)
    monkeypatch.setattr("llvmlite.binding.get_host_cpu_name", lambda: "another")
    names.add(ModuleSource(DOUBLE, "", {}).name)
    assert len(names) == 4


def test_a_damaged_file_is_compiled_again(own_cache: Path) -> None:
    source = ModuleSource(DOUBLE, "", {})
    loaded(source)
    for suffix in ("nbc", "nbi", "py"):
        (file,) = own_cache.rglob(f"*.{suffix}")
        file.write_bytes(b"\0" * len(file.read_bytes()))
        forgotten(source)
        assert loaded(source)(*GIVEN) == 3.0


def test_a_cache_that_cannot_be_used_costs_a_warning(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    file = tmp_path / "file"
    file.write_text("")
    monkeypatch.setenv("EDTORCH_CACHE", str(file))
    assert loaded(ModuleSource(DOUBLE, "", {}))(*GIVEN) == 3.0
    assert f"EDTORCH_CACHE={file}: cannot be used" in caplog.text


def test_processes_wait_for_one_another(own_cache: Path) -> None:
    script = (
        "import logging, numpy\n"
        "logging.basicConfig(level='INFO')\n"
        "from edtorch.compiled import ModuleSource, load_kernel\n"
        f"source = ModuleSource({DOUBLE!r}, '', {{}})\n"
        "[kernel] = load_kernel(source, {'entry': (numpy.array([1.5]),)}, 'an example')\n"
        "print(kernel(numpy.array([1.5])))\n"
    )
    command = [sys.executable, "-c", script]
    both = [
        subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
        for _ in range(2)
    ]
    told = [process.communicate(timeout=120) for process in both]
    assert [out.strip() for out, _ in told] == ["3.0", "3.0"]
    assert sum("compiling an example" in err for _, err in told) == 1


def test_what_does_not_compile_is_named() -> None:
    text = "@outer\ndef entry(x):\n    return unheard_of(x)\n"
    with pytest.raises(Unavailable, match=r"an example: does not compile: .*unheard_of"):
        loaded(ModuleSource(text, "", {}))


@pytest.mark.parametrize(
    ("attribute", "value", "said"),
    [
        ("__version__", "0.5.1", r"numba 0\.5\.1: expected 0\.\d+ or newer"),
        ("config.DISABLE_JIT", 1, "NUMBA_DISABLE_JIT is set"),
        ("config.USING_SVML", True, "NUMBA_DISABLE_INTEL_SVML=1"),
    ],
)
def test_numba_must_be_usable(
    attribute: str, value: object, said: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(f"numba.{attribute}", value)
    with pytest.raises(Unavailable, match=said):
        checked_numba()


def test_numba_may_be_missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "numba", None)
    with pytest.raises(Unavailable, match="pip install numba"):
        checked_numba()


def test_modules_lie_where_the_user_says(own_cache: Path) -> None:
    assert cache_folder() == own_cache
    loaded(ModuleSource(DOUBLE, "", {}))
    assert {path.parts[len(own_cache.parts)] for path in own_cache.rglob("*")} == {"native"}


def test_svml_is_off() -> None:
    assert not checked_numba().config.USING_SVML
