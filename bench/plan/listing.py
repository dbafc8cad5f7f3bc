"""What there is to run: plug-ins with the package that each comes from, and suites."""

import sys

from rich.console import Console
from rich.table import Table
from rich.text import Text

from bench.plan.expansion import PlanError, expand
from bench.plan.suite import built_in, load_suite
from simulators import registry


def show_plugins(console: Console) -> None:
    """Prints every registered plug-in; one that cannot be imported with the reason."""
    for kind in registry.GROUPS:
        table = _table(f"{kind.capitalize()}s")
        for name in registry.names(kind):
            try:
                text = Text(_summary(registry.load(kind, name)))
            except registry.BrokenPluginError as error:
                text = Text(f"broken: {error}", "red")
            table.add_row(Text(name, "bold"), Text(registry.distribution(kind, name), "dim"), text)
        console.print(table)


def show_suites(console: Console) -> None:
    """Prints the built-in suites with their number of runs."""
    table = _table("Suites")
    for name in built_in():
        suite = load_suite(name)
        try:
            plan = expand(suite)
        except PlanError as error:
            table.add_row(Text(name, "bold"), Text("0 runs", "dim"), Text(str(error), "red"))
            continue
        table.add_row(
            Text(name, "bold"),
            Text(f"{len(plan.runs)} runs", "dim"),
            Text(suite.description + (" Some are left out: broken plug-ins." * bool(plan.broken))),
        )
    console.print(table)


def _summary(cls: type) -> str:
    """First line on a plug-in: its module's, which is about nothing else, or else its own."""
    for docstring in (sys.modules[cls.__module__].__doc__, cls.__doc__):
        if docstring and docstring.strip():
            return docstring.strip().splitlines()[0]
    return ""


def _table(title: str) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold", box=None)
    for _ in range(3):
        table.add_column(overflow="fold")
    table.show_header = False
    return table
