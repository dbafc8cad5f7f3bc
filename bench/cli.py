"""The command line: what users type, and nothing else.

Whatever needs JAX or pandas is imported inside the commands, so that help appears at once.
"""

import dataclasses
import os
import signal
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import cyclopts

from bench.cli_tools import Repeatable, blind, check, deploy, diagnose, doctor, keep, profile
from bench.errors import UsageError
from bench.signals import handled
from simulators.registry import BrokenPluginError, UnknownPluginError

if TYPE_CHECKING:
    from bench.suite import Suite

USAGE_ERRORS = (UsageError, UnknownPluginError, BrokenPluginError)
"""What ends a command with exit status 2 and one line on stderr."""

app = cyclopts.App(
    name="bench",
    help="How should drone-swarm policies be trained across simulator fidelities?",
    version_flags=[],
)

for command in (diagnose, blind, check, profile, keep, deploy, doctor):
    app.command(command)


@cyclopts.Parameter(name="*")
@dataclasses.dataclass(frozen=True)
class Part:
    """Which part of a suite, by options that `bench run` and `bench plan` share."""

    task: Annotated[list[str] | None, Repeatable] = None
    """Only this task."""
    team_size: Annotated[list[int] | None, Repeatable] = None
    """Only this number of drones."""
    method: Annotated[list[str] | None, Repeatable] = None
    """Only this method."""
    residual: Annotated[list[str] | None, Repeatable] = None
    """Only with this residual, and what --method names and takes none."""
    seeds: int | None = None
    """Number of seeds, from the suite's first; rows that have fewer keep their number."""

    def of(self, suite: str) -> "Suite":
        """That part of the suite."""
        from bench.suite import load_suite

        return load_suite(suite).select(
            self.task or (),
            self.team_size or (),
            self.method or (),
            self.residual or (),
            self.seeds,
        )


def _check_number(option: str, value: int | None) -> None:
    if value is not None and value < 1:
        raise UsageError(f"`--{option}` must be at least 1, got {value}.")


@app.command
def run(
    suite: str = "quick",
    /,
    *,
    part: Part | None = None,
    out: Path | None = None,
    jobs: int | None = None,
    executor: Literal["local", "ray"] = "local",
    together: int | None = None,
    fail_fast: Annotated[bool, Repeatable] = False,
    retry_failed: Annotated[bool, Repeatable] = False,
    replace: Annotated[bool, Repeatable] = False,
) -> int:
    """Train and evaluate what a suite asks for, then write tables, leaderboard and report.

    Runs that are finished already are not repeated, so running again is resuming. Rows of other
    runs stay in the tables as they are. Parents that a method starts from are run too. Filters may
    be repeated, and need not be in the suite.

    Parameters
    ----------
    suite
        Name of a built-in suite (`bench list` shows them) or path of a TOML file.
    out
        Folder for everything; without it, tables go to results/SUITE, documents to reports/SUITE.
    jobs
        Number of worker processes; without it, one per core, or 4 on an accelerator.
    executor
        Where they are: on this machine, or on the Ray cluster that RAY_ADDRESS names.
    together
        Most runs, alike but for their seed, that a worker trains in one program; without it, 1, or
        16 on an accelerator.
    fail_fast
        Stop at the first run that fails.
    retry_failed
        Try runs again that failed in an earlier call. Interrupted ones are tried again anyway.
    replace
        Train runs again whose rows another program or machine made, and replace those rows.
    """
    chosen = (part or Part()).of(suite)
    _check_number("jobs", jobs)
    _check_number("together", together)
    tables_dir = out or Path("results") / chosen.name
    documents_dir = out or Path("reports") / chosen.name
    _check_folders(tables_dir, documents_dir)
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")  # leave it to the workers
    from bench.plan import expand
    from bench.sweep import sweep

    return sweep(
        expand(chosen),
        tables_dir,
        documents_dir,
        jobs,
        executor=executor,
        together=together,
        fail_fast=fail_fast,
        retry_failed=retry_failed,
        replace=replace,
    )


@app.command
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
    _check_number("jobs", jobs)
    from rich.console import Console

    from bench.outlook import show_plan
    from bench.plan import expand

    place = out or Path("results") / chosen.name
    return show_plan(
        chosen.name, expand(chosen), place, jobs, every, Console(), retry_failed=retry_failed
    )


@app.command(name="list")
def list_() -> int:
    """Show plug-ins with the package that each comes from, and the built-in suites."""
    from rich.console import Console

    from bench.listing import show_plugins, show_suites

    console = Console()
    show_plugins(console)
    show_suites(console)
    return 0


