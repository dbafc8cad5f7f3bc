"""`bench keep`: trained policies kept beside their tables."""

from pathlib import Path
from typing import Annotated

from bench.cli.options import Repeatable


def keep(
    directory: Path,
    /,
    *,
    task: Annotated[list[str] | None, Repeatable] = None,
    team_size: Annotated[list[int] | None, Repeatable] = None,
) -> int:
    """Keep trained policies beside their tables, one file a cell, so that they can be deployed.

    Policies of default settings whose run's folder is there are added; kept ones stay as they are,
    unless their row was replaced. `bench run` restores parents from them instead of training.

    Parameters
    ----------
    directory
        Folder with the tables and runs, such as results/paper.
    task
        Only this task; may be repeated.
    team_size
        Only this number of drones; may be repeated.
    """
    from bench.execution.policies import keep as keep_policies

    for path, count in keep_policies(directory, task or (), team_size or ()).items():
        print(f"{path}: {count} policies")  # noqa: T201
    return 0
