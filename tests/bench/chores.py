"""Tasks for the tests of executors: they add, wait, fail or die."""

import functools
import os
import signal
import sys
import time
from pathlib import Path


def task(function, *args):
    """What an executor takes."""
    return functools.partial(function, *map(str, args))


def add(a, b, report):
    report("adding", int(a))
    report("adding", int(b))
    return int(a) + int(b)


def mistake(report):
    report("about to fail")
    raise ValueError("the propellers\nfell off")


def leave(report):
    sys.exit("enough")


def die(report):
    os.kill(os.getpid(), signal.SIGKILL)


def vanish(report):
    os._exit(3)


def wait_for(begun, gate, report):
    """Writes its process id to `begun`, waits for the file `gate`."""
    part = Path(begun).with_suffix(".part")
    part.write_text(str(os.getpid()))
    part.rename(begun)
    while not Path(gate).exists():
        time.sleep(0.02)
    return "waited"


GROWN = []


def grow(report):
    """Takes 400 MB and keeps them, as compiled programs do; slowly enough for loky to look."""
    time.sleep(1.1)
    GROWN.append(bytearray(os.urandom(1)) * 400_000_000)
    return os.getpid()


def surroundings(report):
    """What XLA and BLAS will see, whether JAX was there before, and this process."""
    names = ("XLA_FLAGS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "SCIPY_ARRAY_API")
    return {name: os.environ.get(name, "") for name in names}, os.getpid()
