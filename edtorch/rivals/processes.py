"""Work in processes of its own: results in order, reports and log messages on the way."""

from __future__ import annotations

import logging
import multiprocessing
import pickle
import signal
import traceback
from collections.abc import Callable, Sequence
from multiprocessing.connection import Connection, wait
from typing import Any, TypeVar

import torch

logger = logging.getLogger("edtorch")

R = TypeVar("R")
P = TypeVar("P")


class WorkerFailed(RuntimeError):
    """A process ended without a result; the message has its traceback, where there is one."""


class _Forward(logging.Handler):
    """Sends messages to the parent."""

    def __init__(self, connection: Connection) -> None:
        super().__init__()
        self._connection = connection

    def emit(self, record: logging.LogRecord) -> None:
        _send(self._connection, "log", (record.levelno, record.getMessage()))


def _send(connection: Connection, kind: str, content: Any) -> None:
    """Pickled plainly: torch would share a tensor's memory, which goes when its process does."""
    connection.send_bytes(pickle.dumps((kind, content)))


def _serve(connection: Connection, work: Callable[[Callable[[Any], None]], Any]) -> None:
    """The life of a process.  It ends with its parent: a report to nobody raises."""
    # Ctrl-C goes to the whole group; the parent decides what follows from it.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    torch.set_num_threads(1)
    logger.addHandler(_Forward(connection))
    logger.propagate = False
    try:
        result = work(lambda report: _send(connection, "report", report))
    except BrokenPipeError:
        return
    except Exception:
        _send(connection, "failed", traceback.format_exc())
    else:
        _send(connection, "result", result)


def in_processes(
    works: Sequence[Callable[[Callable[[P], None]], R]], report: Callable[[int, P], None]
) -> list[R]:
    """Results of ``works``, each called in a process of its own with a function to report by.

    Works, reports and results must be picklable.  ``report`` is called here, with the number of the
    work; if it raises, or a process fails, all of them are stopped.
    """
    context = multiprocessing.get_context("spawn")
    results: dict[int, R] = {}
    said: set[str] = set()
    processes = []
    numbers: dict[Connection, int] = {}
    try:
        for number, work in enumerate(works):
            here, there = context.Pipe(duplex=False)
            process = context.Process(target=_serve, args=(there, work), daemon=True)
            process.start()
            there.close()
            processes.append(process)
            numbers[here] = number
        while numbers:
            for connection in wait(list(numbers)):
                assert isinstance(connection, Connection)
                number = numbers[connection]
                try:
                    kind, content = pickle.loads(connection.recv_bytes())
                except EOFError:
                    raise WorkerFailed(f"process {number} ended without a result") from None
                if kind == "report":
                    report(number, content)
                elif kind == "log" and content[1] not in said:
                    said.add(content[1])
                    logger.log(*content)
                elif kind == "failed":
                    raise WorkerFailed(f"process {number} failed:\n{content}")
                elif kind == "result":
                    results[number] = content
                    del numbers[connection]
        return [results[number] for number in range(len(works))]
    finally:
        for process in processes:
            if process.is_alive() and len(results) < len(works):
                process.terminate()
            process.join()
