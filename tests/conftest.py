"""Checks shapes and types in all tests; set up before JAX or anything of ours is imported."""

import gc
import os
import socket
from pathlib import Path

import pytest
from skips import SkipsCount

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
from jax._src import pjit  # noqa: E402
from jax._src.interpreters import pxla  # noqa: E402

PROGRAMS = Path.home() / ".cache" / "fidelity-bench" / "tests"
"""Where XLA's programs and the replay's traced ones are kept from one call of pytest to the next,
under the hash of all that goes into them; `make clean` removes them. `JAX_COMPILATION_CACHE_DIR`
stays unset: the diagnosis would keep its fits there, too, and the tests would then fit nothing."""
# 98 programs of a line or two took 3.4 s of processor time to compile and 1.0 s to read.
jax.config.update("jax_compilation_cache_dir", str(PROGRAMS))
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
# Processes that tests start keep theirs, too.
os.environ.setdefault("JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS", "0")

# Tracing makes many small objects, and at Python's own thresholds the collector looks for cycles
# among them all the time: `tests/simulators/test_effect_physics.py` takes 39 for 45 s.
gc.set_threshold(100_000, 50, 100)

pytest_plugins = ["pytester"]

MAPS = 30_000
"""Memory maps of a process at which it forgets compiled programs. Linux allows 65,530, and all
tests in one process need more: compilation then ends with a MemoryError or a segmentation fault."""


def pytest_addoption(parser):
    """Adds the option that `.ci/run` sets."""
    parser.addoption(
        "--known-skips-only",
        action="store_true",
        help="fail if a test is skipped for a reason that tests/skips.py does not list",
    )


LONGEST = ("test_real_flights.py", "test_simulators.py", "test_pilot_crazyflie.py", "test_pilot.py")
"""Files of few tests that take long: begun last, they would leave the other processes idle."""


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items):
    """Puts the longest files first; processes take files in this order."""
    items.sort(key=lambda item: item.path.name not in LONGEST)


def pytest_configure(config):
    """Counts skips, once: in the process that collects the reports of all others."""
    if config.getoption("--known-skips-only") and not hasattr(config, "workerinput"):
        config.pluginmanager.register(SkipsCount(), "skips-count")


@pytest.fixture(scope="session")
def program_cache():
    """The folder of compiled programs, for processes that a test starts."""
    return PROGRAMS


@pytest.fixture(scope="module", autouse=True)
def _room_for_programs():
    """What a module leaves is no obstacle to those that come after it."""
    yield
    # JAX keeps what it lowered last, and each kept module slows every later compilation: programs
    # of one line took 55 ms after 1,500 others, 30 ms with these two caches cleared now and then.
    pjit._pjit_lower.cache_clear()
    pxla._cached_lowering_to_hlo.cache_clear()
    maps = Path("/proc/self/maps")
    if maps.is_file() and maps.read_bytes().count(b"\n") > MAPS:
        jax.clear_caches()


@pytest.fixture(autouse=True)
def _own_environment():
    """Variables that a command sets for this process are gone after its test."""
    before = dict(os.environ)
    yield
    if os.environ != before:
        os.environ.clear()
        os.environ.update(before)


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
