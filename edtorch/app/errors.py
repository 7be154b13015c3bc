"""From exceptions to one clear line: which key, which value, what was expected."""

from __future__ import annotations

import difflib
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

from hydra.errors import HydraException
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from edtorch.checkpoint import FileProblem


class ConfigError(Exception):
    """Bad configuration; the message names the full key, the value and what was expected."""


class NotARun(Exception):
    """A folder that was given as a run is none."""


@contextmanager
def under(group: str) -> Iterator[None]:
    """Turn a constructor's ``ValueError("alpha=-1: ...")`` into ``step.alpha=-1: ...``."""
    try:
        yield
    except (ValueError, TypeError) as error:
        text = str(error)
        names_argument = re.match(r"\w+(\[[^]]*\])?=", text) is not None
        raise ConfigError(f"{group}.{text}" if names_argument else f"{group}: {text}") from error


def _given(key: str) -> str:
    """The override as the user typed it, else the key alone."""
    for argument in sys.argv[1:]:
        if argument.lstrip("+~").split("=", 1)[0] == key:
            return argument
    return key


def _unknown_key(error: OmegaConfBaseException, key: str) -> str:
    parent = error.parent_node
    known = sorted(str(k) for k in parent) if isinstance(parent, DictConfig) else []
    last = key.rsplit(".", 1)[-1]
    close = difflib.get_close_matches(last, known, n=1)
    prefix = key[: -len(last)]
    hint = f"; did you mean {prefix}{close[0]}?" if close else ""
    listed = f"; {prefix.rstrip('.') or 'the configuration'} has {', '.join(known)}" if known else ""
    return f"{_given(key)}: unknown key{hint}{listed}"


def _from_omegaconf(error: OmegaConfBaseException) -> str:
    key = error.full_key or str(error.key)
    first = str(error).splitlines()[0]
    if "is not in struct" in first or "not in '" in first:
        return _unknown_key(error, key)
    if first.startswith("Missing mandatory value"):
        return f"{key}: no value given; set it with {key}=..."
    converted = re.match(r"Value '(.*)' .*could not be converted to (\w+)", first)
    if converted:
        return f"{key}={converted[1]}: expected {converted[2].lower()}"
    return f"{_given(key)}: {first}"


def one_line(error: BaseException) -> str:
    """The message of an expected error as one line."""
    chain: list[BaseException] = [error]
    while (cause := chain[-1].__cause__) is not None:
        chain.append(cause)
    for link in reversed(chain):
        if isinstance(link, OmegaConfBaseException):
            return _from_omegaconf(link)
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    if isinstance(error, HydraException):
        lines = [line for line in lines if not line.startswith(("Config search path", "See http"))]
        return re.sub(r"\s+", " ", "; ".join(lines)).replace(":;", ":")
    return " ".join(lines) or type(error).__name__


EXPECTED = (ConfigError, NotARun, FileProblem, HydraException, OmegaConfBaseException, OSError)
"""What a user can cause; anything else is a defect of ours and keeps its traceback."""


def guarded(command: str, run: Callable[[], None]) -> int:
    """Run a command; report what goes wrong as one line on stderr and as the exit status."""
    try:
        run()
    except KeyboardInterrupt:
        print(f"{command}: interrupted", file=sys.stderr)
        return 130
    except EXPECTED as error:
        if "debug=true" in (argument.lower() for argument in sys.argv[1:]):
            raise
        print(f"{command}: {one_line(error)}", file=sys.stderr)
        return 1
    return 0


def no_such_folder(folder: Path, wanted: str) -> NotARun:
    """The error for a folder that lacks ``wanted``."""
    state = f"has no {wanted}" if folder.is_dir() else "does not exist"
    return NotARun(f"run={folder}: expected the folder of a run, but it {state}")
