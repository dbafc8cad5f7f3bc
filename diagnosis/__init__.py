"""Why a simulator and reality part: which effect is missing, how sure, how much it explains.

For scripts and notebooks: `diagnosis.diagnose` answers, `diagnosis.corrected` makes the simulator
that has what was found.
"""

import lazy_loader

import simulators  # noqa: F401 - before SciPy, which crazyflow wants with its array API

# The names of __init__.pyi; each is imported when it is first used.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
