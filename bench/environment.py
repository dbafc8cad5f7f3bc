"""Environment of processes that compute: one XLA thread, compiled programs kept on disk."""

import os
from pathlib import Path


def environment() -> dict[str, str]:
    """The variables; those that are set already keep their say."""
    cache = Path.home() / ".cache" / "fidelity-bench" / "jax"
    flags = os.environ.get("XLA_FLAGS", "")
    if "xla_cpu_multi_thread_eigen" not in flags:
        flags = f"{flags} --xla_cpu_multi_thread_eigen=false".strip()
    defaults = {
        "JAX_COMPILATION_CACHE_DIR": str(cache),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.5",
        "XLA_PYTHON_CLIENT_PREALLOCATE": "false",  # several workers may share an accelerator
        "TF_CPP_MIN_LOG_LEVEL": "3",  # XLA's remarks on cached programs
        "SCIPY_ARRAY_API": "1",
        "OMP_NUM_THREADS": "1",
        "OPENBLAS_NUM_THREADS": "1",
        "MKL_NUM_THREADS": "1",
    }
    return {k: os.environ.get(k, v) for k, v in defaults.items()} | {"XLA_FLAGS": flags}
