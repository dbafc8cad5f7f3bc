"""How much faster two workers are than one; meaningful on a machine that does nothing else."""

import functools
import time

import pytest

from bench.execution.executor import Ended
from bench.execution.pool import LocalExecutor

EPOCHS = 150
"""Of low-fidelity training, in each of four tasks."""


def train(seed, report):
    """Wall time of a training, its compilation not counted [s]."""
    import jax

    from methods.training.bptt import BPTT
    from methods.training.context import Context
    from methods.training.policy import make_policy
    from simulators.point_mass import PointMass
    from tasks.circle import Circle

    task, simulator = Circle(n_drones=3), PointMass()
    policy = make_policy(task, simulator.spec, simulator.action_space, jax.random.key(seed))
    for trainer in (BPTT(epochs=EPOCHS), BPTT(epochs=EPOCHS)):
        start = time.perf_counter()
        trainer.train(task, simulator, policy, jax.random.key(seed), Context(), "benchmark")
    return time.perf_counter() - start


def work(executor, n_tasks):
    """Does `n_tasks` trainings; their wall times."""
    left, free, values = list(range(n_tasks)), list(range(executor.slots)), []
    while len(values) < n_tasks:
        while left and free:
            executor.start(free.pop(), functools.partial(train, left.pop()))
        for event in executor.events(timeout=1.0):
            if isinstance(event, Ended):
                assert not event.error, event.error
                values.append(event.value)
                free.append(event.slot)
    return values


@pytest.mark.parametrize("jobs", [1, 2])
@pytest.mark.usefixtures("all_cores")
def test_four_trainings(benchmark, tmp_path, jobs):
    with LocalExecutor(jobs, tmp_path) as executor:
        work(executor, 2 * jobs)  # processes are there, programs compiled
        benchmark.extra_info["jobs"] = jobs
        benchmark.pedantic(lambda: work(executor, 4), rounds=1)
