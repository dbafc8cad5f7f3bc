"""Environment of processes that compute: one XLA thread, whole loops compiled, programs kept."""

import importlib.util
import os
import platform
from pathlib import Path

LOOPS = 2_000_000
"""Bytes that a loop may touch to be compiled into one piece of code instead of a call for every
operation; XLA's own default lets through only the smallest (`reports/performance_tried.md`)."""
OPTIONS = {
    "xla_cpu_multi_thread_eigen": "--xla_cpu_multi_thread_eigen=false",
    "xla_backend_extra_options": (
        f"--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold={LOOPS}"
    ),
}
"""XLA's options, by the name to look for in `XLA_FLAGS`."""
if platform.machine() in ("x86_64", "AMD64"):
    # No fused multiply-add, whose rounding depends on what stands around a product: with it a
    # neutral effect would change the last bit. Matrix products are a library's and keep it.
    OPTIONS["xla_cpu_max_isa"] = "--xla_cpu_max_isa=AVX"


TOGETHER = 16
"""Runs of one kind that an accelerator trains in one program, usually a cell's seeds. On an H200 an
epoch of 16 takes 1.2 to 3 times as long as one of a single run (`reports/performance.md`)."""


DEVICES = {
    "/dev/nvidiactl": "CUDA_VISIBLE_DEVICES",
    "/dev/dxg": "CUDA_VISIBLE_DEVICES",
    "/dev/kfd": "HIP_VISIBLE_DEVICES",
}
"""Device file of each kind of accelerator, and the variable that hides the device."""
HIDDEN = ("", "-1")
"""Values of these variables that hide every device."""


def accelerated() -> bool:
    """Whether JAX will find an accelerator, judged by its plug-in and the device files."""
    allowed = os.environ.get("JAX_PLATFORMS", "")
    if allowed.split(",")[0] == "cpu" or importlib.util.find_spec("jax_plugins") is None:
        return False
    return any(
        Path(device).exists() and os.environ.get(variable) not in HIDDEN
        for device, variable in DEVICES.items()
    )


def seeds_together() -> int:
    """Default number of runs of one kind that a worker trains in one program."""
    return TOGETHER if accelerated() else 1


def xla_flags() -> str:
    """`XLA_FLAGS` with the missing options added."""
    flags = os.environ.get("XLA_FLAGS", "")
    return " ".join([flags, *(text for name, text in OPTIONS.items() if name not in flags)]).strip()


def environment(accelerator: bool | None = None) -> dict[str, str]:
    """Variables for a process that computes; a variable that is already set keeps its value.

    `accelerator`: whether the processes have one; None: if this machine has one.
    """
    cache = Path.home() / ".cache" / "fidelity-bench" / "jax"
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
    if (
        accelerated() if accelerator is None else accelerator
    ):  # else products of 32-bit numbers are rounded to 19 bits before
        defaults["JAX_DEFAULT_MATMUL_PRECISION"] = "highest"
    return {k: os.environ.get(k, v) for k, v in defaults.items()} | {"XLA_FLAGS": xla_flags()}


def compute_here() -> None:
    """Lets this process compute; only before JAX is imported."""
    os.environ.update(environment())
