"""Checks shapes and types in all tests; set up before JAX or anything of ours is imported."""

import os
import socket

from bench.environment import xla_flags

os.environ.setdefault("JAX_PLATFORMS", "cpu")
os.environ["XLA_FLAGS"] = xla_flags()
os.environ.setdefault("SCIPY_ARRAY_API", "1")  # crazyflow wants it before SciPy is imported

import jaxtyping

jaxtyping.install_import_hook(["simulators", "tasks", "diagnosis", "methods"], "beartype.beartype")

import jax  # noqa: E402 - after the settings and the hook above
import pytest  # noqa: E402


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
