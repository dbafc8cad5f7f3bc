"""The harness: command line, suites, plan, execution, store, statistics, reports.

For scripts and notebooks: `bench.run` trains and evaluates, `bench.load` reads what is there.
"""

import lazy_loader

import simulators  # noqa: F401 - before SciPy, which crazyflow wants with its array API

# The names of __init__.pyi, each imported when it is first used: `bench --help` must be quick.
__getattr__, __dir__, __all__ = lazy_loader.attach_stub(__name__, __file__)
