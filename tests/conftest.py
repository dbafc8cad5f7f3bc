"""Checks shapes and types in all tests; set up before JAX or anything of ours is imported."""

import os
import socket
from pathlib import Path

from bench.execution.environment import xla_flags

os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ["XLA_FLAGS"] = xla_flags()
os.environ.setdefault("SCIPY_ARRAY_API", "1")  # crazyflow wants it before SciPy is imported

import jaxtyping

CHECKED = ["simulators", "tasks", "diagnosis", "methods", "blind.draw", "blind.fly", "blind.score"]
ARRAYS = ["stats.bootstrap", "conformance", "diagnosis_report.figures", "report.flown"]
"""Modules of `bench` that take arrays; tests give the others stand-ins."""
jaxtyping.install_import_hook([*CHECKED, *(f"bench.{m}" for m in ARRAYS)], "beartype.beartype")

import jax  # noqa: E402 - after the settings and the hook above
import pytest  # noqa: E402

MAPS = 30_000
"""Memory maps of a process at which it forgets compiled programs. Linux allows 65,530, and all
tests in one process need more: compilation then ends with a MemoryError or a segmentation fault."""


@pytest.fixture(scope="module", autouse=True)
def _room_for_programs():
    """What a module leaves is no obstacle to those that come after it."""
    yield
    maps = Path("/proc/self/maps")
    if maps.is_file() and maps.read_bytes().count(b"\n") > MAPS:
        jax.clear_caches()


@pytest.fixture
def key():
    """A fixed JAX key."""
    return jax.random.key(0)


@pytest.fixture(scope="session", autouse=True)
def _no_network():
    """Connections to other machines fail."""
    connect = socket.socket.connect

    def local_only(self, address):
        if isinstance(address, tuple) and address[0] not in ("127.0.0.1", "::1", "localhost"):
            raise OSError(f"Tests must not use the network, but one connects to {address}.")
        return connect(self, address)

    socket.socket.connect = local_only
    yield
    socket.socket.connect = connect
