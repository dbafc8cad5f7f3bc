"""`bench list`: plug-ins with their settings, and suites."""

from typing import Annotated, Literal

from bench.cli.options import Repeatable

Kind = Literal["methods", "tasks", "simulators", "residuals", "effects", "commands", "suites"]
"""What can be listed."""


def list_(kind: Kind | None = None, /, *, settings: Annotated[bool, Repeatable] = False) -> int:
    """Show the registered plug-ins, those of other packages with the package, and the suites.

    Parameters
    ----------
    kind
        Show only these; default: all.
    settings
        Show the settings of every plug-in, with default and meaning, as --setting and suite files
        take them.
    """
    from rich.console import Console

    from bench.plan.listing import show_plugins, show_suites
    from simulators import registry

    console = Console()
    kinds = [name for name in registry.GROUPS if kind in (None, f"{name}s")]
    show_plugins(console, kinds, settings)
    if kind in (None, "suites"):
        show_suites(console)
    return 0
