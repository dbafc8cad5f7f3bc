"""A suite with settings of the command line in place of its own."""

import dataclasses
from collections.abc import Mapping

from bench.plan.keys import Setting, nested
from bench.plan.suite import Row, Suite, SuiteError

TABLES = ("settings", "task_settings", "nominal")
"""Tables of a suite's row that hold settings: of its method, task and low-fidelity simulator."""


def overridden(suite: Suite, settings: Mapping[str, Setting]) -> Suite:
    """`suite` in which every row has these settings.

    A key is written as in a suite file: `task_settings.horizon`, `nominal.attitude_tau`,
    `settings.trainer.epochs`, where `settings.` may be left out. Planning checks keys and types by
    the plug-ins' classes.

    Raises:
        SuiteError: A table is given a value instead of fields.
        UsageError: Two keys contradict each other.
    """
    given = nested(settings)
    tables: dict[str, Mapping[str, Setting]] = {}
    for name in TABLES:
        table = given.pop(name, {})
        if not isinstance(table, dict):
            raise SuiteError(
                f"Setting '{name}' needs a field, such as {name}.KEY=VALUE, got {table!r}."
            )
        tables[name] = table
    tables["settings"] = merged(given, tables["settings"])

    def changed(row: Row) -> Row:
        own = {name: merged(getattr(row, name), table) for name, table in tables.items()}
        return dataclasses.replace(row, **own)

    return dataclasses.replace(suite, methods=tuple(changed(row) for row in suite.methods))


def merged(base: Mapping[str, Setting], new: Mapping[str, Setting]) -> dict[str, Setting]:
    """`base` with the fields of `new`, table by table."""
    found = dict(base)
    for key, value in new.items():
        old = found.get(key)
        if isinstance(old, dict) and isinstance(value, dict):
            value = merged(old, value)
        found[key] = value
    return found
