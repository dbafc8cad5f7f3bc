"""Tasks as jobs of a Slurm cluster, submitted with submitit from a machine that has `sbatch`.

All tasks that are ready at once, such as one level of the lineage of a sweep, become one job array,
or several where the cluster's limit on arrays is smaller. Children are submitted when their parents
are done, so that no job waits for another one. What a run left stands in the store: if this process
ends, its jobs go on, and the next call of the same command finds what they stored.

Only this module knows submitit, an optional extra. Slurm's own variables choose where jobs run, for
they go before what a script says: SBATCH_PARTITION, SBATCH_ACCOUNT, SBATCH_TIMELIMIT, SBATCH_GPUS.
Every machine needs this package, and the folder of the results under the same path.
"""

import contextlib
import dataclasses
import importlib
import os
import pickle
import re
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from bench.execution.environment import environment
from bench.execution.executor import AbstractExecutor, Ended, Message, Task, one_line
from bench.text.errors import UsageError

POLL_S = 0.5
"""Longest time that a message or an end waits to be read [s]."""
STATE_EVERY = 15.0
"""Time between two questions to Slurm for jobs that are gone [s]; `sacct` is slow."""
USUAL_JOBS = 64
"""Jobs at a time if nobody says; a guess at what a cluster's users bear."""
USUAL_LIMIT = 1000
"""Jobs of an array where the cluster does not tell its limit, which Slurm sets to 1001."""
MINUTES = 24 * 60
"""Time limit of a job [min], unless SBATCH_TIMELIMIT says another one."""
MEMORY_GB = 4
"""Memory of a job [GB]: several times what a training of 18 drones takes on a processor."""


@dataclasses.dataclass
class _Job:
    """A task that was submitted."""

    slot: int
    job: Any
    """submitit's."""
    messages: Path
    """File to which the task appends what it reports."""
    read: int = 0
    """Bytes of it that were read."""


class SlurmExecutor(AbstractExecutor):
    """One job a task; a job that dies is not submitted again."""

    def __init__(self, slots: int | None, most: int, folder: Path) -> None:
        """Submits nothing yet.

        Args:
            slots: Jobs at a time; None: as many as there are tasks, up to `USUAL_JOBS`.
            most: Tasks that there will be.
            folder: Where scripts, logs and messages go; every machine must see it.

        Raises:
            UsageError: submitit is not installed, or this machine cannot submit jobs.
        """
        self.slots = max(1, min(slots or USUAL_JOBS, most))
        # A folder for each sweep: the messages of an earlier one are nobody's.
        self._folder = folder.absolute() / f"{time.strftime('%Y%m%d-%H%M%S')}-{os.getpid()}"
        self._executor = _make_submitter(self._folder, self.slots)
        self._limit = array_limit()
        self._waiting: list[tuple[int, bytes]] = []
        self._lost: list[Ended] = []
        """Tasks that never became a job."""
        self._jobs: list[_Job] = []
        self._given = 0
        self._asked = time.monotonic()

    def start(self, slot: int, task: Task) -> None:
        """Takes a task for a free slot; the next call of `events` submits it with all others."""
        cloudpickle: Any = importlib.import_module("cloudpickle")
        try:
            packed = cloudpickle.dumps(task)
        except Exception as error:
            self._lost.append(Ended(slot, error=one_line(error)))
            return
        self._waiting.append((slot, packed))

    def _poll(self, left: float) -> list[Message | Ended]:
        self._submit()
        found: list[Message | Ended] = [*self._lost]
        self._lost.clear()
        for job in [*self._jobs]:
            done = self._is_done(job)  # before its messages are read: none is missed
            found += self._messages(job)
            if done:
                self._jobs.remove(job)
                found.append(_end(job))
        if not found:
            time.sleep(min(POLL_S, left))
        return found

    def stop(self) -> None:
        """Cancels all jobs, whatever they are doing; once more does nothing."""
        self._waiting.clear()
        while self._jobs:
            with contextlib.suppress(OSError, subprocess.SubprocessError):
                self._jobs.pop().job.cancel(check=False)

    def _submit(self) -> None:
        """Submits what waits, as few arrays as the cluster allows."""
        while self._waiting:
            some, self._waiting = self._waiting[: self._limit], self._waiting[self._limit :]
            first, self._given = self._given, self._given + len(some)
            files = [self._folder / f"messages-{first + i}.pickle" for i in range(len(some))]
            tasks = [packed for _, packed in some]
            try:
                jobs = self._executor.map_array(_perform, tasks, [*map(str, files)])
            except (OSError, RuntimeError, subprocess.SubprocessError) as error:
                cause = f"it could not be submitted: {one_line(error)}"
                self._lost += [Ended(slot, error=cause) for slot, _ in some]
                continue
            self._jobs += [
                _Job(slot, job, file)
                for (slot, _), job, file in zip(some, jobs, files, strict=True)
            ]

    def _is_done(self, job: _Job) -> bool:
        """Whether a job has left its result, or is gone without one."""
        if job.job.paths.result_pickle.exists():
            return True
        if job is self._jobs[0] and time.monotonic() - self._asked > STATE_EVERY:
            self._asked = time.monotonic()
            job.job.done(force_check=True)  # asks for all jobs
        return job.job.done()

    def _messages(self, job: _Job) -> Iterator[Message]:
        """What a task has reported since the last time; what is not whole yet comes later."""
        with contextlib.suppress(OSError), job.messages.open("rb") as file:
            file.seek(job.read)
            with contextlib.suppress(EOFError, pickle.UnpicklingError):
                while True:
                    content = pickle.load(file)
                    job.read = file.tell()
                    yield Message(job.slot, content)


