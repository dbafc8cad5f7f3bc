"""The command `bench blind`: draw, diagnose, measure, score, report; running again resumes."""

import json
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.execution.executor import cores
from bench.text.errors import UsageError
from blind.draw.cases import Case
from blind.draw.folders import DEFAULT_COUNTS, INJECTED, RESULTS, Folders, scaled_counts
from blind.fly.realities import REALITIES
from blind.report.injected_section import InjectedTables, is_injected, write_injected
from blind.report.page import write_report
from blind.report.tables import Tables, make_tables, save_labels
from blind.run.answer_baselines import answer_baselines
from blind.run.answering import answer_shown, read_documents, sources_digest
from blind.run.children import Ended, Task, python, run_tasks
from blind.run.display import CasesProgress
from blind.run.measuring import measure_all, read_measures, unmeasured
from blind.run.place import alone, answer_sealed, check_draw, tell_end
from blind.score.answers import scored_form

DOCUMENT = Path("reports") / "blind.md"
"""The report on the runs in `RESULTS`."""

UNDISTURBED = 20
"""Fewest flight sets on which baselines are calibrated."""


def run_blind(
    cases: int | None,
    reality: str,
    out: Path | None,
    seed: int | None,
    jobs: int | None,
    notes: Path | None = None,
) -> int:
    """Exit status: 0, or 1 where a diagnosis failed or the labels were touched.

    Raises:
        UsageError: The request makes no sense.
    """
    counts = None if cases is None else scaled_counts(cases)
    folders = Folders(out or RESULTS / reality)
    check_draw(
        folders,
        seed,
        jobs,
        lambda state: {
            "reality": (reality, f"of reality {state['reality']}"),
            "counts": (counts, f"of {sum(state['counts'].values())} cases"),
        },
    )
    console = Console()
    with alone(folders):
        if not folders.state.is_file():
            _generate(folders, reality, counts or DEFAULT_COUNTS, seed, console)
        return _work(folders, jobs or cores(), console, out, notes)


def _work(
    folders: Folders, jobs: int, console: Console, out: Path | None, notes: Path | None
) -> int:
    """Exit status after everything that is still to be done with cases that were flown."""

    def answer(labels: Mapping[str, Case]) -> None:
        if folders.gone(len(labels)):
            console.print("Flights of the draw are gone; its seeds fly them again.")
            if folders.read_state().get("generator") != sources_digest(with_generator=True):
                console.print("[red]Another version of the program drew them.[/]")
            _fly(folders, {"out": str(folders.out.resolve())}, len(labels), console)
        answer_shown(
            folders, labels, jobs, console, folders.reference_of, lambda case: case.exclude
        )

    labels = answer_sealed(folders, Case.of, answer, console)
    if labels is None:
        return 1
    _measure(folders, labels, jobs, console)
    with console.status("Answering with the baselines"):
        baselines = answer_baselines(folders)
    return _finish(folders, labels, baselines, out, notes, console)


def rebuild_report(out: Path | None, notes: Path | None = None) -> int:
    """Exit status after writing the report from tables alone.

    Raises:
        UsageError: There are no tables.
    """
    if out is not None and is_injected(out):
        path = write_injected(InjectedTables.load(out), out / "injected.md")
    else:
        path = _report(out, notes)
    print(f"Report: {path}")  # noqa: T201
    return 0


def _report(out: Path | None, notes: Path | None) -> Path:
    """The Markdown file, on the tables in `out` and there, or else on all and in `reports`."""
    document = DOCUMENT if out is None else out / DOCUMENT.name
    beside = document.with_name(f"{document.stem}_notes.md")
    notes = notes or (beside if beside.is_file() else None)
    return write_report(_found(out), document, notes, _injected() if out is None else [])


def _found(out: Path | None) -> list[Tables]:
    """The tables in a folder, or those of all realities."""
    if out is not None:
        return [Tables.load(out)]
    places = [RESULTS / reality for reality in REALITIES]
    tables = [Tables.load(place) for place in places if (place / "run.json").is_file()]
    if not tables:
        raise UsageError(f"No tables are in {RESULTS}; `bench blind` makes them.")
    return tables


def _injected() -> list[InjectedTables]:
    """Tables of injected faults that the report on everything has sections for."""
    places = sorted(path.parent for path in (RESULTS / INJECTED).glob("*/run.json"))
    return [InjectedTables.load(place) for place in places if is_injected(place)]


def _generate(
    folders: Folders, reality: str, counts: Mapping[str, int], seed: int | None, console: Console
) -> None:
    """Draws and flies everything; a folder that was left half-way is begun anew."""
    if any(folders.answers.glob("*")):
        raise UsageError(f"{folders.runs} has answers but no run.json; remove it to begin anew.")
    for old in filter(Path.exists, folders.drawn()):
        shutil.rmtree(old)
    settings = {
        "out": str(folders.out.resolve()),
        "reality": reality,
        "counts": dict(counts),
        "seed": seed,
        "undisturbed": max(UNDISTURBED, counts["clean"]),
    }
    _fly(folders, settings, sum(counts.values()), console)


def _fly(folders: Folders, settings: Mapping[str, Any], total: int, console: Console) -> None:
    """Flies in a process of its own, that leaves nothing behind in this one."""
    arguments = python("-m", "blind.run.generate", json.dumps(settings))
    task = Task("generate", arguments, folders.runs, folders.runs / "logs" / "generate")
    ended: list[Ended] = []
    with CasesProgress("flying cases", total, console) as display:
        run_tasks([task], 1, ended.append, on_poll=lambda: display.at(len(folders.flown())))
    if ended[0].cause:
        raise UsageError(f"The cases could not be flown, {ended[0].cause}")


def _measure(folders: Folders, labels: Mapping[str, Case], jobs: int, console: Console) -> None:
    left = unmeasured(folders, labels)
    if left:
        with CasesProgress("measuring what the flights allow", len(left), console) as display:
            measure_all(folders, left, jobs, display.at)
    if lost := unmeasured(folders, labels):
        console.print(
            f"[red]{len(lost)} cases could not be measured and count as decidable; see "
            f"{folders.runs / 'logs'}. Running again tries again.[/]",
            soft_wrap=True,
        )


def _finish(
    folders: Folders,
    labels: Mapping[str, Case],
    baselines: Mapping[str, Mapping[str, Any]],
    out: Path | None,
    notes: Path | None,
    console: Console,
) -> int:
    """Exit status after writing tables and report."""
    documents, statuses = read_documents(folders, labels)
    answers = {name: scored_form(content) for name, content in documents.items()}
    measures = read_measures(folders, labels)
    state = folders.read_state()
    state["measured_by"] = sorted({found.get("program", "") for found in measures.values()})
    tables = make_tables(labels, answers, statuses, measures, baselines, state)
    tables.save(folders.out)
    save_labels(folders)
    path = _report(out, notes)
    failed = sum(status["status"] != "ok" for status in statuses.values())
    status = tell_end(folders, path, failed, len(labels), console)
    return 1 if len(measures) < len(labels) else status
