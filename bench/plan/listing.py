"""What there is to run: plug-ins with their settings, and suites."""

import dataclasses
import sys
from collections.abc import Collection

from rich.console import Console
from rich.table import Table
from rich.text import Text

from bench.plan.expansion import PlanError, expand
from bench.plan.setting_lines import setting_lines
from bench.plan.suite import built_in, load_suite
from simulators import registry

OURS = "fidelity-bench"
"""The package of the built-in plug-ins, which is not shown beside them."""


def show_plugins(console: Console, kinds: Collection[str], settings: bool = False) -> None:
    """Prints registered plug-ins; one that cannot be imported with the reason.

    Args:
        console: Where they are shown.
        kinds: Which kinds of them.
        settings: Whether each is followed by its settings with defaults and meanings.
    """
    for kind in kinds:
        table = _table(f"{kind.capitalize()}s")
        for name in registry.names(kind):
            try:
                cls = registry.load(kind, name)
                text = Text(_summary(cls))
            except registry.BrokenPluginError as error:
                cls, text = None, Text(f"broken: {error}", "red")
            package = registry.distribution(kind, name)
            if package.split()[0] != OURS:
                text.append(f" ({package})", "dim")
            table.add_row(Text(name, "bold"), text)
            if settings and isinstance(cls, type) and dataclasses.is_dataclass(cls):
                for line in setting_lines(cls):
                    table.add_row(
                        f"  {line.key}", Text.assemble((line.default, "cyan"), "  ", line.meaning)
                    )
        console.print(table)


def show_suites(console: Console) -> None:
    """Prints the built-in suites with their number of runs."""
    table = _table("Suites")
    for name in built_in():
        suite = load_suite(name)
        try:
            plan = expand(suite)
        except PlanError as error:
            table.add_row(Text(name, "bold"), Text(f"0 runs. {error}", "red"))
            continue
        left_out = " Some runs are left out, because a plug-in is broken." * bool(plan.broken)
        table.add_row(Text(name, "bold"), f"{len(plan.runs)} runs. {suite.description}{left_out}")
    console.print(table)


def _summary(cls: type) -> str:
    """First line on a plug-in: its module's, which is about nothing else, or else its own."""
    for docstring in (sys.modules[cls.__module__].__doc__, cls.__doc__):
        if docstring and docstring.strip():
            return docstring.strip().splitlines()[0]
    return ""


def _table(title: str) -> Table:
    table = Table(title=title, title_justify="left", title_style="bold", box=None)
    table.add_column(no_wrap=True, overflow="ignore")
    table.add_column()
    table.show_header = False
    return table
