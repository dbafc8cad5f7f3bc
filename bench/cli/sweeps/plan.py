"""`bench plan`: what a run would do and cost."""

from pathlib import Path
from typing import Annotated

from bench.cli.checks import check_number, check_tables
from bench.cli.options import Part, Repeatable


def plan(
    suite: str = "quick",
    /,
    *,
    part: Part | None = None,
    out: Path | None = None,
    jobs: int | None = None,
    every: Annotated[bool, Repeatable] = False,
    retry_failed: Annotated[bool, Repeatable] = False,
    reuse: Annotated[list[Path] | None, Repeatable] = None,
) -> int:
    """Show what `bench run` would do, and what it would cost; runs nothing.

    Takes the same arguments, but for those that say how to run (--executor, --together, --replace,
    --against, --fail-fast).

    Shows which runs are finished, which are missing and why, and estimates wall time and
    high-fidelity flight from earlier runs: the tables in the folder and those in results/.

    Parameters
    ----------
    suite
        Name of a built-in suite (`bench list` shows them) or path of a TOML file.
    out
        Folder of the tables; default: results/SUITE.
    jobs
        Number of worker processes to assume; default: as many as `bench run` would start.
    every
        Show one line for each missing run.
    retry_failed
        Count runs that failed in an earlier call as missing.
    reuse
        Folder of tables whose finished runs count as finished here; may be repeated.
    """
    check_number("jobs", jobs)
    check_tables(*(reuse or ()))
    chosen = (part or Part()).of(suite)
    from rich.console import Console

    from bench.execution.outlook import show_plan
    from bench.plan.expansion import expand

    place = out or Path("results") / chosen.name
    return show_plan(
        chosen.name,
        expand(chosen),
        place,
        jobs,
        every,
        Console(),
        retry_failed=retry_failed,
        reuse=reuse or (),
    )
