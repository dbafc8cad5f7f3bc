"""Child processes, several at a time, each on a core of its own, with a time limit."""

import contextlib
import dataclasses
import itertools
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NoReturn

from bench.execution.environment import DEVICES, environment
from bench.execution.pool import share_of_cores

PASSED_ON = (
    *("PATH", "HOME", "LANG", "LC_ALL", "LD_LIBRARY_PATH"),
    *("PYTHONPATH", "TMPDIR", "JAX_PLATFORMS"),
    *DEVICES.values(),
)
"""What a child inherits beside `bench.execution.environment`; nothing else gets through."""
POLL_S = 0.1
"""Time between two looks at the children [s]."""


@dataclasses.dataclass(frozen=True)
class Task:
    """A command to run."""

    name: str
    """What it is about."""
    command: Sequence[str]
    """Program and arguments."""
    directory: Path
    """Working directory; the process writes `stdout` and `stderr` into `log`."""
    log: Path
    """Folder for what it prints."""


@dataclasses.dataclass(frozen=True)
class Ended:
    """How a task ended."""

    name: str
    """The task's name."""
    cause: str
    """Why it failed; empty if it ended with status 0."""
    seconds: float
    """How long it ran [s]."""


@dataclasses.dataclass
class _Running:
    task: Task
    process: subprocess.Popen[bytes]
    place: int
    begun: float


def python(*arguments: str) -> list[str]:
    """The command that runs this Python with `arguments`."""
    return [sys.executable, *arguments]


def scrubbed() -> dict[str, str]:
    """The environment of a child: what it needs to start, nothing that says what it is for."""
    return {key: os.environ[key] for key in PASSED_ON if key in os.environ} | environment()


def run_tasks(
    tasks: Iterable[Task],
    jobs: int,
    on_end: Callable[[Ended], None],
    timeout: float | None = None,
    on_poll: Callable[[], None] = lambda: None,
) -> None:
    """Runs all tasks, `jobs` at a time; each is taken just before it starts.

    Args:
        tasks: What to run.
        jobs: Number of processes.
        on_end: Called with how each ended.
        timeout: Time after which a process is killed [s].
        on_poll: Called about ten times a second.
    """
    waiting, running = iter(tasks), list[_Running]()
    try:
        while True:
            for task in itertools.islice(waiting, jobs - len(running)):
                place = min(set(range(jobs)) - {child.place for child in running})
                running.append(_start(task, place, jobs))
            if not running:
                return
            for child in list(running):
                ended = _ended(child, timeout)
                if ended is not None:
                    running.remove(child)
                    on_end(ended)
            on_poll()
            if running:
                time.sleep(POLL_S)
    finally:
        for child in running:
            _kill(child.process)


def leave_with_parent() -> None:
    """From now on this process ends when its parent has: nobody waits for what it does."""
    parent = os.getppid()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def end(status: int) -> NoReturn:
    """Ends this process at once, without taking Python down.

    With a usual exit, one diagnosis of sixty was aborted by C++ threads that still ran.
    """
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


def _start(task: Task, place: int, jobs: int) -> _Running:
    task.log.mkdir(parents=True, exist_ok=True)
    with (task.log / "stdout").open("wb") as out, (task.log / "stderr").open("wb") as err:
        process = subprocess.Popen(
            task.command,
            cwd=task.directory,
            env=scrubbed(),
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=err,
            start_new_session=True,  # so that it can be killed with its children
        )
    cores = share_of_cores(place, jobs)[:1]
    if cores:
        with contextlib.suppress(ProcessLookupError):  # it may have ended already
            os.sched_setaffinity(process.pid, cores)
    return _Running(task, process, place, time.monotonic())


def _ended(child: _Running, timeout: float | None) -> Ended | None:
    """How a child ended; None while it runs."""
    seconds = time.monotonic() - child.begun
    status = child.process.poll()
    if status is None:
        if timeout is None or seconds < timeout:
            return None
        _kill(child.process)
        return Ended(child.task.name, f"took longer than {timeout:g} s", seconds)
    return Ended(child.task.name, _cause(status, child.task.log / "stderr"), seconds)


def _cause(status: int, log: Path) -> str:
    if status == 0:
        return ""
    lines = log.read_text(encoding="utf-8", errors="replace").strip().splitlines()
    said = f": {lines[-1].strip()}" if lines else ""
    if status < 0:
        return f"ended by {signal.Signals(-status).name}{said}"
    return f"exit status {status}{said}"


def _kill(process: subprocess.Popen[bytes]) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.killpg(process.pid, signal.SIGKILL)
    process.wait()
