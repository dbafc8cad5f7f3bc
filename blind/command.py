"""`bench blind`: the diagnosis checked on withheld causes."""

import os
from pathlib import Path
from typing import Annotated

from bench.cli.options import Repeatable
from bench.text.errors import UsageError


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
    inject: Path | None = None,
    reference: Annotated[bool, Repeatable] = False,
    notes: Path | None = None,
) -> int:
    """Make flights whose cause is withheld, diagnose them, and score the answers.

    Every diagnosis runs in a process of its own that gets a folder of flights and nothing else.
    The SHA-256 of the labels is printed before the first one and checked after the last. Running
    again with the same folder continues.

    Parameters
    ----------
    cases
        Number of cases of all kinds; without it, the 321 of a counted run, or 80 with `--inject`.
    reality
        Where they are flown: crazyflow (the default) or rotorpy, where a reference is used.
    out
        Folder for tables, report and flights; without it, tables go to results/blind/REALITY and
        the report on all realities to reports/blind.md; with `--inject`, everything goes to
        results/blind/injected/NAME of the flights.
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
    inject
        Folder of logs, your own for instance: cases are made from halves of these flights, with
        faults written into what was commanded, its clock, frame, units or order.
    reference
        With `--inject`, give each diagnosis the other half of the flights as its reference.

    Notes:
        Markdown file with remarks on failures; without it, blind_notes.md beside the report.
    """
    from bench.execution.environment import environment

    studies = [name for name, on in (("next_flight", next_flight), ("limits", limits)) if on]
    given = {"--cases": cases, "--seed": seed, "--jobs": jobs}
    if report:
        given |= {"--reality": reality, "--next-flight": next_flight or None}
        given |= {"--limits": limits or None, "--inject": inject, "--reference": reference or None}
    needless = [name for name, value in given.items() if value is not None]
    if needless and (report or studies):
        word = "--report" if report else "a study instead of cases"
        raise UsageError(f"Leave out {', '.join(needless)}: no meaning with {word}.")
    _check_inject(inject, reference, {"--reality": reality, "--notes": notes, **_on(studies)})
    os.environ.update(environment())
    from blind.run.command import rebuild_report, run_blind

    if report:
        return rebuild_report(out, notes)
    if inject is not None:
        from blind.run.injecting import run_injected

        return run_injected(inject, reference=reference, cases=cases, out=out, seed=seed, jobs=jobs)
    if studies:
        from blind.run.studies import run_studies

        return run_studies(studies, reality or "crazyflow", out, notes)
    return run_blind(cases, reality or "crazyflow", out, seed, jobs, notes=notes)


def _on(studies: list[str]) -> dict[str, bool]:
    return {f"--{name.replace('_', '-')}": True for name in studies}


def _check_inject(inject: Path | None, reference: bool, others: dict[str, object]) -> None:
    """Nothing, if `--inject` and what goes with it fit together."""
    if inject is None:
        if reference:
            raise UsageError("`--reference` needs `--inject FLIGHTS`, whose other half it uses.")
        return
    needless = [name for name, value in others.items() if value is not None]
    if needless:
        raise UsageError(f"Leave out {', '.join(needless)}: no meaning with --inject.")