def array_limit() -> int:
    """Most jobs of an array, as the cluster's configuration says."""
    try:
        said = subprocess.run(
            ["scontrol", "show", "config"], capture_output=True, text=True, check=True, timeout=60
        ).stdout
    except (OSError, subprocess.SubprocessError):
        return USUAL_LIMIT
    found = re.search(r"^MaxArraySize\s*=\s*(\d+)", said, re.MULTILINE)
    # Slurm counts indices from 0 and allows those below its number.
    return max(1, int(found[1])) if found else USUAL_LIMIT


def _make_submitter(folder: Path, slots: int) -> Any:
    """Submitit's executor.

    Raises:
        UsageError: submitit is not installed, or this machine cannot submit jobs.
    """
    try:
        submitit: Any = importlib.import_module("submitit")
    except ImportError as error:
        raise UsageError(
            f"`--executor slurm` needs submitit ({error}): pip install 'fidelity-bench[slurm]'."
        ) from error
    folder.mkdir(parents=True, exist_ok=True)
    try:
        made = submitit.AutoExecutor(folder, cluster="slurm", slurm_max_num_timeout=0)
    except RuntimeError as error:
        raise UsageError(
            f"`--executor slurm` must be given on a machine that can submit jobs: {one_line(error)}"
        ) from error
    made.update_parameters(
        name="bench",
        timeout_min=MINUTES,
        mem_gb=MEMORY_GB,
        cpus_per_task=1,
        slurm_array_parallelism=slots,
    )
    return made


def _end(job: _Job) -> Ended:
    """How a job ended; one without a result was killed."""
    if job.job.paths.result_pickle.exists():
        try:
            packed, error = job.job.result()
        except Exception as failure:  # submitit's own, where the job could not even begin
            return Ended(job.slot, error=f"{one_line(failure)}; see {job.job.paths.stderr}")
        return Ended(job.slot, value=pickle.loads(packed) if packed else None, error=error)
    state = f"job {job.job.job_id}, {job.job.state}"
    return Ended(
        job.slot,
        error=f"its worker process is gone ({state}); see {job.job.paths.stderr}",
    )


# --- In the job -----------------------------------------------------------------------------


def _perform(packed: bytes, messages: str) -> tuple[bytes, str]:
    """Value and error of a task. It is unpacked, and JAX imported, in its own environment."""
    os.environ.update(environment() | {"NPROC": "1"})
    cloudpickle: Any = importlib.import_module("cloudpickle")
    with Path(messages).open("ab", buffering=0) as file:

        def report(*content: Any) -> None:
            file.write(pickle.dumps(content))

        try:
            return cloudpickle.dumps(pickle.loads(packed)(report)), ""
        except (Exception, SystemExit) as error:
            return b"", one_line(error)
