"""Rows of work in processes that may die: Python's own pool, and what to do when it breaks.

Results must be functions of their rows alone, so that a row may be computed again anywhere.
"""

from __future__ import annotations

import multiprocessing
import signal
import warnings
from collections.abc import Callable, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from typing import Generic, TypeVar

Row = TypeVar("Row")
Result = TypeVar("Result")


class Workers(Generic[Row, Result]):
    """``count`` processes that apply ``work``, a function of a module, to lists of rows.

    When a process dies, all are restarted and the missing rows are computed again, one by one.  A
    row whose process dies again has the result None.
    """

    def __init__(self, work: Callable[[list[Row]], list[Result]], count: int) -> None:
        """Start no process yet."""
        self._work = work
        self._count = count
        self._pool: ProcessPoolExecutor | None = None

    def map(self, rows: Sequence[Row]) -> list[Result | None]:
        """The result of each of ``rows``."""
        share = -(-len(rows) // self._count)
        chunks = [list(rows[k : k + share]) for k in range(0, len(rows), share)]
        results: list[Result | None] = []
        for chunk, done in zip(chunks, self._try(chunks), strict=True):
            if done is None:
                warnings.warn(
                    f"a worker process died; its {len(chunk)} rows are computed again in a new one",
                    RuntimeWarning,
                    stacklevel=2,
                )
                done = [one[0] if one else None for one in map(self._alone, chunk)]
            results += done
        return results

    def processes(self) -> list[int]:
        """The process numbers of those that run."""
        return [] if self._pool is None else list(self._pool._processes)

    def close(self) -> None:
        """End the processes; ``map`` starts others."""
        if self._pool is not None:
            self._pool.shutdown()
        self._pool = None

    def _alone(self, row: Row) -> list[Result] | None:
        return self._try([[row]])[0]

    def _try(self, chunks: list[list[Row]]) -> list[list[Result] | None]:
        """The results of each chunk, None for those that were lost with a process."""
        if self._pool is None:
            # Not forked: threads of this process may hold locks.
            self._pool = ProcessPoolExecutor(
                self._count, multiprocessing.get_context("spawn"), initializer=_initialise
            )
        done: list[list[Result] | None] = []
        futures: list[Future[list[Result]]] = []
        try:
            futures += [self._pool.submit(self._work, chunk) for chunk in chunks]
        except BrokenProcessPool:
            # It broke between two calls: what was not handed in is lacking like what was lost.
            pass
        broken = len(futures) < len(chunks)
        for future in futures:
            try:
                done.append(future.result())
            except BrokenProcessPool:
                done.append(None)
                broken = True
        if broken:
            self.close()
        return done + [None] * (len(chunks) - len(done))


def _initialise() -> None:
    # An interrupt of the terminal reaches the whole group; the parent process ends this one.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
