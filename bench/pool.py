"""One worker process: started with single-threaded XLA, given runs one at a time, watched.

Every worker has a pipe of its own, so that the death of one says which run it cost and harms no
other. Processes are spawned, because JAX does not survive a fork.
"""

import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from multiprocessing.context import SpawnProcess
from pathlib import Path

from bench.environment import environment
from bench.plan import Run
from bench.worker import serve

RUNS_PER_PROCESS = 24
"""Runs after which a process is replaced, so that compiled programs do not pile up in memory."""


def share_of_cores(number: int, jobs: int) -> list[int]:
    """Cores for one of `jobs` workers, empty where cores cannot be chosen or do not suffice.

    XLA starts a thread per core that it may use, and they wait for each other by spinning: two
    workers that may both use two cores take each other's time.
    """
    if not hasattr(os, "sched_getaffinity"):
        return []  # macOS, Windows
    cores = sorted(os.sched_getaffinity(0))
    return cores[number::jobs] if jobs <= len(cores) else []


class Worker:
    """A place for one process, which is started when it is first needed."""

    def __init__(self, directory: Path, number: int, jobs: int) -> None:
        self.directory = directory
        self.number = number
        self._cores = share_of_cores(number, jobs)
        self.run: Run | None = None
        self._log = directory / "runs" / ".logs" / f"worker-{number}.log"
        self._process: SpawnProcess | None = None
        self._given = 0

    def give(self, run: Run) -> None:
        """Starts a run, in a new process if the old one has died or done enough."""
        if self._process is not None and (
            not self._process.is_alive() or self._given >= RUNS_PER_PROCESS
        ):
            self.stop()
        if self._process is None:
            self._start()
        self._given += 1
        self.run = run
        with contextlib.suppress(OSError):  # a process that just died is noticed by `died`
            self.connection.send(run)

    def _start(self) -> None:
        self._log.parent.mkdir(parents=True, exist_ok=True)
        context = multiprocessing.get_context("spawn")
        self.connection, theirs = context.Pipe()
        self._process = context.Process(
            target=serve, args=(theirs, self.directory, self._log), daemon=True
        )
        with _patched_environment(environment()), _on_cores(self._cores), _interrupts_ignored():
            self._process.start()
        theirs.close()
        self._given = 0

    @property
    def sentinel(self) -> int:
        """A handle that becomes ready when the process ends."""
        assert self._process is not None
        return self._process.sentinel

    def died(self) -> str:
        """Why the process is gone, empty while it is there."""
        if self._process is None or self._process.is_alive():
            return ""
        code = self._process.exitcode
        if code is not None and code < 0:
            name = signal.Signals(-code).name
            more = " (out of memory?)" if name == "SIGKILL" else ""
            return f"its worker process was ended by {name}{more}"
        return f"its worker process ended with exit status {code}; see {self._log}"

    def stop(self) -> None:
        """Ends the process, whatever it is doing."""
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process.close()
            self.connection.close()
        self._process, self.run = None, None


@contextlib.contextmanager
def _patched_environment(changes: dict[str, str]) -> Iterator[None]:
    """Inside, the environment that a spawned process inherits."""
    before = dict(os.environ)
    os.environ.update(changes)
    try:
        yield
    finally:
        os.environ.clear()
        os.environ.update(before)


@contextlib.contextmanager
def _on_cores(cores: list[int]) -> Iterator[None]:
    """Inside, a process that starts may use only these cores; any if the list is empty."""
    if not cores:
        yield
        return
    before = os.sched_getaffinity(0)
    os.sched_setaffinity(0, cores)
    try:
        yield
    finally:
        os.sched_setaffinity(0, before)


@contextlib.contextmanager
def _interrupts_ignored() -> Iterator[None]:
    """Inside, a process that starts ignores Ctrl-C from its first instruction on."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    before = signal.signal(signal.SIGINT, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGINT, before)
