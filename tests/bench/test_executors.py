"""One suite that every executor passes, and what only one of them has."""

import importlib.util
import itertools
import os
import signal
import subprocess
import sys
import textwrap
import threading
import time
from pathlib import Path

import chores
import fake_slurm
import pytest
from chores import task

from bench.execution import pool, slurm
from bench.execution.cluster import RayExecutor, gpu_share
from bench.execution.environment import accelerated, environment, seeds_together
from bench.execution.executor import Ended, Message
from bench.execution.pool import LocalExecutor, share_of_cores
from bench.execution.slurm import SlurmExecutor, array_limit
from bench.execution.sweep import make_executor
from bench.text.errors import UsageError

WAIT = 300.0
"""Longest time for which a test waits for an executor [s]."""
HERE = Path(__file__).parent
NEEDS_RAY = pytest.mark.skipif(
    importlib.util.find_spec("ray") is None,
    reason="Ray is not installed; pip install 'fidelity-bench[ray]'",
)
NEEDS_SUBMITIT = pytest.mark.skipif(
    importlib.util.find_spec("submitit") is None,
    reason="submitit is not installed; pip install 'fidelity-bench[slurm]'",
)
pytestmark = [
    # Ray opens log files that it does not close and asks for a variable to be set in advance.
    pytest.mark.filterwarnings("ignore::ResourceWarning"),
    pytest.mark.filterwarnings("ignore::FutureWarning:ray"),
    pytest.mark.filterwarnings("ignore::DeprecationWarning:ray"),
]


EXECUTORS = [
    "local",
    pytest.param("ray", marks=NEEDS_RAY),
    pytest.param("slurm", marks=NEEDS_SUBMITIT),
]
"""Slurm is a fake one, under the real submitit."""


@pytest.fixture(scope="module", params=EXECUTORS)
def executor(request, tmp_path_factory):
    """One with two slots, used by test after test."""
    logs = tmp_path_factory.mktemp("logs")
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("PYTHONPATH", os.pathsep.join((str(HERE), str(HERE.parents[1]))))
        patch.delenv("RAY_ADDRESS", raising=False)
        if request.param == "slurm":
            fake_slurm.install(patch, tmp_path_factory.mktemp("slurm"))
        for name, seconds in {"STATE_EVERY": 0.5, "POLL_S": 0.05}.items():
            patch.setattr(slurm, name, seconds)
        with make_executor(request.param, 2, 2, logs) as made:
            yield made


def events_until_ended(executor, n):
    """All events until `n` tasks have ended."""
    found, start = [], time.monotonic()
    while sum(isinstance(event, Ended) for event in found) < n:
        assert time.monotonic() - start < WAIT
        found += executor.events(timeout=1.0)
    return found


def result(executor, work, slot=0):
    executor.start(slot, work)
    return events_until_ended(executor, 1)[-1]


def wait_until(condition):
    start = time.monotonic()
    while not condition():
        assert time.monotonic() - start < WAIT
        time.sleep(0.02)


def test_values_come_from_the_slots_that_were_asked(executor):
    assert executor.slots == 2
    executor.start(0, task(chores.add, 1, 2))
    executor.start(1, task(chores.add, 30, 4))
    events = events_until_ended(executor, 2)
    ends = {event.slot: event for event in events if isinstance(event, Ended)}
    assert ends == {0: Ended(0, value=3), 1: Ended(1, value=34)}


def test_messages_come_in_order_and_before_the_end(executor):
    executor.start(1, task(chores.add, 5, 6))
    assert events_until_ended(executor, 1) == [
        Message(1, ("adding", 5)),
        Message(1, ("adding", 6)),
        Ended(1, value=11),
    ]


def test_an_error_is_one_line_and_the_slot_goes_on(executor):
    executor.start(0, task(chores.mistake))
    assert events_until_ended(executor, 1) == [
        Message(0, ("about to fail",)),
        Ended(0, error="ValueError: the propellers fell off"),
    ]
    assert result(executor, task(chores.leave)).error == "SystemExit: enough"
    assert result(executor, task(chores.add, 1, 1)).value == 2


