"""Executes planned runs, parents before children, longest chains first, on any executor."""

import dataclasses
import datetime
import functools
import heapq
import time
from collections.abc import Callable, Iterable, Sequence

from bench.execution.executor import AbstractExecutor, Ended
from bench.execution.progress import SweepProgress
from bench.execution.worker import Done, do_runs
from bench.plan.planned_run import Run
from bench.store.record import Outcome
from bench.store.store import Store


@dataclasses.dataclass
class Execution:
    """Executes runs.

    A run that fails, or whose worker dies, is stored as failed with its cause, and so are its
    children; the others continue. With `fail_fast`, the first failure ends them, too. However it
    ends, committed runs stay, and the executor ends the runs in progress.
    """

    runs: Sequence[Run]
    """What to run, parents before their children."""
    store: Store
    """Where finished runs go and parents' policies come from."""
    executor: AbstractExecutor
    """Does them."""
    display: SweepProgress
    """Shows what happens."""
    done: Iterable[str] = ()
    """Names of parents that are in the store already."""
    failed: Sequence[str] = ()
    """Names of parents that are stored as failed and are not tried again."""
    check: Callable[[Run], str] = lambda run: ""
    """Why a run that ended well may not stand; empty if it may. It is put in quarantine."""
    together: int = 1
    """Most runs, alike but for their seed, that a worker does at once."""
    fail_fast: bool = False
    """Whether the first failure ends everything."""

    def __post_init__(self) -> None:
        self._schedule = _Schedule(self.runs, self.done)
        self._blocked: set[str] = set()
        self._slots: dict[int, list[Run]] = {slot: [] for slot in range(self.executor.slots)}

    def result(self) -> dict[str, str]:
        """Executes all runs and returns their statuses."""
        for parent in self.failed:
            self._fail_children(parent, "failed")
        self._blocked = {*self._schedule.status}
        while not self._over():
            for slot, runs in self._slots.items():
                if not runs and (given := self._schedule.next(self.together)):
                    self._start(slot, given)
            if not any(self._slots.values()):
                break
            for event in self.executor.events(timeout=1.0):
                if isinstance(event, Ended):
                    self._end(event)
                else:
                    self.display.progress(event.slot, *event.content)
        return {name: s for name, s in self._schedule.status.items() if name not in self.failed}

    def _over(self) -> bool:
        """Whether a new failure ends the execution (`fail_fast`)."""
        status = self._schedule.status
        return self.fail_fast and any(
            status[name] == "failed" for name in status.keys() - self._blocked
        )

    def _start(self, slot: int, runs: list[Run]) -> None:
        self._slots[slot] = runs
        task = functools.partial(do_runs, runs, self.store.directory)
        self.executor.start(slot, task)
        self.display.started(slot, runs)

    def _end(self, event: Ended) -> None:
        runs, self._slots[event.slot] = self._slots[event.slot], []
        lost = [Done("", "", event.error)] * len(runs)
        for run, done in zip(runs, lost if event.error else event.value, strict=True):
            if not done.error:
                self._finish(run, done.status, done.cause)
            elif (status := self.store.status(run.name)) not in ("", "failed"):
                self._finish(run, status, "")  # it died after it had committed
            elif status == "failed" and (cause := self._own_failure(run)):
                self._finish(run, status, cause)  # by itself, before the others died
            else:
                self._fail(run, done.error)

    def _own_failure(self, run: Run) -> str:
        """Why a run failed by itself since it was started; empty if it did not."""
        content = self.store.read(run.name)
        begun = datetime.datetime.fromtimestamp(self._schedule.clock[run.name], datetime.UTC)
        late = datetime.datetime.fromisoformat(content["committed"]) >= begun
        return content["cause"] if late and not content["interrupted"] else ""

    def _fail(self, run: Run, cause: str) -> None:
        """Stores a run as failed for a reason outside of the run."""
        try:
            self.store.commit(run, Outcome("failed", cause=cause, interrupted=True))
        except OSError as error:
            cause = f"{cause}; and this could not be stored: {error.strerror}"
        self._finish(run, "failed", cause)

    def _finish(self, run: Run, status: str, cause: str) -> None:
        """Notes the end of a run; a failed one takes its children along."""
        reason = self.check(run) if status != "failed" else ""
        if reason:
            self.store.quarantine(run.name, reason)
            status, cause = "failed", reason
        seconds = time.monotonic() - self._schedule.started.get(run.name, time.monotonic())
        self.display.finished(run, status, cause, seconds)
        self._fail_children(run.name, status, reason)

    def _fail_children(self, parent: str, status: str, reason: str = "") -> None:
        """Notes the end of a run and fails its children, with `reason` in their cause."""
        cause = f"parent {parent} failed" + (f": {reason}" if reason else "")
        for child in self._schedule.end(parent, status):
            if child.name not in self._schedule.status:  # not by way of another child
                self._fail(child, cause)


class _Schedule:
    """Decides which run starts next, and knows which runs wait for which parents."""

    def __init__(self, runs: Iterable[Run], done: Iterable[str]) -> None:
        self.status: dict[str, str] = {}
        self.started: dict[str, float] = {}
        self.clock: dict[str, float] = {}
        """When each run was started, in seconds since the epoch of the system clock [s]."""
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

    def next(self, most: int = 1) -> list[Run]:
        """The ready run with the longest chain of work behind it, and others of its kind.

        Those are ready, too, and differ in their seed only; none at all if nothing is ready.
        """
        chosen: list[Run] = []
        kept = []
        while self._ready and len(chosen) < most:
            entry = heapq.heappop(self._ready)
            run = self._runs[entry[-1]]
            alike = not chosen or run.kind == chosen[0].kind
            (chosen.append(run) if alike else kept.append(entry))
        for entry in kept:
            heapq.heappush(self._ready, entry)
        for run in chosen:
            self.started[run.name], self.clock[run.name] = time.monotonic(), time.time()
        return chosen

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
