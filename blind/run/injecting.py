"""`bench blind --inject FLIGHTS`: draw, diagnose, score, report; running again resumes."""

import dataclasses
import datetime
import secrets
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.execution.executor import cores
from bench.stats.statistics import records
from bench.text.errors import UsageError
from blind.draw.cases import seal
from blind.draw.faults import ALL
from blind.draw.folders import INJECTED, RESULTS, Folders, write_json
from blind.draw.injected import Injected, draw_injected, flights_digest, write_injected
from blind.report import injected_section as report
from blind.report.tables import save_labels
from blind.run.answering import answer_shown, read_documents, sources_digest
from blind.run.place import alone, answer_sealed, check_draw, tell_end
from blind.score.injected import injected_rows
from diagnosis.logs.flights import FlightSet, LogError, load_flights

CASES = 80
"""Cases of a run that does not say how many: about two of each fault and size."""


def run_injected(
    flights: Path,
    *,
    reference: bool = False,
    cases: int | None = None,
    out: Path | None = None,
    seed: int | None = None,
    jobs: int | None = None,
) -> int:
    """Exit status: 0, or 1 where a diagnosis failed or the labels were touched.

    Args:
        flights: Folder of logs, in the format that a diagnosis reads.
        reference: Whether the other half of the flights is given as a reference.
        cases: Number of cases; `CASES` if None.
        out: Folder for tables, report and cases.
        seed: Seed of the draw; from the operating system if None.
        jobs: Number of processes; one a core if None.

    Raises:
        UsageError: The request makes no sense, or the flights cannot be used.
    """
    try:
        flown = load_flights(flights)
    except LogError as error:
        raise UsageError(str(error)) from error
    name = flown.path.resolve().name
    folders = Folders(out or RESULTS / INJECTED / name)
    check_draw(
        folders,
        seed,
        jobs,
        lambda state: {
            "digest": (
                flights_digest(flown),
                "of other flights, or of these before they changed",
            ),
            "reference": (reference, f"{'without' if reference else 'with'} `--reference`"),
            "cases": (cases, f"of {state.get('cases')} cases"),
        },
    )
    console = Console()
    with alone(folders):
        if not folders.state.is_file():
            _draw(folders, flown, reference, cases or CASES, seed)
        return _work(folders, flown, jobs or cores(), console)


def _draw(
    folders: Folders, flown: FlightSet, reference: bool, count: int, seed: int | None
) -> None:
    """Draws and writes everything, `run.json` last; what was left half-way is begun anew."""
    for old in filter(Path.exists, folders.drawn()):
        shutil.rmtree(old)
    entropy = secrets.randbits(128) if seed is None else seed
    try:
        cases = draw_injected(flown, count, entropy)
    except ValueError as error:
        raise UsageError(str(error).replace("`cases`", "`--cases`")) from error
    write_injected(folders, flown, cases)
    sha256 = seal(folders.labels, {case.id: dataclasses.asdict(case) for case in cases})
    write_json(
        folders.state,
        {
            "injected": flown.path.resolve().name,
            "digest": flights_digest(flown),
            "flights": len(flown.flights),
            "reference": reference,
            "cases": count,
            "seed": seed,
            "entropy": entropy,
            "sha256": sha256,
            "started": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
            "generator": sources_digest(with_generator=True),
        },
    )


def _work(folders: Folders, flown: FlightSet, jobs: int, console: Console) -> int:
    """Exit status after everything that is still to be done with cases that were drawn."""
    state = folders.read_state()

    def beside(case: Injected) -> Path | None:
        return folders.references / case.id if state["reference"] else None

    def answer(labels: Mapping[str, Injected]) -> None:
        write_injected(folders, flown, list(labels.values()))
        answer_shown(folders, labels, jobs, console, beside)

    labels = answer_sealed(folders, Injected.of, answer, console)
    if labels is None:
        return 1
    return _finish(folders, labels, state, console)


def _finish(
    folders: Folders, labels: Mapping[str, Injected], state: Mapping[str, Any], console: Console
) -> int:
    """Exit status after writing tables and report."""
    answers, statuses = read_documents(folders, labels)
    cases, numbers = injected_rows(labels, answers, statuses)
    sources = sorted({status["sources"] for status in statuses.values()})
    faulty = [case for case in labels.values() if case.fault in ALL]
    described = sorted({c.fault for c in faulty if c.answers or ALL[c.fault].parts})
    run = {**state, "sources": sources, "described": described}
    tables = report.InjectedTables(cases, numbers, run)
    tables.save(folders.out)
    save_labels(folders)
    path = report.write_injected(tables, folders.out / "injected.md")
    failed = sum(row["status"] != "ok" and not row["refused"] for row in records(cases))
    return tell_end(folders, path, failed, len(labels), console)
