"""What every benchmark runs under."""

import os

os.environ.setdefault("SCIPY_ARRAY_API", "1")  # crazyflow wants it before SciPy is imported
