"""The command `bench diagnose`: load flights, diagnose them, write and show what was found."""

import sys
from collections.abc import Sequence
from pathlib import Path

from rich.console import Console

from bench.diagnosis_report.documents import NAMES, check_place, write_documents
from bench.diagnosis_report.terminal import DiagnosisProgress, show_summary
from bench.text.words import clean
from diagnosis.engine import diagnose
from diagnosis.logs.flights import load_flights


def run_diagnosis(
    flights: Path,
    simulator: str | None,
    reference: Path | None,
    exclude: Sequence[str],
    out: Path,
) -> None:
    """Writes the documents to the folder `out` and shows what was found.

    Raises:
        UsageError: The request makes no sense.
        LogError: The logs hold nothing usable, with a line for each reason.
    """
    check_place(out)
    with DiagnosisProgress(Console(stderr=True)) as display:
        found = diagnose(
            load_flights(flights),
            simulator=simulator,
            reference=None if reference is None else load_flights(reference),
            exclude=tuple(exclude),
            progress=display.update,
        )
        display.update("writing", 1.0)
        replaced = (out / NAMES[0]).exists()
        write_documents(found, out)
    show_summary(found, out, Console())
    if replaced:
        print(f"The diagnosis that was there is replaced: {clean(out)}", file=sys.stderr)  # noqa: T201


def place_of(flights: Path) -> Path:
    """Folder for the documents where none is asked for."""
    return Path("reports") / "diagnosis" / (flights.resolve().name or "flights")
