"""`bench keep`: trained policies kept beside their tables."""

from pathlib import Path
from typing import Annotated

from bench.cli.checks import check_names, check_tables
from bench.cli.options import Repeatable


def keep(
    directory: Path,
    /,
    *,
    task: Annotated[list[str] | None, Repeatable] = None,
    team_size: Annotated[list[int] | None, Repeatable] = None,
) -> int:
    """Keep trained policies beside their tables, so that they can be deployed.

    Adds the policies of runs with default settings whose folder still exists, in one file for each
    task and team size. Kept policies stay, unless their row was replaced. If a method starts from
    another's policy, `bench run` takes it from these files instead of training it.

    Parameters
    ----------
    directory
        Folder with the tables and runs, such as results/paper.
    task
        Only this task; may be repeated.
    team_size
        Only this number of drones; may be repeated.
    """
    check_tables(directory)
    check_names("task", task or ())
    from bench.execution.policies import keep as keep_policies

    kept = keep_policies(directory, task or (), team_size or ())
    for path, count in kept.items():
        print(f"{path}: {count} policies")  # noqa: T201
    if not kept:
        print(  # noqa: T201
            f"Nothing to keep: {directory} has no rows with default settings in the undisturbed "
            "simulator for these tasks and team sizes."
        )
    return 0
