"""`bench run`: train and evaluate what a suite asks for."""

import os
from pathlib import Path
from typing import Annotated, Literal

from bench.cli.options import Part, Repeatable, check_number
from bench.text.errors import UsageError


def run(
    suite: str = "quick",
    /,
    *,
    part: Part | None = None,
    out: Path | None = None,
    jobs: int | None = None,
    executor: Literal["local", "ray"] = "local",
    together: int | None = None,
    fail_fast: Annotated[bool, Repeatable] = False,
    retry_failed: Annotated[bool, Repeatable] = False,
    replace: Annotated[bool, Repeatable] = False,
) -> int:
    """Train and evaluate what a suite asks for, then write tables, leaderboard and report.

    Runs that are finished already are not repeated, so running again is resuming. Rows of other
    runs stay in the tables as they are. Parents that a method starts from are run too. Filters may
    be repeated, and need not be in the suite.

    Parameters
    ----------
    suite
        Name of a built-in suite (`bench list` shows them) or path of a TOML file.
    out
        Folder for everything; without it, tables go to results/SUITE, documents to reports/SUITE.
    jobs
        Number of worker processes; without it, one per core, or 4 on an accelerator.
    executor
        Where they are: on this machine, or on the Ray cluster that RAY_ADDRESS names.
    together
        Most runs, alike but for their seed, that a worker trains in one program; without it, 1, or
        16 on an accelerator.
    fail_fast
        Stop at the first run that fails.
    retry_failed
        Try runs again that failed in an earlier call. Interrupted ones are tried again anyway.
    replace
        Train runs again whose rows another program or machine made, and replace those rows.
    """
    chosen = (part or Part()).of(suite)
    check_number("jobs", jobs)
    check_number("together", together)
    tables_dir = out or Path("results") / chosen.name
    documents_dir = out or Path("reports") / chosen.name
    _check_folders(tables_dir, documents_dir)
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")  # leave it to the workers
    from bench.execution.sweep import sweep
    from bench.plan.expansion import expand

    return sweep(
        expand(chosen),
        tables_dir,
        documents_dir,
        jobs,
        executor=executor,
        together=together,
        fail_fast=fail_fast,
        retry_failed=retry_failed,
        replace=replace,
    )


def _check_folders(*directories: Path) -> None:
    for directory in directories:
        if directory.exists() and not directory.is_dir():
            raise UsageError(f"{directory} is not a folder, so nothing can be written there.")
