"""`bench plan`: what a run would do and cost."""

from pathlib import Path
from typing import Annotated

from bench.cli.options import Part, Repeatable, check_number


def plan(
    suite: str = "quick",
    /,
    *,
    part: Part | None = None,
    out: Path | None = None,
    jobs: int | None = None,
    every: Annotated[bool, Repeatable] = False,
    retry_failed: Annotated[bool, Repeatable] = False,
) -> int:
    """Show what `bench run` would do with the same arguments, and what it would cost; runs nothing.

    What is finished, what is missing and why, and the expected wall time and high-fidelity flight
    from the tables in the folder and in results/.

    Parameters
    ----------
    suite
        Name of a built-in suite (`bench list` shows them) or path of a TOML file.
    out
        Folder of the tables; without it, results/SUITE.
    jobs
        Number of worker processes to reckon with; without it, as many as `bench run` starts.
    every
        Show a line for every missing run.
    retry_failed
        Reckon with runs that failed in an earlier call, too.
    """
    chosen = (part or Part()).of(suite)
    check_number("jobs", jobs)
    from rich.console import Console

    from bench.execution.outlook import show_plan
    from bench.plan.expansion import expand

    place = out or Path("results") / chosen.name
    return show_plan(
        chosen.name, expand(chosen), place, jobs, every, Console(), retry_failed=retry_failed
    )
