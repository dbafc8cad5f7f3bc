"""Tasks on processes of this machine: loky's, with single-threaded XLA, each on its own cores.

Every slot has a loky pool of one process, so that a process that is killed says which task it cost
and harms no other (a pool of several gives up all its tasks). Processes are started afresh, because
JAX does not survive a fork; they end at once when this process is gone, however it went.
"""

import contextlib
import dataclasses
import os
import queue
import re
import signal
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import Future
from multiprocessing import Pipe
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from joblib.externals.loky import process_executor
from joblib.externals.loky.process_executor import BrokenProcessPool, ProcessPoolExecutor

from bench.execution.environment import environment
from bench.execution.executor import (
    TASKS_PER_PROCESS,
    AbstractExecutor,
    Ended,
    Message,
    Task,
    one_line,
)
from bench.execution.signals import handled

POLL_S = 0.1
"""Longest delay before a message is read [s]; the end of a task is noticed at once."""


def share_of_cores(number: int, jobs: int) -> list[int]:
    """Cores for one of `jobs` workers, empty where cores cannot be chosen or do not suffice.

    XLA starts a thread per core that it may use, and they wait for each other by spinning: two
    workers that may both use two cores take each other's time.
    """
    if not hasattr(os, "sched_getaffinity"):
        return []  # macOS, Windows
    cores = sorted(os.sched_getaffinity(0))
    return cores[number::jobs] if jobs <= len(cores) else []


@dataclasses.dataclass
class _Process:
    """A pool of one process and our end of the pipe to it."""

    pool: ProcessPoolExecutor
    connection: Connection
    theirs: Connection
    """Kept open: it is handed over when the process is started."""
    given: int = 0

    def stop(self) -> None:
        """Kills it."""
        self.pool.shutdown(wait=True, kill_workers=True)
        self.connection.close()
        self.theirs.close()


class LocalExecutor(AbstractExecutor):
    """One process a slot, started when it is first needed and again after it was killed."""

    def __init__(self, slots: int, logs: Path) -> None:
        """`logs` is the folder for what the processes print."""
        self.slots = slots
        self._logs = logs
        self._processes: dict[int, _Process] = {}
        self._ended: queue.SimpleQueue[tuple[int, Future]] = queue.SimpleQueue()

    def start(self, slot: int, task: Task) -> None:
        """Starts a task in a free slot and returns at once."""
        process = self._processes.get(slot)
        if process is not None and process.given >= TASKS_PER_PROCESS:
            self._drop(slot)
        try:
            future = self._submit(slot, task)
        except BrokenProcessPool:  # it went away while it had nothing to do
            self._drop(slot)
            future = self._submit(slot, task)
        future.add_done_callback(lambda future: self._ended.put((slot, future)))

    def _submit(self, slot: int, task: Task) -> Future:
        if slot not in self._processes:
            self._processes[slot] = self._make_process(slot)
        process = self._processes[slot]
        process.given += 1
        with handled(signal.SIGINT, signal.SIG_IGN):
            return process.pool.submit(_perform, task)

    def _poll(self, left: float) -> list[Message | Ended]:
        ended = self._wait(min(POLL_S, left))
        messages = [
            Message(slot, content)
            for slot, process in self._processes.items()
            for content in _received(process.connection)
        ]
        return [*messages, *(self._end(slot, future) for slot, future in ended)]

    def stop(self) -> None:
        """Ends all processes, whatever they are doing."""
        for slot in list(self._processes):
            self._drop(slot)

    def _wait(self, timeout: float) -> list[tuple[int, Future]]:
        """Tasks that ended."""
        found = []
        with contextlib.suppress(queue.Empty):
            found.append(self._ended.get(timeout=timeout))
            while True:
                found.append(self._ended.get_nowait())
        return found

    def _end(self, slot: int, future: Future) -> Ended:
        error = future.exception()
        if error is None:
            return Ended(slot, value=future.result())
        if not isinstance(error, BrokenProcessPool):
            return Ended(slot, error=one_line(error))
        self._drop(slot)
        return Ended(slot, error=self._cause(slot, error))

    def _cause(self, slot: int, error: BrokenProcessPool) -> str:
        """Why a process ended, from loky's message, which names signals and exit statuses."""
        if found := re.search(r"\b(SIG[A-Z0-9]+)\(-\d+\)", str(error)):
            more = " (out of memory?)" if found[1] == "SIGKILL" else ""
            return f"its worker process was ended by {found[1]}{more}"
        log = self._log(slot)
        if found := re.search(r"\bEXIT\((\d+)\)", str(error)):
            return f"its worker process ended with exit status {found[1]}; see {log}"
        return f"its worker process could not go on ({one_line(error)}); see {log}"

    def _make_process(self, slot: int) -> _Process:
        self._logs.mkdir(parents=True, exist_ok=True)
        ours, theirs = Pipe()
        pool = ProcessPoolExecutor(
            max_workers=1,
            env=environment(),
            initializer=_prepare,
            initargs=(theirs, self._log(slot), share_of_cores(slot, self.slots)),
        )
        return _Process(pool, ours, theirs)

    def _drop(self, slot: int) -> None:
        self._processes.pop(slot).stop()

    def _log(self, slot: int) -> Path:
        return self._logs / f"worker-{slot}.log"


def _received(connection: Connection) -> Iterator[tuple[Any, ...]]:
    """Messages that came through a pipe since the last call."""
    with contextlib.suppress(EOFError, OSError):
        while connection.poll():
            yield connection.recv()


# --- In the process -------------------------------------------------------------------------

_TO_PARENT: list[Connection] = []
"""The pipe to the process that hands out tasks; set by `_prepare`."""


def _prepare(connection: Connection, log: Path, cores: list[int]) -> None:
    """Prepares a worker: pins cores, redirects its log, ignores Ctrl-C, ends with its parent."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    # A process that grows has compiled a program: no leak for which loky should replace it.
    process_executor._MAX_MEMORY_LEAK_SIZE = float("inf")
    if cores:
        os.sched_setaffinity(0, cores)
    with log.open("a", encoding="utf-8") as file:
        sys.stdout.flush()
        sys.stderr.flush()
        os.dup2(file.fileno(), sys.stdout.fileno())
        os.dup2(file.fileno(), sys.stderr.fileno())
    _TO_PARENT[:] = [connection]
    threading.Thread(target=_leave_with_parent, args=(connection,), daemon=True).start()


def _leave_with_parent(connection: Connection) -> None:
    """Ends this process when its parent has ended, which the closed pipe shows."""
    with contextlib.suppress(EOFError, OSError):
        connection.recv()
    os._exit(1)


def _perform(task: Task) -> Any:
    return task(_send)


def _send(*content: Any) -> None:
    try:
        _TO_PARENT[0].send(content)
    except OSError:
        os._exit(1)  # the parent is gone
