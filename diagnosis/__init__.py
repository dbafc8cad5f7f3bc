"""Why a simulator and reality part: which effect is missing, how sure, how much it explains."""

import simulators  # noqa: F401 - before SciPy, which crazyflow wants with its array API