@app.command
def leaderboard(directory: Path, /, *, out: Path | None = None) -> int:
    """Rebuild leaderboard.md from the tables in a folder, and show it.

    Parameters
    ----------
    directory
        Folder with results.parquet and its companions, such as results/quick.
    out
        Folder to write to; without it, reports/NAME for results/NAME, else DIRECTORY.
    """
    from rich.console import Console

    from bench.sweep import rebuild_leaderboard
    from bench.tables import Tables

    rebuild_leaderboard(Tables.load(directory), out or documents_of(directory), Console())
    return 0


@app.command
def report(directory: Path, /, *, out: Path | None = None) -> int:
    """Rebuild report.html from the tables in a folder.

    Parameters
    ----------
    directory
        Folder with results.parquet and its companions, such as results/quick.
    out
        Folder to write to; without it, reports/NAME for results/NAME, else DIRECTORY.
    """
    from rich.console import Console

    from bench.sweep import rebuild_report
    from bench.tables import Tables

    rebuild_report(Tables.load(directory), out or documents_of(directory), Console())
    return 0


@app.command
def claims(directory: Path, /, *, out: Path | None = None, notes: Path | None = None) -> int:
    """Put the paper's claims beside what the tables in a folder say, as Markdown and HTML.

    Parameters
    ----------
    directory
        Folder with results.parquet and its companions, such as results/paper.
    out
        Markdown file to write; without it, reports/NAME.md for results/NAME, else claims.md in
        DIRECTORY.
    notes
        Markdown file to append, such as reports/paper_notes.md.
    """
    from bench.paper.page import write_claims
    from bench.tables import Tables

    documents = documents_of(directory)
    default = directory / "claims.md" if documents == directory else documents.with_suffix(".md")
    path = out or default
    write_claims(Tables.load(directory), path, notes)
    print(f"Claims: {path}")  # noqa: T201
    return 0


@app.command
def compare(a: str, b: str, /, *, results: Path | None = None) -> int:
    """Say whether A is better than B, in words and by exit status.

    0: better. 3: worse. 4: no difference can be shown. 5: not comparable.

    Parameters
    ----------
    a
        A method of --results, such as hybrid-mlp; FOLDER:METHOD; or FOLDER, for all its methods.
    b
        What to compare it with, written likewise.
    results
        Folder with results.parquet and its companions, such as results/paper.
    """
    from rich.console import Console

    from bench.compare import load_side, report

    return report(load_side(a, results), load_side(b, results), Console())


@app.command
def replay(
    run: str,
    /,
    *,
    tables: Path | None = None,
    out: Path | None = None,
    video: Path | None = None,
) -> int:
    """Write a page that plays the stored flight of a run; it opens offline.

    Parameters
    ----------
    run
        Name of a run as in runs.csv and the report, or its folder.
    tables
        Folder with runs.parquet and its companions; without it, those in results/* are searched.
    out
        HTML file to write; without it, replays/RUN.html beside the report.
    video
        Also render a film with MuJoCo into this file: .gif, .webp or .png (animated).
    """
    from bench.replay import replay as replay_run

    return replay_run(run, tables, out, video)


def _check_folders(*directories: Path) -> None:
    for directory in directories:
        if directory.exists() and not directory.is_dir():
            raise UsageError(f"{directory} is not a folder, so nothing can be written there.")


def documents_of(tables_dir: Path) -> Path:
    """Where the documents of a folder of tables are, as `bench run` lays them out."""
    place = tables_dir.absolute()
    if place.parent.name == "results":
        return Path(os.path.relpath(place.parent.parent / "reports" / place.name))
    return tables_dir


def main(arguments: list[str] | None = None) -> int:
    """Exit status of the command in `arguments`, by default those of this process.

    0: all is well. 1: a run failed or could not be started. 2: what was asked for makes no sense;
    one line on stderr says why, nothing was done. 130: interrupted, by Ctrl-C or SIGTERM.
    """
    try:
        # Like Ctrl-C, so that processes that were started end, too.
        with handled(signal.SIGTERM, signal.default_int_handler):
            status = app(
                sys.argv[1:] if arguments is None else arguments,
                exit_on_error=False,
                print_error=False,
                result_action="return_value",
            )
    except (cyclopts.CycloptsError, *USAGE_ERRORS) as error:
        print(f"bench: {' '.join(str(error).split())}", file=sys.stderr)  # noqa: T201
        return 2
    except OSError as error:
        print(f"bench: {error}", file=sys.stderr)  # noqa: T201
        return 1
    except KeyboardInterrupt:
        print("bench: interrupted.", file=sys.stderr)  # noqa: T201
        return 130
    return status or 0
