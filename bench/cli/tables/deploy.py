"""`bench deploy`: kept policies flown in any reality."""

import os
from pathlib import Path
from typing import Annotated

from bench.cli.options import Repeatable


def deploy(
    directory: Path,
    task: str,
    team_size: int,
    /,
    *,
    reality: str = "",
    method: Annotated[list[str] | None, Repeatable] = None,
) -> int:
    """Fly the kept policies of a cell, in any reality, and show what they are worth there.

    Parameters
    ----------
    directory
        Folder with the tables and policies, such as results/paper.
    task
        Registered name of the task.
    team_size
        Number of drones.
    reality
        Simulator and effects, such as crazyflow+mass(e=0.2); without it, crazyflow as it is.
    method
        Only this method; may be repeated.
    """
    from bench.execution.environment import environment

    os.environ.update(environment())
    from rich.console import Console

    from bench.execution.policies import deploy as deploy_policies

    return deploy_policies(directory, task, team_size, reality, method or (), Console())
