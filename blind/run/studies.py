"""Studies beside the blind cases: what to fly next, and how small an effect may be to be named.

Each measures one item after another and keeps it in `OUT/runs/STUDY/ITEM.json`, so that a study
that was interrupted goes on. An item that another version of the diagnosis measured is measured
again. The table of all items is `OUT/STUDY.parquet`.
"""

import dataclasses
import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from rich.console import Console

from bench.text.errors import UsageError
from blind.draw.cases import OWN
from blind.draw.folders import RESULTS, Folders, write_json
from blind.run.answering import sources_digest
from blind.run.command import rebuild_report
from blind.run.display import CasesProgress
from blind.run.place import alone

Row = Mapping[str, Any]


@dataclasses.dataclass(frozen=True)
class Study:
    """Something to measure, item by item."""

    name: str
    """Name of the table's file without its suffix."""
    title: str
    """What is being done, for the bar."""
    items: Sequence[str]
    """Names of files, in order."""
    measure: Callable[[str], Sequence[Row]]
    """The rows of one item."""


def next_flight() -> Study:
    """Every pair that there is advice for, flown as advised."""
    from blind.score.manoeuvres import Range, directions

    flown = Range()
    pairs = {f"{truth}-{rival}": (truth, rival) for truth, rival in directions()}

    def measure(item: str) -> list[Row]:
        margins = flown.margins(*pairs[item])
        return [dataclasses.asdict(margins) | {"separated": margins.separated}]

    return Study("next_flight", "flying what is advised", list(pairs), measure)


def limits() -> Study:
    """Predictions for every effect, then diagnoses that check some of them."""
    from blind.draw.catalogue import LIBRARY
    from blind.score.limit_checks import Survey, checks

    survey = Survey()
    checked = {
        f"{name}-{n}-{factor:g}-{i}": (name, n, factor, i) for name, n, factor, i in checks()
    }

    def measure(item: str) -> list[Row]:
        return survey.predict(item) if item in LIBRARY else [survey.check(*checked[item])]

    return Study("limits", "measuring limits", [*LIBRARY, *checked], measure)


STUDIES: Mapping[str, Callable[[], Study]] = {"next_flight": next_flight, "limits": limits}
"""Makers of every study; the report has a section for each."""


def run_studies(names: Sequence[str], reality: str, out: Path | None, notes: Path | None) -> int:
    """Exit status after the studies and, where a blind run has ended, its report.

    Raises:
        UsageError: The reality is not the one whose equations the diagnosed simulator has.
    """
    if reality != OWN:
        raise UsageError(f"Studies are flown in {OWN} only, got `--reality` '{reality}'.")
    folders, console = Folders(out or RESULTS / reality), Console()
    with alone(folders):
        for name in names:
            path = run_study(STUDIES[name](), folders, console)
            console.print(f"Table: {path}", soft_wrap=True, highlight=False)
    return rebuild_report(out, notes) if (folders.out / "run.json").is_file() else 0


def run_study(study: Study, folders: Folders, console: Console) -> Path:
    """The table that was written, after everything that was still to be measured."""
    kept = folders.runs / study.name
    sources = sources_digest(with_generator=True)
    rows = {item: _read(kept / f"{item}.json", sources) for item in study.items}
    left = [item for item, found in rows.items() if found is None]
    done = len(rows) - len(left)
    folders.out.mkdir(parents=True, exist_ok=True)
    with CasesProgress(study.title, len(rows), console, done) as display:
        for number, item in enumerate(left, done + 1):
            rows[item] = list(study.measure(item))
            write_json(kept / f"{item}.json", {"sources": sources, "rows": rows[item]})
            display.at(number)
    table = pd.DataFrame([row for item in study.items for row in rows[item] or ()])
    path = folders.out / f"{study.name}.parquet"
    versions = {"program": sources[:12], "diagnosis": sources_digest()[:12]}
    table.assign(**versions).to_parquet(path, index=False)
    return path


def _read(path: Path, sources: str) -> list[Row] | None:
    """The rows of an item; None if it is to be measured."""
    if not path.is_file():
        return None
    content = json.loads(path.read_text(encoding="utf-8"))
    return content["rows"] if content["sources"] == sources else None
