"""`bench profile`: where an epoch of training goes."""

from typing import Annotated

from bench.cli.checks import check_names
from bench.cli.options import Repeatable
from bench.execution.environment import compute_here


def profile(
    method: str,
    task: str,
    /,
    *,
    team_size: Annotated[list[int] | None, Repeatable] = None,
    setting: Annotated[list[str] | None, Repeatable] = None,
) -> int:
    """Show how long an epoch of training takes, which parts take it, and how short it could be.

    Writes nothing. Methods that calibrate (hybrid, grey_box) fly and fit first.

    Parameters
    ----------
    method
        Registered name of the method.
    task
        Registered name of the task.
    team_size
        Number of drones; may be repeated; default: 3, 12 and 18.
    setting
        Setting of the method, such as trainer.n_worlds=4; may be repeated.
    """
    from bench.plan.keys import nested, parse_settings

    check_names("method", [method])
    check_names("task", [task])
    settings = nested(parse_settings(setting or ()))
    compute_here()
    from bench.report.profile import run_profile

    return run_profile(method, task, team_size or (3, 12, 18), settings)
