"""Tasks on the machines of a Ray cluster, or on this one where RAY_ADDRESS names no cluster.

Only this module knows Ray, an optional extra. Every machine needs this package, and the folder of
the results under the same path.
"""

import contextlib
import importlib
import math
import os
import time
import warnings
from collections.abc import Iterator
from typing import Any

from bench.execution.environment import environment
from bench.execution.executor import (
    TASKS_PER_PROCESS,
    AbstractExecutor,
    Ended,
    Message,
    Task,
    cores,
    one_line,
)
from bench.text.errors import UsageError

POLL_S = 0.2
"""Longest delay before a message is read [s]; the end of a task is noticed at once."""
PATIENCE = 10.0
"""Longest wait for the mailbox [s]. Messages only report progress: no task depends on them."""


class RayExecutor(AbstractExecutor):
    """One Ray task per slot, each with one CPU. A task whose machine dies is not repeated."""

    def __init__(self, slots: int | None, most: int) -> None:
        """Joins the cluster of RAY_ADDRESS, else starts one on this machine.

        Raises:
            UsageError: Ray is not installed, or the cluster cannot be reached.
        """
        self._ray = ray = _load_ray()
        self._joined = not ray.is_initialized()
        if self._joined:
            _join(ray, max(1, min(slots or cores(), most)))
        self.slots = max(1, min(slots or int(ray.cluster_resources().get("CPU", 1)), most))
        gpus = ray.cluster_resources().get("GPU", 0.0)
        # The machines that train have accelerators or not, whatever is in this one.
        self._environment = environment(accelerator=gpus > 0.0) | {"NPROC": "1"}
        here = ray.util.scheduling_strategies.NodeAffinitySchedulingStrategy(
            ray.get_runtime_context().get_node_id(), soft=False
        )
        self._mailbox: Any = (
            ray.remote(_Mailbox).options(num_cpus=0, scheduling_strategy=here).remote()
        )
        # Ray hides accelerators from tasks that ask for none.
        share = gpu_share(gpus, self.slots)
        options = {"num_cpus": 1, "num_gpus": share, "max_retries": 0}
        self._perform = ray.remote(**options, max_calls=TASKS_PER_PROCESS)(_perform)
        self._given = 0
        self._tasks: dict[Any, int] = {}
        self._slots_of: dict[int, int] = {}

    def start(self, slot: int, task: Task) -> None:
        """Starts a task in a free slot and returns at once."""
        packed = self._ray.cloudpickle.dumps(task)
        self._given += 1
        reference = self._perform.remote(packed, self._given, self._mailbox, self._environment)
        self._tasks[reference] = self._given
        self._slots_of[self._given] = slot

    def _poll(self, left: float) -> list[Message | Ended]:
        ended = self._wait(min(POLL_S, left))
        return [*self._messages(), *map(self._end, ended)]

    def stop(self) -> None:
        """Ends all processes, whatever they are doing."""
        for reference in self._tasks:
            self._ray.cancel(reference, force=True)
        self._tasks.clear()
        if self._mailbox is not None:
            self._ray.kill(self._mailbox)
            if self._joined:
                self._ray.shutdown()
        self._mailbox = None

    def _wait(self, timeout: float) -> list[Any]:
        """References of tasks that ended."""
        if not self._tasks:
            time.sleep(timeout)
            return []
        return self._ray.wait(list(self._tasks), num_returns=1, timeout=timeout)[0]

    def _messages(self) -> Iterator[Message]:
        errors = (self._ray.exceptions.RayError, TimeoutError)
        with contextlib.suppress(*errors):
            for number, content in self._ray.get(self._mailbox.take.remote(), timeout=PATIENCE):
                if number in self._slots_of:  # not one that was killed and is late
                    yield Message(self._slots_of[number], content)

    def _end(self, reference: Any) -> Ended:
        slot = self._slots_of.pop(self._tasks.pop(reference))
        try:
            value, error = self._ray.get(reference)
        except self._ray.exceptions.RayTaskError as failure:  # what it returned cannot be sent
            return Ended(slot, error=one_line(failure.cause))
        except self._ray.exceptions.RayError as lost:
            line = next(iter(str(lost).splitlines()), "")
            cause = f"its worker process or machine is gone ({type(lost).__name__}: {line})"
            return Ended(slot, error=cause)
        return Ended(slot, value=value, error=error)


def gpu_share(gpus: float, slots: int) -> float:
    """Accelerators per task; a fraction if tasks share one.

    A task's part lies on one accelerator, so that so many parts fit on each as it must hold.
    """
    if gpus <= 0.0 or gpus >= slots:
        return math.floor(gpus / slots)
    return math.floor(1e4 / math.ceil(slots / gpus)) / 1e4


def _load_ray() -> Any:
    """The package Ray.

    Raises:
        UsageError: It is not installed.
    """
    try:
        importlib.import_module("ray.util.scheduling_strategies")
        return importlib.import_module("ray")
    except ImportError as error:
        raise UsageError(
            f"`--executor ray` needs Ray ({error}): pip install 'fidelity-bench[ray]'."
        ) from error


def _join(ray: Any, slots: int) -> None:
    """Connects this process to Ray."""
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    quiet = {"log_to_driver": False, "logging_level": "error"}
    try:
        with warnings.catch_warnings():
            # JAX warns of forks; Ray's are followed by another program at once.
            warnings.filterwarnings("ignore", message=r"os\.fork", category=RuntimeWarning)
            if address := os.environ.get("RAY_ADDRESS"):
                ray.init(address=address, **quiet)
            else:
                ray.init(address="local", num_cpus=slots, include_dashboard=False, **quiet)
    except (ConnectionError, RuntimeError, ValueError) as error:
        raise UsageError(f"`--executor ray` cannot connect to Ray: {one_line(error)}") from error


class _Mailbox:
    """Collects the messages of tasks, on the machine that hands out tasks."""

    def __init__(self) -> None:
        self._content: list[tuple[int, tuple]] = []

    def put(self, number: int, content: tuple) -> None:
        """Leaves a message of a task."""
        self._content.append((number, content))

    def take(self) -> list[tuple[int, tuple]]:
        """Messages since the last call, which are then removed."""
        content, self._content = self._content, []
        return content


def _perform(
    packed: bytes, number: int, mailbox: Any, variables: dict[str, str]
) -> tuple[Any, str]:
    """Value and error of a task. It is unpacked, and JAX imported, in its own environment."""
    os.environ.update(variables)
    ray = _load_ray()
    sent = None

    def report(*content: Any) -> None:
        nonlocal sent
        sent = mailbox.put.remote(number, content)

    try:
        return ray.cloudpickle.loads(packed)(report), ""
    except (Exception, SystemExit) as error:
        return None, one_line(error)
    finally:
        if sent is not None:  # the last message is there, and so are those before it
            with contextlib.suppress(ray.exceptions.RayError, TimeoutError):
                ray.get(sent, timeout=PATIENCE)
