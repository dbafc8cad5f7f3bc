"""What flies: the point mass (low fidelity), crazyflow (high fidelity), effects, tracking."""

import os

# crazyflow needs SciPy's array API, which is switched on when SciPy is first imported: by then it
# may be too late, so that this cannot wait for `simulators.crazyflow`.
os.environ.setdefault("SCIPY_ARRAY_API", "1")
