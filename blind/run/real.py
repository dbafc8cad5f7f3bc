"""`bench blind --real MANIFEST`: diagnose labelled flights, score, report; again resumes.

An answer is kept under the digests of its flights and of its reference's: a set that is new or has
changed is diagnosed, another one is not, and labels may be mended without a diagnosis. Whether they
were, after the first one, stands in the report.
"""

import dataclasses
import datetime
import hashlib
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console

from bench.execution.executor import cores
from bench.text.errors import UsageError
from blind.draw.folders import RESULTS, Folders, write_json
from blind.draw.injected import write_unnamed
from blind.draw.manifest import LabelledSet, Manifest, read_manifest
from blind.report.real_section import write_real
from blind.run.answering import answer_shown, missing, read_documents
from blind.run.place import alone, check_request, tell_end
from blind.score.real import real_rows
from diagnosis.logs.flights import LogError, load_flights

REAL = "real"
"""Folder in `RESULTS` for tables of labelled real flights, a folder a manifest."""


@dataclasses.dataclass(frozen=True)
class RealCase:
    """A set as far as it is needed to diagnose it."""

    id: str
    """Name of its folder, from the digests of its flights and its reference's."""
    name: str
    """Its name in the manifest."""
    flights: Path
    """Its folder."""
    reference: Path | None
    """The folder beside which it is diagnosed."""


def run_real(path: Path, *, out: Path | None = None, jobs: int | None = None) -> int:
    """Exit status: 0, or 1 where a diagnosis failed.

    Args:
        path: The manifest.
        out: Folder for tables, page and answers; in `results/blind/real` if None.
        jobs: Number of processes; one a core if None.

    Raises:
        UsageError: The manifest or something that it names cannot be used.
    """
    folders = Folders(out or RESULTS / REAL / path.stem)
    check_request(folders, None, jobs)
    manifest = read_manifest(path)
    cases = {name: _case(path.parent, name, manifest) for name in manifest.sets}
    console = Console()
    with alone(folders):
        state = _state(folders, path, manifest)
        console.print(f"SHA-256 of sets and labels: {state['sha256']}", highlight=False)
        _answer(folders, cases, jobs or cores(), console)
        return _finish(folders, manifest, cases, state, console)


def _case(folder: Path, name: str, manifest: Manifest) -> RealCase:
    own = manifest.sets[name]
    beside: LabelledSet | None = manifest.sets[own.reference] if own.reference else None
    text = f"{own.sha256} {beside.sha256 if beside else ''}"
    return RealCase(
        id=hashlib.sha256(text.encode()).hexdigest()[:16],
        name=name,
        flights=folder / own.flights,
        reference=folder / beside.flights if beside else None,
    )


def _state(folders: Folders, path: Path, manifest: Manifest) -> dict[str, Any]:
    """What is asked, with the digest of the labels now and when the first set was diagnosed."""
    text = json.dumps(manifest.model_dump(), sort_keys=True)
    sha256 = hashlib.sha256(text.encode()).hexdigest()
    if folders.state.is_file():
        state = folders.read_state() | {"sha256": sha256}
    else:
        now = datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds")
        state = {"manifest": path.name, "started": now, "sha256": sha256, "first_sha256": sha256}
    write_json(folders.state, state)
    return state


def _answer(folders: Folders, cases: Mapping[str, RealCase], jobs: int, console: Console) -> None:
    by_id = {case.id: case for case in cases.values()}  # the same flights twice: one answer
    for case in missing(folders, by_id):
        _copy(case.flights, folders.cases / case.id)
        if case.reference is not None:
            _copy(case.reference, folders.references / case.id)

    def beside(case: RealCase) -> Path | None:
        return folders.references / case.id if case.reference else None

    answer_shown(folders, by_id, jobs, console, beside, name_of=lambda case: case.name)


def _copy(source: Path, place: Path) -> None:
    """The flights of a folder, without what the operator calls the vehicle.

    Raises:
        UsageError: There are no usable flights.
    """
    if place.is_dir():
        return
    try:
        flights = load_flights(source)
    except LogError as error:
        raise UsageError(str(error)) from error
    write_unnamed(place, flights)


def _finish(
    folders: Folders,
    manifest: Manifest,
    cases: Mapping[str, RealCase],
    state: dict[str, Any],
    console: Console,
) -> int:
    """Exit status after writing tables and page."""
    answers, statuses = read_documents(folders, {case.id for case in cases.values()})
    rows, numbers = real_rows(
        manifest,
        {name: answers[case.id] for name, case in cases.items() if case.id in answers},
        {name: statuses[case.id] for name, case in cases.items()},
    )
    run = {**state, "sources": sorted({status["sources"] for status in statuses.values()})}
    path = write_real(rows, numbers, run, folders.out)
    failed = rows["outcome"].tolist().count("failed")
    return tell_end(folders, path, failed, len(rows), console)
