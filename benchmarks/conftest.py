"""What every benchmark runs under: one core, unless it needs more (`all_cores`)."""

import os

import pytest

from bench.execution.environment import environment

CORES = os.sched_getaffinity(0) if hasattr(os, "sched_getaffinity") else set()
if "PYTEST_XDIST_WORKER" in os.environ:  # nothing is measured there
    CORES = set()
if CORES:  # before JAX counts them
    os.sched_setaffinity(0, {min(CORES)})

# Without the folder of programs: a diagnosis would keep its fits there, and then fit nothing.
os.environ |= {k: v for k, v in environment().items() if k != "JAX_COMPILATION_CACHE_DIR"}


@pytest.fixture
def all_cores():
    """Inside, processes that are started may use every core."""
    if CORES:
        os.sched_setaffinity(0, CORES)
    yield
    if CORES:
        os.sched_setaffinity(0, {min(CORES)})
