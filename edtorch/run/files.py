"""Files that are written whole or not at all.

They are written beside their place and moved there, so that no reader ever sees half of one.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from pathlib import Path


class FileProblem(ValueError):
    """A file is not what it should be; the message names it and says what was expected."""


def write_atomically(path: Path, write: Callable[[Path], object]) -> None:
    """Call ``write`` with a path beside ``path``, then move the result into place.

    Whatever happens to the process or the machine, ``path`` is what it was or what it is to be.
    """
    partial = path.with_name(f".{path.name}.partial")
    try:
        write(partial)
        sync(partial)
        os.replace(partial, path)
        sync(path.parent)
    finally:
        partial.unlink(missing_ok=True)


def sync(path: Path) -> None:
    """Have the disk hold what was written to a file, or which files a folder has."""
    try:
        descriptor = os.open(path, os.O_RDONLY)
    except PermissionError:
        return  # Windows opens no folders, and needs no sync of them
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def write_text(path: Path, text: str) -> None:
    """Write a text file atomically."""
    write_atomically(path, lambda partial: partial.write_text(text, encoding="utf-8"))
