"""Being told from outside to stop or to save: by Ctrl-C (SIGINT), SIGTERM, SIGUSR2."""

from __future__ import annotations

import signal
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from types import FrameType
from typing import Any

SIGNALS = tuple(
    getattr(signal, name) for name in ("SIGINT", "SIGTERM", "SIGUSR2") if hasattr(signal, name)
)
_ENDS_THE_PROCESS = (signal.SIG_DFL, signal.SIG_IGN, signal.default_int_handler)


class Interrupted(KeyboardInterrupt):
    """The run was stopped from outside; the message says what is left of it."""


class Stop:
    """Whether a signal has come.

    It interrupts at once (KeyboardInterrupt), but for two places: ``between_ticks`` the first one
    only sets ``asked``, so that no tick is left half done; ``not_now`` any does.  What follows an
    interruption is saving, so that from then on signals are ignored.

    Where somebody else handles a signal already, such as submitit, which submits a pre-empted job
    again, that decides what becomes of the process: ``between_ticks`` the signal waits in
    ``waiting`` until the state is saved and ``hand_on`` is called.
    """

    def __init__(self) -> None:
        self.asked = False
        self.waiting: list[int] = []
        self._patient = False
        self._deaf = False
        self._before: dict[int, Any] = {}

    def _handle(self, signum: int, frame: FrameType | None) -> None:
        if self._is_handled_elsewhere(signum):
            if self.asked:
                return
            self.waiting.append(signum)
            if not (self._deaf or self._patient):
                self.hand_on()
            return
        being_honoured = self.asked and not self._patient
        if self._deaf or being_honoured or (self._patient and not self.asked):
            self.asked = True
            return
        self.asked, self._patient = True, False
        raise KeyboardInterrupt

    def _is_handled_elsewhere(self, signum: int) -> bool:
        handler = self._before.get(signum)
        return handler is not None and handler not in _ENDS_THE_PROCESS

    def hand_on(self) -> None:
        """Call the handlers that were there before for the signals in ``waiting``.

        Raises SystemExit where one ends the process, or raises any error.
        """
        while self.waiting:
            signum = self.waiting.pop(0)
            handler: Callable[[int, FrameType | None], Any] = self._before[signum]
            try:
                handler(signum, None)
            except SystemExit:
                self._ignore_more()
                raise
            except Exception as error:
                self._ignore_more()
                # The run was interrupted, it has not failed: submitit raises where it gives up.
                raise SystemExit(str(error)) from error

    def _ignore_more(self) -> None:
        """Nothing may interrupt the end of a process that was asked to stop."""
        self.asked = True
        self.waiting.clear()

    @contextmanager
    def listening(self, *, ending: bool = True) -> Iterator[None]:
        """Handle the signals in this block (in a process's main thread, which alone gets any).

        ending: whether a process that was asked to stop ends after this block.
        """
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        # None: it was not installed from Python, and cannot be installed again.
        found = {number: signal.getsignal(number) for number in SIGNALS}
        self._before = {number: handler for number, handler in found.items() if handler is not None}
        for number in self._before:
            signal.signal(number, self._handle)
        try:
            yield
        finally:
            for number, handler in self._before.items():
                signal.signal(number, signal.SIG_IGN if self.asked and ending else handler)

    @contextmanager
    def between_ticks(self) -> Iterator[None]:
        """The first signal waits until the block looks at ``asked``; another one does not."""
        self._patient = True
        try:
            yield
        finally:
            self._patient = False

    @contextmanager
    def not_now(self) -> Iterator[None]:
        """Signals wait until after the block: what is written here is written to the end."""
        before, self._deaf = self._deaf, True
        try:
            yield
        finally:
            self._deaf = before
            if not before:
                self.hand_on()