@pytest.mark.parametrize("death", [chores.die, chores.vanish])
def test_a_death_is_told_and_concerns_no_other_slot(executor, tmp_path, death):
    begun, gate = tmp_path / "begun", tmp_path / "gate"
    executor.start(1, task(chores.wait_for, begun, gate))
    executor.events(0.0)
    wait_until(begun.exists)
    lost = result(executor, task(death))
    assert lost.slot == 0
    assert lost.value is None
    assert lost.error.startswith("its worker process")
    assert result(executor, task(chores.add, 2, 2)) == Ended(0, value=4)
    gate.touch()
    assert events_until_ended(executor, 1) == [Ended(1, value="waited")]


def test_what_cannot_be_sent_is_an_error(executor):
    # What comes back cannot be sent, what goes there cannot, and what is there fails.
    for unsendable in (
        lambda report: (x for x in ()),
        task(chores.add, threading.Lock(), 1),
        task(chores.add, "x", 1),
    ):
        ended = result(executor, unsendable)
        assert ended.error
        assert "its worker process" not in ended.error
    assert result(executor, task(chores.add, 1, 1)).value == 2


def test_processes_compute_with_one_thread_and_stay(executor):
    variables, first = result(executor, task(chores.surroundings)).value
    assert variables["OMP_NUM_THREADS"] == "1"
    assert variables["OPENBLAS_NUM_THREADS"] == "1"
    assert "--xla_cpu_multi_thread_eigen=false" in variables["XLA_FLAGS"]
    assert "small_while_loop_byte_threshold=2000000" in variables["XLA_FLAGS"]
    if not isinstance(executor, SlurmExecutor):  # there, each task is a job of its own
        assert result(executor, task(chores.surroundings)).value[1] == first


def test_nothing_to_tell_is_told_after_the_time(executor):
    start = time.monotonic()
    assert executor.events(timeout=0.3) == []
    assert time.monotonic() - start >= 0.3


# --- Local ----------------------------------------------------------------------------------


def test_processes_are_replaced_after_enough_tasks(tmp_path, monkeypatch):
    monkeypatch.setattr(pool, "TASKS_PER_PROCESS", 2)
    with LocalExecutor(1, tmp_path) as executor:
        pids = [result(executor, task(chores.surroundings)).value[1] for _ in range(4)]
    assert pids[0] == pids[1] != pids[2] == pids[3]


def test_a_process_that_was_killed_while_idle_is_replaced(tmp_path):
    with LocalExecutor(1, tmp_path) as executor:
        pid = result(executor, task(chores.surroundings)).value[1]
        os.kill(pid, signal.SIGKILL)
        wait_until(lambda: executor._processes[0].pool._flags.broken is not None)
        assert result(executor, task(chores.surroundings)).value[1] != pid


def test_a_process_that_grows_stays(tmp_path):
    """Replaced by loky, it might take the next task with it."""
    with LocalExecutor(1, tmp_path) as executor:
        works = (chores.surroundings, chores.grow, chores.surroundings)
        first, grown, last = [result(executor, task(work)).value for work in works]
    assert grown == first[1]
    assert last == first


def test_stopping_kills_what_runs(tmp_path):
    with LocalExecutor(1, tmp_path) as executor:
        executor.start(0, task(chores.wait_for, tmp_path / "begun", tmp_path / "never"))
        wait_until((tmp_path / "begun").exists)
    pid = int((tmp_path / "begun").read_text())
    wait_until(lambda: not Path(f"/proc/{pid}").exists())


