"""When nothing can be compiled, and what is said then."""

from __future__ import annotations

import logging

import pytest
import torch

from edtorch.compiled.compilation import CannotCompile, check_compiler, compiled


def test_without_a_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CXX", "no-such-compiler")
    with pytest.raises(CannotCompile, match=r"no C\+\+ compiler found \(no-such-compiler\): insta"):
        check_compiler()


def test_with_an_untried_torch(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(torch, "__version__", "2.6.0+cpu")
    with pytest.raises(CannotCompile, match=r"torch 2\.6\.0\+cpu is outside .* 2\.13 up to"):
        check_compiler()


def test_where_torch_cannot_call_the_compiler(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CXX", "sh")  # any program will do
    monkeypatch.setattr(torch, "__file__", "/home/a user/torch/__init__.py")
    with pytest.raises(CannotCompile, match="path with a space, '/home/a user/torch"):
        check_compiler()


def test_without_a_compiler_functions_stay_as_they_are(
    monkeypatch: pytest.MonkeyPatch, caplog: pytest.LogCaptureFixture
) -> None:
    monkeypatch.setenv("CXX", "no-such-compiler")
    with caplog.at_level(logging.WARNING, "edtorch"):
        assert compiled(len, mode="auto") is len
    assert "not compiled" in caplog.text
    with pytest.raises(CannotCompile):
        compiled(len, mode="on")
    assert compiled(len, mode="off") is len
