"""`bench list`: plug-ins and suites."""


def list_() -> int:
    """Show the registered plug-ins, the package of each, and the built-in suites."""
    from rich.console import Console

    from bench.plan.listing import show_plugins, show_suites

    console = Console()
    show_plugins(console)
    show_suites(console)
    return 0