def test_workers_do_not_outlive_a_killed_parent(tmp_path):
    script = f"""
        import os, signal, sys, time
        from pathlib import Path
        sys.path.insert(0, {str(HERE)!r})
        import chores
        from bench.execution.pool import LocalExecutor
        place = Path({str(tmp_path)!r})
        executor = LocalExecutor(1, place)
        executor.start(0, chores.task(chores.wait_for, place / "begun", place / "never"))
        while not (place / "begun").exists():
            time.sleep(0.02)
        os.kill(os.getpid(), signal.SIGKILL)
    """
    done = subprocess.run([sys.executable, "-c", textwrap.dedent(script)], check=False)
    assert done.returncode == -signal.SIGKILL
    pid = int((tmp_path / "begun").read_text())
    wait_until(lambda: not Path(f"/proc/{pid}").exists())


@pytest.mark.skipif(not hasattr(os, "sched_setaffinity"), reason="cores cannot be chosen here")
def test_workers_share_the_cores():
    cores = sorted(os.sched_getaffinity(0))
    shares = [share_of_cores(number, len(cores)) for number in range(len(cores))]
    assert sorted(itertools.chain(*shares)) == cores
    assert share_of_cores(0, 1) == cores
    assert share_of_cores(0, len(cores) + 1) == []


# --- Ray ------------------------------------------------------------------------------------


def test_without_ray_the_error_says_what_to_install(monkeypatch):
    monkeypatch.setitem(sys.modules, "ray", None)
    monkeypatch.setitem(sys.modules, "ray.util", None)
    monkeypatch.setitem(sys.modules, "ray.util.scheduling_strategies", None)
    with pytest.raises(UsageError, match=r"needs Ray .*pip install 'fidelity-bench\[ray\]'"):
        RayExecutor(1, 1)


def test_ray_is_imported_only_when_asked_for():
    code = (
        "import sys, bench.execution.cluster, bench.execution.sweep; sys.exit('ray' in sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True)


NODE_KILLED = """
    import os, sys, time
    from pathlib import Path
    sys.path.insert(0, sys.argv[2])
    import chores
    from ray.cluster_utils import Cluster
    from bench.execution.executor import Ended
    from bench.execution.sweep import make_executor

    place = Path(sys.argv[1])
    cluster = Cluster(initialize_head=True, head_node_args={"num_cpus": 1})
    other = cluster.add_node(num_cpus=1)
    os.environ["RAY_ADDRESS"] = cluster.address
    with make_executor("ray", None, 9, place) as executor:
        assert executor.slots == 2, executor.slots
        for slot in (0, 1):
            work = chores.task(chores.wait_for, place / f"begun-{slot}", place / "gate")
            executor.start(slot, work)
        while len(list(place.glob("begun-?"))) < 2:
            time.sleep(0.05)
        cluster.remove_node(other, allow_graceful=False)
        ended = []
        while len(ended) < 2:
            ended += [e for e in executor.events(1.0) if isinstance(e, Ended)]
            if ended:
                (place / "gate").touch()
        assert ended[0].value is None, ended
        assert ended[0].error.startswith("its worker process"), ended
        assert ended[1].value == "waited", ended
        assert {e.slot for e in ended} == {0, 1}
        executor.start(ended[0].slot, chores.task(chores.add, 1, 2))
        while not (last := [e for e in executor.events(1.0) if isinstance(e, Ended)]):
            pass
        assert last[0].value == 3, last
    cluster.shutdown()
"""


@NEEDS_RAY
def test_a_machine_that_is_killed_loses_only_its_task(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join((str(HERE), str(HERE.parents[1]))))
    script = textwrap.dedent(NODE_KILLED)
    subprocess.run([sys.executable, "-c", script, str(tmp_path), str(HERE)], check=True)


# --- Slurm ----------------------------------------------------------------------------------


@NEEDS_SUBMITIT
def test_what_is_ready_at_once_is_one_array_up_to_the_limit_of_the_cluster(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join((str(HERE), str(HERE.parents[1]))))
    fake_slurm.install(monkeypatch, tmp_path)
    assert array_limit() == 3
    with SlurmExecutor(None, 4, tmp_path / "logs") as executor:
        assert executor.slots == 4
        for slot in range(4):
            executor.start(slot, task(chores.add, slot, 10))
        ends = [e for e in events_until_ended(executor, 4) if isinstance(e, Ended)]
    assert sorted(e.value for e in ends) == [10, 11, 12, 13]
    assert {e.slot: e.value for e in ends} == {slot: slot + 10 for slot in range(4)}
    assert (tmp_path / "arrays").read_text().split() == ["3", "1"]
    scripts = [path.read_text() for path in sorted(tmp_path.glob("*.script"))]
    assert "#SBATCH --array=0-2%3" in scripts[0]
    assert "#SBATCH --time=1440" in scripts[0]


@NEEDS_SUBMITIT
def test_stopping_cancels_the_jobs(tmp_path, monkeypatch):
    monkeypatch.setenv("PYTHONPATH", os.pathsep.join((str(HERE), str(HERE.parents[1]))))
    fake_slurm.install(monkeypatch, tmp_path)
    with SlurmExecutor(1, 1, tmp_path / "logs") as executor:
        executor.start(0, task(chores.wait_for, tmp_path / "begun", tmp_path / "never"))
        executor.events(0.0)
        wait_until((tmp_path / "begun").exists)
    pid = int((tmp_path / "begun").read_text())
    wait_until(lambda: not Path(f"/proc/{pid}").exists())
    assert [path.read_text() for path in tmp_path.glob("*.state")] == ["CANCELLED"]


def test_without_submitit_or_slurm_the_error_says_what_is_needed(tmp_path, monkeypatch):
    monkeypatch.setattr("shutil.which", lambda name: None)
    if importlib.util.find_spec("submitit"):
        with pytest.raises(UsageError, match=r"must be given on a machine that can submit jobs"):
            SlurmExecutor(1, 1, tmp_path)
    monkeypatch.setitem(sys.modules, "submitit", None)
    with pytest.raises(UsageError, match=r"needs submitit .*pip install 'fidelity-bench\[slurm\]'"):
        SlurmExecutor(1, 1, tmp_path)


# --- Accelerators ---------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("gpus", "slots", "share"),
    [
        (0.0, 4, 0.0),
        (1.0, 4, 0.25),
        (8.0, 4, 2.0),
        (1.0, 3, 0.3333),
        (4.0, 6, 0.5),
        (3.0, 4, 0.5),
    ],
)
def test_tasks_on_ray_share_the_accelerators(gpus, slots, share):
    """A part lies on one accelerator; all tasks find a place at once."""
    assert gpu_share(gpus, slots) == share
    if 0.0 < share < 1.0:
        assert gpus * int(1.0 / share) >= slots
    else:
        assert slots * share <= gpus


