"""`bench blind`: the diagnosis checked on withheld causes."""

from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any, Literal

from bench.cli.checks import check_files, check_flights, check_unused
from bench.cli.options import Repeatable
from bench.execution.environment import compute_here
from bench.text.errors import UsageError


def blind(
    *,
    cases: int | None = None,
    reality: Literal["crazyflow", "rotorpy"] | None = None,
    out: Path | None = None,
    seed: int | None = None,
    jobs: int | None = None,
    report: Annotated[bool, Repeatable] = False,
    next_flight: Annotated[bool, Repeatable] = False,
    limits: Annotated[bool, Repeatable] = False,
    inject: Path | None = None,
    reference: Annotated[bool, Repeatable] = False,
    real: Path | None = None,
    notes: Path | None = None,
) -> int:
    """Make flights whose cause is withheld, diagnose them, and score the answers.

    Every diagnosis runs in a process of its own that gets a folder of flights and nothing else.
    The SHA-256 of the labels is printed before the first one and checked after the last. The same
    command with the same folder resumes.

    Parameters
    ----------
    cases
        Number of cases, all kinds together; default: 321, as in a counted run, or 80 with
        `--inject`.
    reality
        Simulator that flies the cases: crazyflow (the default), or rotorpy, where each diagnosis
        also gets reference flights.
    out
        Folder for tables, report and flights; default: results/blind/REALITY for the tables and
        reports/blind.md for the report on all realities; with `--inject`,
        results/blind/injected/NAME for flights in a folder NAME.
    seed
        Seed of the cases; default: drawn by the operating system.
    jobs
        Number of processes; default: one per core.
    report
        Only write the report again, from the tables that exist.
    next_flight
        Instead of cases, fly the flights that diagnoses advise, and measure what they tell apart.
    limits
        Instead of cases, measure how small an effect a diagnosis still names, and how much flight
        it needs.
    inject
        Folder of logs, your own for instance: cases are made from halves of these flights, with
        faults written into what was commanded, its clock, frame, units or order.
    reference
        With `--inject`, give each diagnosis the other half of the flights as its reference.
    real
        TOML file that names labelled sets of real flights of your own: each is diagnosed, and the
        answers are scored for each airframe. docs/diagnosis.md describes the file.
    notes
        Markdown file with remarks on failures; default: blind_notes.md beside the report.
    """
    studies = [name for name, on in (("next_flight", next_flight), ("limits", limits)) if on]
    given = {"--cases": cases, "--seed": seed, "--jobs": jobs, "--reality": reality}
    given |= {"--notes": notes, "--next-flight": next_flight or None, "--limits": limits or None}
    given |= {"--inject": inject, "--reference": reference or None, "--real": real}
    _check_options(given, report)
    compute_here()
    from blind.run.command import rebuild_report, run_blind

    if report:
        return rebuild_report(out, notes)
    if real is not None:
        from blind.run.real import run_real

        return run_real(real, out=out, jobs=jobs)
    if inject is not None:
        from blind.run.injecting import run_injected

        return run_injected(inject, reference=reference, cases=cases, out=out, seed=seed, jobs=jobs)
    if studies:
        from blind.run.studies import run_studies

        return run_studies(studies, reality or "crazyflow", out, notes)
    return run_blind(cases, reality or "crazyflow", out, seed, jobs, notes=notes)


def _check_options(given: Mapping[str, Any], report: bool) -> None:
    """Refuses options that do not fit together; an option that is not given is None or False."""
    studies, others = ("--next-flight", "--limits"), ("--cases", "--seed")

    def refuse(why: str, *names: str) -> None:
        check_unused({name: given[name] for name in names}, why)

    if report:
        refuse("with --report", *(name for name in given if name != "--notes"))
    elif any(given[name] for name in studies):
        refuse("with a study instead of cases", *others, "--jobs")
    if given["--real"] is not None:
        more = (*others, "--inject", "--reference")
        refuse("with --real", "--reality", "--notes", *studies, *more)
        check_files([given["--real"]])
    if given["--inject"] is not None:
        refuse("with --inject", "--reality", "--notes", *studies)
        check_flights([given["--inject"]])
    elif given["--reference"]:
        raise UsageError("`--reference` needs `--inject FLIGHTS`, whose other half it uses.")
