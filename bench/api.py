"""The harness from Python: `bench.run` does what `bench run` does, `bench.load` reads tables."""

import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

from bench.execution.sweep import INTERRUPTED, sweep
from bench.paper.worlds_page import add_worlds_page
from bench.plan.expansion import expand
from bench.plan.keys import Setting
from bench.plan.override import overridden
from bench.plan.suite import Suite, load_suite
from bench.store.tables import Tables
from bench.text.errors import UsageError


def load(path: Path | str) -> Tables:
    """The tables in a folder that `bench run` wrote, such as results/paper.

    `bench.load(path).to_pandas()` has a row a run and a column a metric; the fields `results`,
    `runs`, `curves` and `trajectories` are the stored tables.

    Raises:
        TableError: A table is missing, cannot be read, or has other columns or values.
    """
    return Tables.load(Path(path))


def run(
    suite: Suite | Path | str = "quick",
    *,
    tasks: Sequence[str] = (),
    team_sizes: Sequence[int] = (),
    methods: Sequence[str] = (),
    residuals: Sequence[str] = (),
    seeds: int | None = None,
    quick: bool = False,
    settings: Mapping[str, Setting] | None = None,
    out: Path | str | None = None,
    jobs: int | None = None,
    executor: Literal["local", "ray", "slurm"] = "local",
    together: int | None = None,
    fail_fast: bool = False,
    retry_failed: bool = False,
    replace: bool = False,
    reuse: Sequence[Path | str] = (),
) -> Tables:
    """Trains and evaluates the runs of a suite, writes tables and documents, returns the tables.

    Finished runs are not repeated, and rows of other runs stay in the tables. A run that failed
    has the status `failed` and its cause in the table `runs`.

    Args:
        suite: Name of a built-in suite, path of a TOML file, or a suite.
        tasks: Only these tasks.
        team_sizes: Only these numbers of drones.
        methods: Only these methods.
        residuals: Only methods with one of these residuals.
        seeds: Only so many seeds, from the suite's first on.
        quick: Whether only the suite's quick part is run.
        settings: Other values of settings, by key as in a suite file: `{"trainer.epochs": 50,
            "task_settings.horizon": 100}`.
        out: Folder for tables and documents; None: results/SUITE and reports/SUITE.
        jobs: Number of worker processes; None: as many as suit the machine.
        executor: Where they are: on this machine, on the Ray cluster at RAY_ADDRESS, or in jobs of
            the Slurm cluster to which this machine can submit.
        together: How many runs that differ only in their seed a worker trains in one program;
            None: as many as suit the device.
        fail_fast: Whether the first failure ends the runs.
        retry_failed: Whether runs that failed in an earlier call are tried again.
        replace: Whether rows of another program or machine are replaced.
        reuse: Folders of tables whose finished runs of the suite are not trained again.

    Raises:
        KeyboardInterrupt: Ctrl-C; finished runs are kept, and the same call resumes.
        UsageError: The request cannot be carried out; nothing was done.
    """
    lists = {"tasks": tasks, "methods": methods, "residuals": residuals, "reuse": reuse}
    for name, value in lists.items():
        if isinstance(value, str):
            raise UsageError(f"`{name}` must be a list of names, got the text '{value}'.")
    for name, number in {"seeds": seeds, "jobs": jobs, "together": together}.items():
        if number is not None and (not isinstance(number, int) or number < 1):
            raise UsageError(f"`{name}` must be a whole number from 1 on, or None, got {number!r}.")
    found = suite if isinstance(suite, Suite) else load_suite(str(suite))
    found = found.quickly() if quick else found
    chosen = found.select(tasks, team_sizes, methods, residuals, seeds)
    tables_dir = Path(out) if out is not None else Path("results") / chosen.name
    documents_dir = Path(out) if out is not None else Path("reports") / chosen.name
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")  # leave it to the workers
    status = sweep(
        expand(overridden(chosen, settings or {})),
        tables_dir,
        documents_dir,
        jobs,
        executor=executor,
        together=together,
        fail_fast=fail_fast,
        retry_failed=retry_failed,
        replace=replace,
        reuse=[Path(folder) for folder in reuse],
    )
    if status == INTERRUPTED:
        raise KeyboardInterrupt
    add_worlds_page(tables_dir, documents_dir)
    return load(tables_dir)
