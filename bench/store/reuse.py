"""Finished runs of other folders that a sweep need not train again: the same key, the same run."""

from collections.abc import Sequence
from pathlib import Path

from bench.plan.expansion import Plan
from bench.store.tables import Tables


def reusable(plan: Plan, folders: Sequence[Path]) -> Tables:
    """Rows of the planned runs in other folders of tables; of a run in two, the first folder's.

    A key holds all that decides a result, so a row with a planned run's key is that run's. Rows of
    failed runs stay where they are.

    Raises:
        TableError: A folder holds no tables, or they cannot be read.
    """
    keys = {run.name: run.key for run in plan.runs}
    found = Tables.empty()
    for folder in folders:
        tables = Tables.load(folder)
        columns = (tables.runs[name] for name in ("run", "key", "status"))
        same = {
            run
            for run, key, status in zip(*columns, strict=True)
            if keys.get(run) == key and status != "failed"
        }
        found = found.merged(tables.of_runs(same))
    return found
