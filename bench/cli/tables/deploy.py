"""`bench deploy`: kept policies flown in any reality."""

from pathlib import Path
from typing import Annotated

from bench.cli.checks import check_names, check_reality, check_tables
from bench.cli.options import Repeatable
from bench.execution.environment import compute_here


def deploy(
    directory: Path,
    task: str,
    team_size: int,
    /,
    *,
    reality: str = "",
    method: Annotated[list[str] | None, Repeatable] = None,
) -> int:
    """Fly kept policies of a task and team size in any reality, and show their rewards there.

    Parameters
    ----------
    directory
        Folder with the tables and policies, such as results/paper.
    task
        Registered name of the task.
    team_size
        Number of drones.
    reality
        Simulator and effects, such as crazyflow+mass(e=0.2); default: crazyflow without effects.
    method
        Only this method; may be repeated.
    """
    check_tables(directory)
    check_names("task", [task])
    check_names("method", method or ())
    if reality:
        check_reality(reality)
    compute_here()
    from rich.console import Console

    from bench.execution.policies import deploy as deploy_policies

    return deploy_policies(directory, task, team_size, reality, method or (), Console())
