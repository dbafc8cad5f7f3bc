"""Who does tasks elsewhere: processes on this machine, a Ray cluster, or jobs of a Slurm cluster.

An executor has numbered slots, each for one task at a time. A task is a function that can be sent
to another process; it is called with a function that sends messages back. How it ends is an event:
its value, its error, or that its process was killed, which concerns no other slot. Messages of a
task come in their order, and all before its end, unless it was killed.
"""

import abc
import dataclasses
import os
import time
from collections.abc import Callable
from typing import Any, Literal, Self

from bench.execution.environment import accelerated

Report = Callable[..., None]
"""Sends its arguments to whoever started the task."""
Task = Callable[[Report], Any]
"""What a slot does."""
Name = Literal["local", "ray", "slurm"]
"""The executors."""
TASKS_PER_PROCESS = 24
"""Tasks after which a process is replaced, so that compiled programs do not pile up in memory."""
PROCESSES = 4
"""Processes that share an accelerator, so that it works while one of them compiles; a guess."""


@dataclasses.dataclass(frozen=True)
class Message:
    """What a task reported."""

    slot: int
    """Where it runs."""
    content: tuple
    """The arguments of `report`."""


@dataclasses.dataclass(frozen=True)
class Ended:
    """How a task ended."""

    slot: int
    """Where it ran; the slot is free again."""
    value: Any = None
    """What it returned."""
    error: str = ""
    """One line on what it raised or what happened to its process; empty if it returned."""


class AbstractExecutor(abc.ABC):
    """Does tasks in slots; a context that stops them at its end."""

    slots: int
    """Number of tasks at a time."""

    @abc.abstractmethod
    def start(self, slot: int, task: Task) -> None:
        """Takes a task for a free slot and returns at once; `events` may have to start it."""

    def events(self, timeout: float) -> list[Message | Ended]:
        """What happened since the last call; waits at most `timeout` seconds for something."""
        deadline = time.monotonic() + timeout
        while True:
            left = max(0.0, deadline - time.monotonic())
            found = self._poll(left)
            if found or left == 0.0:
                return found

    @abc.abstractmethod
    def _poll(self, left: float) -> list[Message | Ended]:
        """What happened; waits a moment, and at most `left` seconds."""

    @abc.abstractmethod
    def stop(self) -> None:
        """Ends all processes, whatever they are doing; once more does nothing."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *raised: object) -> None:
        self.stop()


def usual_jobs() -> int:
    """Processes on this machine if nobody says: one per core, few where they share a device."""
    return min(PROCESSES, cores()) if accelerated() else cores()


def cores() -> int:
    """Cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1  # macOS


def one_line(error: BaseException) -> str:
    """What was raised, e.g. "ValueError: `n` must be at least 1, got 0."."""
    words = " ".join(str(error).split())
    return f"{type(error).__name__}: {words}" if words else type(error).__name__
