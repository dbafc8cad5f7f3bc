"""What every benchmark runs under."""

import os

from bench.environment import xla_flags

os.environ.setdefault("SCIPY_ARRAY_API", "1")  # crazyflow wants it before SciPy is imported
os.environ["XLA_FLAGS"] = xla_flags()
