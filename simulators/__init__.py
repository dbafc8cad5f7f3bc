"""What flies: the point mass (low fidelity), crazyflow (high fidelity), effects, tracking."""

import os
import sys

# crazyflow needs SciPy's array API, which is switched on when SciPy is first imported. If it was
# imported without, crazyflow says so, and what to do; set now, the variable would only hide that.
if "scipy" not in sys.modules:
    os.environ.setdefault("SCIPY_ARRAY_API", "1")
