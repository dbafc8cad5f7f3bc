"""`bench run`: train and evaluate what a suite asks for."""

from pathlib import Path
from typing import Annotated, Literal

from bench.cli.checks import check_number, check_place, check_tables
from bench.cli.options import Part, Repeatable
from bench.text.errors import UsageError


def run(
    suite: str | None = None,
    /,
    *,
    part: Part | None = None,
    out: Path | None = None,
    jobs: int | None = None,
    executor: Literal["local", "ray", "slurm"] = "local",
    together: int | None = None,
    fail_fast: Annotated[bool, Repeatable] = False,
    retry_failed: Annotated[bool, Repeatable] = False,
    replace: Annotated[bool, Repeatable] = False,
    against: Path | None = None,
    reuse: Annotated[list[Path] | None, Repeatable] = None,
) -> int:
    """Train and evaluate the runs of a suite, then write tables, leaderboard and report.

    Finished runs are not repeated: give the same command again to resume. Rows of other runs stay
    in the tables. If a method starts from another method's policy, that method is run, too. --task,
    --team-size and --method may name what the suite does not list. Where methods flew in three
    worlds or more, their scores by world are shown and written to worlds.md.

    Parameters
    ----------
    suite
        Name of a built-in suite (`bench list` shows them) or path of a TOML file; default: quick,
        or with --against the suite that its folder is named after.
    out
        Folder for tables and documents; default: results/SUITE and reports/SUITE, or results/mine
        with --against.
    jobs
        Number of worker processes; default: one per core, or 4 if there is an accelerator; with
        --executor slurm the number of jobs at a time, up to 64 by default.
    executor
        Where the workers run: on this machine, on the Ray cluster at RAY_ADDRESS, or in jobs of the
        Slurm cluster to which this machine can submit.
    together
        How many runs that differ only in their seed a worker trains in one program; default: 1, or
        16 if there is an accelerator.
    fail_fast
        Stop at the first run that fails.
    retry_failed
        Try runs again that failed in an earlier call. Interrupted runs are always tried again.
    replace
        Train runs again that another version of the program or another machine trained, and
        replace their rows.
    against
        Folder of tables, such as results/paper: leaderboard and report show its rows of the same
        tasks and team sizes beside yours, and say what cannot be compared. Its files stay as they
        are.
    reuse
        Folder of tables, such as results/paper; may be repeated. Its finished runs that the suite
        asks for, too, are not trained again: their rows are copied, and policies that others start
        from come from its kept ones.
    """
    check_number("jobs", jobs)
    check_number("together", together)
    if against is not None:
        check_tables(against)
        out = out or Path("results") / "mine"
        if out.resolve() == against.resolve():
            raise UsageError(
                f"--out and --against are both {out}; own rows need a folder of their own."
            )
    check_tables(*(reuse or ()))
    chosen = (part or Part()).of(suite or (against.resolve().name if against else "quick"))
    tables_dir = out or Path("results") / chosen.name
    documents_dir = out or Path("reports") / chosen.name
    check_place(tables_dir, documents_dir)
    from bench.execution.sweep import INTERRUPTED, sweep
    from bench.paper.worlds_page import add_worlds_page
    from bench.plan.expansion import expand

    status = sweep(
        expand(chosen),
        tables_dir,
        documents_dir,
        jobs,
        executor=executor,
        together=together,
        fail_fast=fail_fast,
        retry_failed=retry_failed,
        replace=replace,
        against=against,
        reuse=reuse or (),
    )
    if status != INTERRUPTED:
        add_worlds_page(tables_dir, documents_dir)
    return status
