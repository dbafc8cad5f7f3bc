"""`bench profile`: where an epoch of training goes."""

import os
from typing import Annotated

from bench.cli.options import Repeatable


def profile(
    method: str,
    task: str,
    /,
    *,
    team_size: Annotated[list[int] | None, Repeatable] = None,
    setting: Annotated[list[str] | None, Repeatable] = None,
) -> int:
    """Show where an epoch of training goes, how long it takes and what it could take at best.

    Nothing is written. Hybrid and grey_box fly and fit first, as they do before they train.

    Parameters
    ----------
    method
        Registered name of the method.
    task
        Registered name of the task.
    team_size
        Drones; may be repeated. Without it, 3, 12 and 18.
    setting
        Setting of the method, such as trainer.n_worlds=4; may be repeated.
    """
    from bench.execution.environment import environment

    os.environ.update(environment())
    from bench.conformance.command import parse
    from bench.report.profile import run_profile

    return run_profile(method, task, team_size or (3, 12, 18), parse(setting or ()))
