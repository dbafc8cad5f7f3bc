"""The command line: `bench run`, `list`, `report`, `replay`, `diagnose`, `check`, `doctor`, ...

Whatever needs JAX or pandas is imported inside the commands, so that help appears at once.
"""

import os
import sys
from pathlib import Path
from typing import Annotated

import cyclopts

from bench.errors import UsageError
from simulators.registry import BrokenPluginError, UnknownPluginError

USAGE_ERRORS = (UsageError, UnknownPluginError, BrokenPluginError)
"""What ends a command with exit status 2 and one line on stderr."""

app = cyclopts.App(
    name="bench",
    help="How should drone-swarm policies be trained across simulator fidelities?",
    version_flags=[],
)

Repeatable = cyclopts.Parameter(negative=())


@app.command
def run(
    suite: str = "quick",
    /,
    *,
    task: Annotated[list[str] | None, Repeatable] = None,
    team_size: Annotated[list[int] | None, Repeatable] = None,
    method: Annotated[list[str] | None, Repeatable] = None,
    residual: Annotated[list[str] | None, Repeatable] = None,
    seeds: int | None = None,
    out: Path | None = None,
    jobs: int | None = None,
) -> int:
    """Train and evaluate what a suite asks for, then write tables, leaderboard and report.

    Runs that are finished already are not repeated, so running again is resuming. Parents that a
    method starts from are run too. Filters may be repeated, and need not be in the suite.

    Parameters
    ----------
    suite
        Name of a built-in suite (`bench list` shows them) or path of a TOML file.
    task
        Only this task.
    team_size
        Only this number of drones.
    method
        Only this method.
    residual
        Only methods with this residual, and those that --method names and that take none.
    seeds
        Run seeds 0 to SEEDS - 1.
    out
        Folder for everything; without it, tables go to results/SUITE, documents to reports/SUITE.
    jobs
        Number of worker processes; without it, one per core.
    """
    from bench.suite import load_suite

    chosen = load_suite(suite).select(
        task or (), team_size or (), method or (), residual or (), seeds
    )
    if jobs is not None and jobs < 1:
        raise UsageError(f"`--jobs` must be at least 1, got {jobs}.")
    tables_dir = out or Path("results") / chosen.name
    documents_dir = out or Path("reports") / chosen.name
    _check_folders(tables_dir, documents_dir)
    os.environ.setdefault("XLA_PYTHON_CLIENT_PREALLOCATE", "false")  # leave it to the workers
    from bench.plan import expand
    from bench.sweep import sweep

    return sweep(expand(chosen), tables_dir, documents_dir, jobs)


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
        Folder with results.parquet and its companions, such as results/pilot.
    out
        Markdown file to write; without it, reports/NAME.md for results/NAME, else claims.md in
        DIRECTORY.
    notes
        Markdown file to append, such as reports/pilot_notes.md.
    """
    from bench.claims import write_claims
    from bench.tables import Tables

    documents = documents_of(directory)
    default = directory / "claims.md" if documents == directory else documents.with_suffix(".md")
    path = out or default
    write_claims(Tables.load(directory), path, notes)
    print(f"Claims: {path}")  # noqa: T201
    return 0


@app.command
def diagnose(
    flights: Path | None = None,
    /,
    *,
    simulator: str = "crazyflow",
    reference: Path | None = None,
    out: Path | None = None,
    exclude: Annotated[list[str] | None, Repeatable] = None,
    deploy: str | None = None,
    reality: str | None = None,
    team_size: int = 3,
    seeds: int = 1,
) -> int:
    """Say why a simulator and real flights differ: where, which effect, how much it explains.

    Writes diagnosis.json, diagnosis.md and diagnosis.html, one page that opens offline; nothing if
    no flight is usable. With --deploy it says instead what a diagnosis is worth to a team: policies
    for a task, trained in the nominal and in the corrected simulator, deployed in --reality.

    Parameters
    ----------
    flights
        Folder with vehicle.toml and flights/NAME.parquet or .csv.
    simulator
        Which simulator should explain them: crazyflow or point_mass.
    reference
        Folder of flights of the same vehicle before a change; then the answer is what changed.
    out
        Folder for the documents; without it, reports/diagnosis/NAME for flights in a folder NAME.
    exclude
        Withhold this effect, and all that these flights cannot tell from it, from the candidates.
    deploy
        Task to train and deploy in --reality; takes no flights.
    reality
        Simulated reality for --deploy, such as "crazyflow+mass(e=0.2)+wind(x=1)".
    team_size
        Drones of the team for --deploy.
    seeds
        Seeds of --deploy.
    """
    from bench.environment import environment

    if (flights is None) == (deploy is None) or (deploy is None) != (reality is None):
        raise UsageError("Give either a folder of flights, or --deploy TASK with --reality.")
    os.environ.update(environment())
    if flights is not None:
        from bench.diagnosis.command import run_diagnosis

        return run_diagnosis(flights, simulator, reference, exclude or (), out)
    from rich.console import Console

    from bench.diagnosis.deploy import deploy as deploy_team

    assert deploy is not None and reality is not None  # noqa: PT018 - asked above
    place = out or Path("reports") / "diagnosis" / f"deploy-{deploy}"
    return deploy_team(deploy, reality, team_size, seeds, place, Console())


@app.command
def blind(
    *,
    cases: int | None = None,
    reality: str = "crazyflow",
    out: Path | None = None,
    seed: int | None = None,
    jobs: int | None = None,
    report: Annotated[bool, Repeatable] = False,
    notes: Path | None = None,
) -> int:
    """Make flights whose cause is withheld, diagnose them, and score the answers.

    Every diagnosis runs in a process of its own that gets a folder of flights and nothing else.
    The SHA-256 of the labels is printed before the first one and checked after the last. Running
    again with the same folder continues.

    Parameters
    ----------
    cases
        Number of cases of all kinds; without it, the 321 of a counted run.
    reality
        Where they are flown: crazyflow, or rotorpy, against which a reference is used.
    out
        Folder for tables, report and flights; without it, tables go to results/blind/REALITY and
        the report on all realities to reports/blind.md.
    seed
        Seed of the cases; without it, the operating system's.
    jobs
        Number of processes; without it, one per core.
    report
        Only write the report again, from the tables that are there.
    notes
        Markdown file with remarks on failures; without it, blind_notes.md beside the report.
    """
    from bench.environment import environment

    os.environ.update(environment())
    from bench.blind.command import rebuild_report, run_blind

    if report:
        return rebuild_report(out, notes)
    return run_blind(cases, reality, out, seed, jobs, notes=notes)


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


@app.command
def doctor() -> int:
    """Show versions, devices and graphics, and name combinations that are known to break.

    Exit status 1 if anything was found that breaks runs.
    """
    from bench.doctor import doctor as examine  # before anything imports SciPy, which it looks for

    return examine()


@app.command
def check(
    plugin: str,
    /,
    *,
    setting: Annotated[list[str] | None, Repeatable] = None,
    simulator: Annotated[list[str] | None, Repeatable] = None,
) -> int:
    """Run the conformance suite on a plug-in and say what is wrong with it.

    Exit status 1 if a check failed.

    Parameters
    ----------
    plugin
        Registered name, with its kind where names coincide (effect:mass), or module:Class.
    setting
        Setting of the plug-in, such as trainer.epochs=3; may be repeated.
    simulator
        Only in this simulator (effects: where they are attached; methods: their reality).
    """
    from bench.environment import environment

    os.environ.update(environment())
    from bench.conformance.command import check as check_plugin

    return check_plugin(plugin, setting or (), simulator or ())


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
    one line on stderr says why, nothing was done. 130: interrupted.
    """
    try:
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
