"""Being stopped from outside: by Ctrl-C (SIGINT) or by a scheduler (SIGTERM)."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM)


class Interrupted(KeyboardInterrupt):
    """The run was stopped from outside; the message says what is left of it."""


class Stop:
    """Whether a signal has come.

    It interrupts at once (KeyboardInterrupt), but for two places: ``between_ticks`` the first one
    only sets ``asked``, so that no tick is left half done; ``not_now`` any does.  What follows an
    interruption is saving, so that from then on signals are ignored.
    """

    def __init__(self) -> None:
        self.asked = False
        self._patient = False
        self._deaf = False

    def _handle(self, signum: int, frame: FrameType | None) -> None:
        being_honoured = self.asked and not self._patient
        if self._deaf or being_honoured or (self._patient and not self.asked):
            self.asked = True
            return
        self.asked, self._patient = True, False
        raise KeyboardInterrupt

    @contextmanager
    def listening(self, *, ending: bool = True) -> Iterator[None]:
        """Handle the signals in this block (in a process's main thread, which alone gets any).

        ending: whether a process that was asked to stop ends after this block.
        """
        if threading.current_thread() is not threading.main_thread():
            yield
            return
        before = {number: signal.signal(number, self._handle) for number in SIGNALS}
        try:
            yield
        finally:
            for number, handler in before.items():
                # Nothing may interrupt the end of a process that was asked to stop.
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
        self._deaf = True
        try:
            yield
        finally:
            self._deaf = False
