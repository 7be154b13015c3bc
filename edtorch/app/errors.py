"""From exceptions to one clear line: which key, which value, what was expected."""

from __future__ import annotations

import difflib
import os
import re
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import fields
from pathlib import Path

from hydra.errors import HydraException, MissingConfigException, OverrideParseException
from omegaconf.errors import OmegaConfBaseException

from edtorch.app.folders import FootprintCallback
from edtorch.app.groups import Whole
from edtorch.app.launchers import not_installed
from edtorch.app.overrides import given, given_name, typed
from edtorch.app.signals import Interrupted
from edtorch.run.files import FileProblem
from sims.base import SimulatorFailed


class ConfigError(Exception):
    """Bad configuration; the message names the full key, the value and what was expected."""


class NotARun(Exception):
    """A folder that was given as a run is none."""


class Refused(BaseException):
    """The one line for the user, on its way out of Hydra.

    No ``Exception``: Hydra prints lines of its own for those of jobs, and warns of callbacks'.
    """


EXPECTED = (
    ConfigError,
    NotARun,
    FileProblem,
    SimulatorFailed,
    HydraException,
    OmegaConfBaseException,
    OSError,
)
"""What a user can cause; anything else is a defect of ours and keeps its traceback."""


_SCALARS = {f.name for f in fields(Whole)}
_OPTION = re.compile(r"(?!(null|true|false)$)[A-Za-z_][\w./-]*|\[.*\]")
_SEARCHED = ("Config search path", "provider=", "See http")


_ARGUMENT = re.compile(r"\w+(\[[^]]*\]|\.\w+( \w+)?)*=|\w+(\[[^]]*\]|\.\w+)+: ")
"""How a message that names an argument begins, or an entry of one (of a row: ``cos angle``)."""


@contextmanager
def under(group: str) -> Iterator[None]:
    """Turn a constructor's ``ValueError("alpha=-1: ...")`` into ``step.alpha=-1: ...``; a message
    that begins with ``group`` stays as it is."""
    try:
        yield
    except (ValueError, TypeError) as error:
        text = " ".join(str(error).split())
        if not text.startswith((f"{group}.", f"{group}=", f"{group}: ")):
            text = f"{group}.{text}" if _ARGUMENT.match(text) else f"{group}: {text}"
        raise ConfigError(text) from error


def unknown_key(given: str, key: str, known: list[str]) -> str:
    """The message for a key not in ``known``, its siblings; given: the key with its value."""
    parent, _, last = key.rpartition(".")
    close = difflib.get_close_matches(last, known, n=1)
    hint = f"; did you mean {parent}{'.' if parent else ''}{close[0]}?" if close else ""
    listed = f"; {parent or 'the configuration'} has {', '.join(known)}" if known else ""
    return f"{given}: unknown key{hint}{listed}"


def _from_omegaconf(error: OmegaConfBaseException) -> str:
    key = error.full_key or str(error.key)
    first = str(error).splitlines()[0]
    if "is not in struct" in first:
        return f"{given(key) or key}: unknown key"
    if first.startswith("Missing mandatory value"):
        return f"{key}: no value given; set it with {key}=..."
    return f"{given(key) or key}: {first}"


def one_line(error: BaseException) -> str:
    """The message of an expected error as one line."""
    chain: list[BaseException] = [error]
    while (cause := chain[-1].__cause__) is not None:
        chain.append(cause)
    if isinstance(error, HydraException | OmegaConfBaseException):
        for link in reversed(chain):
            if isinstance(link, OmegaConfBaseException):
                return _from_omegaconf(link)
    lines = [line.strip() for line in str(error).splitlines() if line.strip()]
    if isinstance(error, ConfigError):
        # By the name that the user typed, where the setting had another one before.
        key, equals, rest = lines[0].partition("=")
        lines[0] = f"{given_name(key)}{equals}{rest}"
    if isinstance(error, MissingConfigException):
        group, _, option = (error.missing_cfg_file or "").rpartition("/")
        if group == "hydra/launcher" and (line := not_installed(option)):
            return line
        if error.options is not None:
            return f"{group}={option}: expected one of {', '.join(error.options)}"
    if isinstance(error, OverrideParseException):
        return f"{error.override}: expected KEY=VALUE ({'; '.join(lines[1:2])})"
    if isinstance(error, HydraException):
        lines = [line for line in lines if not line.startswith(_SEARCHED)]
    if isinstance(error, OSError) and error.filename is not None:
        return f"{error.filename}: {error.strerror}"
    return " ".join(" ".join(lines).split()) or type(error).__name__


@contextmanager
def refusing() -> Iterator[None]:
    """Inside a job: what a user can cause leaves it as ``Refused``, or as it is when debugging."""
    try:
        yield
    except EXPECTED as error:
        if debugging():
            raise
        raise Refused(one_line(error)) from error


@contextmanager
def _errors_unchanged() -> Iterator[None]:
    """Have Hydra hand on the errors of composing instead of printing them and leaving."""
    name = "HYDRA_FULL_ERROR"
    before = os.environ.get(name)
    os.environ[name] = "1"
    try:
        yield
    finally:
        if before is None:
            del os.environ[name]
        else:
            os.environ[name] = before


def debugging() -> bool:
    """Whether the user has asked for tracebacks."""
    return any(re.fullmatch(r"\+*debug=(true|yes|on|y|1)", a.lower()) for a in typed())


def _odd_choice(error: ValueError) -> str:
    """Hydra's complaint about ``step=3``, which names neither key nor value."""
    for argument in typed():
        key, equals, value = argument.partition("=")
        if equals and "." not in key and key not in _SCALARS and not _OPTION.fullmatch(value):
            return f"{argument}: expected KEY=VALUE with the name of an option of a group"
    return one_line(error)


def _message(error: BaseException) -> str:
    footprint = FootprintCallback.footprint
    if isinstance(error, HydraException):
        return one_line(error)
    if isinstance(error, OSError) and footprint is not None:
        # Outside a job only Hydra writes: the output folder.
        return (
            f"{footprint.key}={footprint.wanted}: expected a folder to write to ({error.strerror})"
        )
    return _odd_choice(error) if type(error) is ValueError else one_line(error)


def find_here() -> None:
    """Let a ``_target_`` name modules of the current folder.  It comes last on the path, so that
    nothing in it hides anything else."""
    here = os.getcwd()
    if here not in sys.path:
        sys.path.append(here)


def guarded(command: str, run: Callable[[], None]) -> int:
    """Run a command; report what goes wrong as one line on stderr and as the exit status."""
    find_here()
    FootprintCallback.footprint = None
    try:
        with _errors_unchanged():
            run()
    except KeyboardInterrupt as error:
        left = f"; {error}" if isinstance(error, Interrupted) else ""
        print(f"{command}: interrupted{left}", file=sys.stderr)
        return 130
    except (Refused, ValueError, *EXPECTED) as error:
        # A ValueError from before any folder is Hydra's, from composing; later ones are defects.
        if debugging() or (type(error) is ValueError and FootprintCallback.footprint is not None):
            raise
        print(f"{command}: {_message(error)}", file=sys.stderr)
        return 1
    finally:
        if FootprintCallback.footprint is not None:
            FootprintCallback.footprint.remove()
    return 0


def no_such_folder(folder: Path, wanted: str) -> NotARun:
    """The error for a folder that lacks ``wanted``."""
    state = f"has no {wanted}" if folder.is_dir() else "does not exist"
    if folder.is_file():
        state = "is a file"
    return NotARun(f"run={folder}: expected the folder of a run, but it {state}")
