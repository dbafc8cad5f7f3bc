"""Every case diagnosed in a fresh process that is given nothing but its flights.

The flights are copied to a temporary folder that has nothing to do with the run's, the process
starts in an empty folder there with a scrubbed environment, and what it wrote is moved to the
answers in one piece: an answer is there whole or not at all. How a diagnosis failed is an answer,
too; it is not tried again.
"""

import json
import os
import shutil
import tempfile
from collections.abc import Callable, Collection, Mapping, Sequence
from pathlib import Path
from typing import Any, Protocol, TypeVar

from rich.console import Console

import blind
import diagnosis
import simulators
from blind.draw.folders import Folders, write_json
from blind.run.children import Ended, Task, python, run_tasks
from blind.run.display import CasesProgress
from blind.score.answers import scored_form
from diagnosis import program

DIAGNOSE = tuple(python("-m", "blind.run.one"))
"""The command that diagnoses a folder."""
TIMEOUT = 3600.0
"""Longest time for one diagnosis [s]; a slow machine needs 15 min for a hard case."""
PROGRAM = "program.json"
"""Which program a diagnosis says that it was given by, in the folder of its answer."""
STATUS = "status.json"
"""How a diagnosis ended, in the folder of its answer."""


class Asked(Protocol):
    """A case as far as it is needed to diagnose it."""

    @property
    def id(self) -> str:
        """Random name of its folder."""
        ...


C = TypeVar("C", bound=Asked)


def missing(folders: Folders, cases: Mapping[str, C]) -> list[C]:
    """The cases without an answer."""
    return [case for name, case in cases.items() if not (folders.answers / name / STATUS).is_file()]


def answer_shown(
    folders: Folders,
    cases: Mapping[str, C],
    jobs: int,
    console: Console,
    reference_of: Callable[[C], Path | None] = lambda _: None,
    exclude_of: Callable[[C], Sequence[str]] = lambda _: (),
    name_of: Callable[[C], str] = lambda case: case.id,
) -> None:
    """Diagnoses the cases that have no answer yet, with a progress bar that calls each by name.

    `reference_of` says beside which flights of the undisturbed vehicle a case is diagnosed, and
    `exclude_of` without which effects.
    """
    left, sources = missing(folders, cases), sources_digest()
    done = len(cases) - len(left)
    if done:
        console.print(f"{done} of {len(cases)} cases have an answer already.", highlight=False)
    with (
        CasesProgress("diagnosing", len(cases), console, done) as display,
        tempfile.TemporaryDirectory(prefix="flights-") as temporary,
    ):
        work = Path(temporary)

        def end(ended: Ended) -> None:
            status = _kept(ended, work / ended.name, folders.answers, sources)
            shutil.rmtree(work / ended.name)
            display.finished(name_of(cases[ended.name]), status["cause"], status["seconds"])

        tasks = (
            _task(folders.cases / case.id, work, exclude_of(case), reference_of(case))
            for case in left
        )
        run_tasks(tasks, jobs, end, TIMEOUT)


def read_documents(
    folders: Folders, cases: Collection[str]
) -> tuple[dict[str, Mapping[str, Any]], dict[str, dict[str, Any]]]:
    """What the diagnoses that did not fail wrote, as JSON, and how each ended, by case."""
    contents, statuses = {}, {}
    for name in cases:
        place = folders.answers / name
        statuses[name] = _read(place / STATUS)
        if statuses[name]["status"] == "ok":
            contents[name] = _read(place / "diagnosis.json")
    return contents, statuses


def sources_digest(with_generator: bool = False) -> str:
    """SHA-256 of the program that diagnoses, so that an answer says which one gave it.

    `with_generator`: and of the one that makes cases and measures them.
    """
    return program.sources_digest(diagnosis, simulators, *([blind] if with_generator else []))


def _task(flights: Path, work: Path, exclude: Sequence[str], reference: Path | None) -> Task:
    """The diagnosis of one folder, in a folder of its own."""
    own = work / flights.name
    (own / "empty").mkdir(parents=True)
    shutil.copytree(flights, own / flights.name)
    arguments = [str(own / flights.name), "--out", str(own / "answer")]
    if reference is not None:
        shutil.copytree(reference, own / "reference")
        arguments += ["--reference", str(own / "reference")]
    for effect in exclude:
        arguments += ["--exclude", effect]
    return Task(flights.name, [*DIAGNOSE, *arguments], own / "empty", own / "log")


def _kept(ended: Ended, work: Path, answers: Path, sources: str) -> dict[str, Any]:
    """The status of a diagnosis, after its documents were moved to the answers."""
    made, cause = work / "answer", ended.cause
    if (made / PROGRAM).is_file():  # what the child has imported, not what is there now
        sources = _read(made / PROGRAM)["sources"]
    if not cause:
        try:
            scored_form(_read(made / "diagnosis.json"))
        except (OSError, ValueError) as error:
            cause = f"diagnosis.json cannot be read: {' '.join(str(error).split())}"
    status = {
        "status": "failed" if cause else "ok",
        "cause": cause,
        "seconds": ended.seconds,
        "sources": sources,
    }
    made.mkdir(exist_ok=True)
    write_json(made / STATUS, status)
    shutil.copy(work / "log" / "stderr", made / "stderr.txt")
    answers.mkdir(parents=True, exist_ok=True)
    # Another file system may lie between, and a move across is not one piece.
    part, final = answers / f".{ended.name}.part", answers / ended.name
    for old in (part, final):
        shutil.rmtree(old, ignore_errors=True)
    shutil.move(made, part)
    os.replace(part, final)
    return status


def _read(path: Path) -> dict[str, Any]:
    return json.loads(path.read_text(encoding="utf-8"))