@pytest.mark.parametrize(("variable", "hidden"), [("", True), ("-1", True), ("0,1", False)])
def test_accelerators_may_be_hidden(monkeypatch, variable, hidden):
    monkeypatch.delenv("JAX_PLATFORMS", raising=False)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object())
    monkeypatch.setattr(Path, "exists", lambda self: str(self) == "/dev/nvidiactl")
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", variable)
    assert accelerated() is not hidden


def test_who_gives_tasks_to_accelerators_may_have_none(monkeypatch):
    monkeypatch.setenv("JAX_PLATFORMS", "cpu")
    assert environment(accelerator=True)["JAX_DEFAULT_MATMUL_PRECISION"] == "highest"


def test_without_an_accelerator_seeds_train_apart(monkeypatch):
    monkeypatch.setenv("JAX_PLATFORMS", "cpu")
    assert not accelerated()
    assert seeds_together() == 1
    assert "JAX_DEFAULT_MATMUL_PRECISION" not in environment()


def test_an_accelerator_trains_seeds_together_and_in_full_precision(monkeypatch):
    monkeypatch.delenv("JAX_PLATFORMS", raising=False)
    monkeypatch.setattr("importlib.util.find_spec", lambda name: object())
    monkeypatch.setattr(Path, "exists", lambda self: str(self) == "/dev/nvidiactl")
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    assert accelerated()
    assert seeds_together() > 1
    assert environment()["JAX_DEFAULT_MATMUL_PRECISION"] == "highest"
