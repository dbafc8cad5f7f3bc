"""What every benchmark runs under: one core, unless it needs more (`all_cores`)."""

import os

import pytest

from bench.execution.environment import xla_flags

CORES = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
if CORES:  # before JAX counts them
    os.sched_setaffinity(0, {min(CORES)})

os.environ.setdefault("SCIPY_ARRAY_API", "1")  # crazyflow wants it before SciPy is imported
os.environ["XLA_FLAGS"] = xla_flags()


@pytest.fixture
def all_cores():
    """Inside, processes that are started may use every core."""
    if CORES:
        os.sched_setaffinity(0, CORES)
    yield
    if CORES:
        os.sched_setaffinity(0, {min(CORES)})
