"""The laboratory that checks the diagnosis on causes that it is not told."""

import simulators  # noqa: F401 - before SciPy, which crazyflow wants with its array API
