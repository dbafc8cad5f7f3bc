"""Commands of `bench` that have nothing to do with a sweep: diagnosis, plug-ins, speed, machine."""

import os
from pathlib import Path
from typing import Annotated

import cyclopts

from bench.errors import UsageError

Repeatable = cyclopts.Parameter(negative=())


def diagnose(
    flights: Path | None = None,
    /,
    *,
    simulator: str | None = None,
    reference: Path | None = None,
    out: Path | None = None,
    exclude: Annotated[list[str] | None, Repeatable] = None,
    deploy: str | None = None,
    reality: str | None = None,
    team_size: int | None = None,
    seeds: int | None = None,
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
        Which simulator should explain them: crazyflow (the default) or point_mass.
    reference
        Folder of flights of the same vehicle before a change; then the answer is what changed.
    out
        Folder for the documents; without it, reports/diagnosis/NAME for flights in a folder NAME.
    exclude
        Withhold this effect from the candidates, and all that flights can hardly tell from it.
    deploy
        Task to train and deploy in --reality; takes no flights.
    reality
        Simulated reality for --deploy, such as "crazyflow+mass(e=0.2)+wind(x=1)".
    team_size
        Drones of the team for --deploy; 3 without it.
    seeds
        Seeds of --deploy; 1 without it.
    """
    from bench.environment import environment

    if (flights is None) == (deploy is None) or (deploy is None) != (reality is None):
        raise UsageError("Give either a folder of flights, or --deploy TASK with --reality.")
    if deploy is None:
        word, given = "without", {"--team-size": team_size, "--seeds": seeds}
    else:
        word = "with"
        given = {"--simulator": simulator, "--reference": reference, "--exclude": exclude}
    needless = [name for name, value in given.items() if value is not None]
    if needless:
        raise UsageError(f"Leave out {', '.join(needless)}: no meaning {word} --deploy.")
    os.environ.update(environment())
    if flights is not None:
        from bench.diagnosis.command import run_diagnosis

        return run_diagnosis(flights, simulator or "crazyflow", reference, exclude or (), out)
    from rich.console import Console

    from bench.diagnosis.deploy import deploy as deploy_team

    assert deploy is not None and reality is not None  # noqa: PT018 - asked above
    place = out or Path("reports") / "diagnosis" / f"deploy-{deploy}"
    team_size, seeds = (3 if team_size is None else team_size), (1 if seeds is None else seeds)
    return deploy_team(deploy, reality, team_size, seeds, place, Console())


def blind(
    *,
    cases: int | None = None,
    reality: str | None = None,
    out: Path | None = None,
    seed: int | None = None,
    jobs: int | None = None,
    report: Annotated[bool, Repeatable] = False,
    next_flight: Annotated[bool, Repeatable] = False,
    limits: Annotated[bool, Repeatable] = False,
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
        Where they are flown: crazyflow (the default) or rotorpy, where a reference is used.
    out
        Folder for tables, report and flights; without it, tables go to results/blind/REALITY and
        the report on all realities to reports/blind.md.
    seed
        Seed of the cases; without it, the operating system's.
    jobs
        Number of processes; without it, one per core.
    report
        Only write the report again, from the tables that are there.
    next_flight
        Instead of cases, fly what the diagnosis advises to fly next, and measure what it separates.
    limits
        Instead of cases, measure how small an effect may be to be named, and how long to fly.
    notes
        Markdown file with remarks on failures; without it, blind_notes.md beside the report.
    """
    from bench.environment import environment

    studies = [name for name, on in (("next_flight", next_flight), ("limits", limits)) if on]
    given = {"--cases": cases, "--seed": seed, "--jobs": jobs}
    if report:
        given |= {"--reality": reality, "--next-flight": next_flight or None}
        given |= {"--limits": limits or None}
    needless = [name for name, value in given.items() if value is not None]
    if needless and (report or studies):
        word = "--report" if report else "a study instead of cases"
        raise UsageError(f"Leave out {', '.join(needless)}: no meaning with {word}.")
    os.environ.update(environment())
    from bench.blind.command import rebuild_report, run_blind

    if report:
        return rebuild_report(out, notes)
    if studies:
        from bench.blind.studies import run_studies

        return run_studies(studies, reality or "crazyflow", out, notes)
    return run_blind(cases, reality or "crazyflow", out, seed, jobs, notes=notes)


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
    from bench.environment import environment

    os.environ.update(environment())
    from bench.conformance.command import parse
    from bench.profile import run_profile

    return run_profile(method, task, team_size or (3, 12, 18), parse(setting or ()))


def keep(
    directory: Path,
    /,
    *,
    task: Annotated[list[str] | None, Repeatable] = None,
    team_size: Annotated[list[int] | None, Repeatable] = None,
) -> int:
    """Keep trained policies beside their tables, one file a cell, so that they can be deployed.

    Policies of default settings whose run's folder is there are added; kept ones stay as they are.

    Parameters
    ----------
    directory
        Folder with the tables and runs, such as results/paper.
    task
        Only this task; may be repeated.
    team_size
        Only this number of drones; may be repeated.
    """
    from bench.policies import keep as keep_policies

    for path, count in keep_policies(directory, task or (), team_size or ()).items():
        print(f"{path}: {count} policies")  # noqa: T201
    return 0


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
    from bench.environment import environment

    os.environ.update(environment())
    from rich.console import Console

    from bench.policies import deploy as deploy_policies

    return deploy_policies(directory, task, team_size, reality, method or (), Console())


def doctor() -> int:
    """Show versions, devices and graphics, and name combinations that are known to break.

    Exit status 1 if anything was found that breaks runs.
    """
    from bench.doctor import doctor as examine  # before anything imports SciPy, which it looks for

    return examine()
