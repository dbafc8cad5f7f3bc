"""Executes planned runs on worker processes, parents before children, longest chains first."""

import heapq
import time
from collections.abc import Iterable
from multiprocessing.connection import wait

from bench.plan import Run
from bench.pool import Worker
from bench.progress import Display
from bench.store import Outcome, Store, UnreadableRunError


def execute(
    runs: Iterable[Run], store: Store, jobs: int, display: Display, done: Iterable[str] = ()
) -> dict[str, str]:
    """Status of each of `runs`, by name, once all are in the store.

    A run that fails, or whose worker dies, is stored as failed with its cause, its children too;
    the others go on. Whatever stops this function stops the workers; committed runs stay.

    Args:
        runs: What to run, parents before their children.
        store: Where finished runs go and parents' policies come from.
        jobs: Number of worker processes.
        display: Told what happens.
        done: Names of parents that are in the store already.
    """
    schedule = _Schedule(runs, done)
    workers = [Worker(store.directory, number, jobs) for number in range(jobs)]
    try:
        while True:
            for worker in workers:
                if worker.run is None and (run := schedule.next()) is not None:
                    worker.give(run)
                    display.started(worker.number, run)
            busy = [(worker, worker.run) for worker in workers if worker.run is not None]
            if not busy:
                return schedule.status
            wait([handle for w, _ in busy for handle in (w.connection, w.sentinel)], timeout=1.0)
            for worker, run in busy:
                if (ended := _listen(worker, run, store, display)) is not None:
                    worker.run = None
                    _finish(run, *ended, schedule, store, display)
    finally:
        for worker in workers:
            worker.stop()


class _Schedule:
    """Which run is next; what is waiting for what."""

    def __init__(self, runs: Iterable[Run], done: Iterable[str]) -> None:
        self.status: dict[str, str] = {}
        self.started: dict[str, float] = {}
        self._runs = {run.name: run for run in runs}
        self._done = set(done)
        self._children: dict[str, list[str]] = {}
        for run in self._runs.values():
            for parent in run.parents.values():
                self._children.setdefault(parent, []).append(run.name)
        self._chain: dict[str, float] = {}
        for run in reversed(self._runs.values()):  # children come after their parents
            after = [self._chain[child] for child in self._children.get(run.name, ())]
            self._chain[run.name] = run.cost + max(after, default=0.0)
        self._ready: list[tuple[float, int, str]] = []
        self._order = {name: index for index, name in enumerate(self._runs)}
        for name in self._runs:
            self._offer(name)

    def _offer(self, name: str) -> None:
        """Makes a run ready if all its parents are there."""
        if set(self._runs[name].parents.values()) <= self._done:
            heapq.heappush(self._ready, (-self._chain[name], self._order[name], name))

    def next(self) -> Run | None:
        """The ready run with the longest chain of work behind it, None if none is ready."""
        if not self._ready:
            return None
        name = heapq.heappop(self._ready)[-1]
        self.started[name] = time.monotonic()
        return self._runs[name]

    def end(self, name: str, status: str) -> list[Run]:
        """Notes how a run ended; the children that can never start because it failed."""
        self.status[name] = status
        children = self._children.get(name, [])
        if status == "failed":
            return [self._runs[child] for child in children if child not in self.status]
        self._done.add(name)
        for child in children:
            self._offer(child)
        return []


def _listen(worker: Worker, run: Run, store: Store, display: Display) -> tuple[str, str] | None:
    """Status and cause of a worker's run if it has ended; passes progress on."""
    gone = worker.died()  # asked first: what a process sent before it died can still be read
    try:
        while worker.connection.poll():
            kind, *content = worker.connection.recv()
            if kind == "done":
                return tuple(content)
            display.progress(worker.number, *content)
    except (EOFError, OSError):
        gone = gone or worker.died()
    if not gone:
        return None
    try:
        content = store.read(run.name)
        if content["status"] != "failed":
            return content["status"], ""  # it died after it had committed
    except UnreadableRunError:
        pass  # it died before
    store.commit(run, Outcome(status="failed", cause=gone))
    return "failed", gone


def _finish(
    run: Run, status: str, cause: str, schedule: _Schedule, store: Store, display: Display
) -> None:
    """Notes the end of a run; a failed one takes its children along."""
    seconds = time.monotonic() - schedule.started.get(run.name, time.monotonic())
    display.finished(run, status, cause, seconds)
    for child in schedule.end(run.name, status):
        cause = f"parent {run.name} failed"
        store.commit(child, Outcome(status="failed", cause=cause))
        _finish(child, "failed", cause, schedule, store, display)
