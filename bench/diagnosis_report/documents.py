"""The documents of a diagnosis: its Markdown, and all three written, or none."""

import json
import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from bench.diagnosis_report import tables
from bench.diagnosis_report.gap_text import shrink_sentence, where_sentence
from bench.diagnosis_report.page import diagnosis_page
from bench.diagnosis_report.remedy import remedy
from bench.diagnosis_report.sentences import next_flight, remarks, verdict
from bench.text import markdown
from bench.text.errors import UsageError
from bench.text.pages import refuse_folder
from bench.text.words import clean
from diagnosis.result import Diagnosis
from simulators.effects.card import load_card

NAMES = ("diagnosis.json", "diagnosis.md", "diagnosis.html")
"""What a folder of a diagnosis holds."""


def check_place(out: Path, names: Sequence[str] = NAMES) -> None:
    """Raises if the documents could not be written to the folder `out`; writes nothing.

    Raises:
        UsageError: `out` is no folder, cannot be made or written to, or a document's name is taken
            by a folder.
    """
    existing = next(place for place in (out, *out.absolute().parents) if place.exists())
    if not existing.is_dir():
        raise UsageError(f"{existing} is not a folder, so nothing can be written there.")
    if not os.access(existing, os.W_OK | os.X_OK):
        raise UsageError(f"The folder {existing} is not writable. Choose another with `--out`.")
    for name in names:
        refuse_folder(out / name)


def write_documents(diagnosis: Diagnosis, out: Path) -> None:
    """Writes diagnosis.json, diagnosis.md and diagnosis.html to the folder `out`, all or none.

    JSON knows no infinity and no NaN; they become null.
    """
    texts = (
        json.dumps(diagnosis.to_json(), indent=1, ensure_ascii=False, allow_nan=False) + "\n",
        diagnosis_text(diagnosis),
        diagnosis_page(diagnosis),
    )
    write_files(out, dict(zip(NAMES, texts, strict=True)))


def write_files(out: Path, texts: Mapping[str, str]) -> None:
    """Writes texts by file name to the folder `out`; all are finished before the first is in place.

    Raises:
        UsageError: They cannot be written there.
    """
    check_place(out, tuple(texts))
    out.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".writing-", dir=out) as stage:
        for name, text in texts.items():
            with (Path(stage) / name).open("w", encoding="utf-8", errors="replace") as file:
                file.write(text)
                file.flush()
                os.fsync(file.fileno())
        for name in texts:
            (Path(stage) / name).replace(out / name)


def diagnosis_text(diagnosis: Diagnosis) -> str:
    """The whole diagnosis as a Markdown document."""
    parts = [f"# {markdown.escape(tables.title(diagnosis))}"]
    parts.append(f"**{markdown.escape(verdict(diagnosis))}**")
    parts += [markdown.escape(line) for line in remarks(diagnosis)]
    facts = [f"{name}: {markdown.escape(value)}" for name, value in tables.facts(diagnosis)]
    reference = tables.reference_name(diagnosis)
    if reference is not None:
        facts.append(f"reference: {markdown.escape(reference)}")
    parts += ["; ".join(facts) + "."]
    if diagnosis.interface:
        parts += ["## What the logs say wrongly", *_table(tables.interface_table(diagnosis))]
    parts += ["## What to change", *map(markdown.escape, remedy(diagnosis))]
    if diagnosis.blamed:
        parts += ["## How far the gap shrinks", markdown.escape(shrink_sentence(diagnosis))]
        parts += _table(tables.shrink_table(diagnosis))
    if diagnosis.compared:
        parts += ["## Where the gap lies", markdown.escape(where_sentence(diagnosis))]
        parts += _table(tables.where_table(diagnosis))
        parts += ["## What explains it", *_effects(diagnosis)]
    for table in (
        tables.candidates_table,
        tables.support_table,
        tables.shared_table,
        tables.followed_table,
    ):
        parts += _table(table(diagnosis))
    silent = [tables.not_observable_table(diagnosis), tables.limits_table(diagnosis)]
    if any(silent):
        parts += ["## What these flights cannot tell", *(t for s in silent for t in _table(s))]
    if advice := next_flight(diagnosis):
        parts += ["## What to fly next", markdown.escape(advice)]
    parts += ["## Flights", *_table(tables.left_out_table(diagnosis))]
    parts += _table(tables.flights_table(diagnosis))
    parts += _table(tables.noise_table(diagnosis))
    return "\n\n".join(parts) + "\n"


def _effects(diagnosis: Diagnosis) -> list[str]:
    parts = []
    for effect in diagnosis.effects:
        words = load_card(clean(effect.name))
        heading = markdown.escape(tables.effect_heading(diagnosis, effect))
        parts.append(f"**{heading}**. {words.physics}".strip())
        parts += _table(tables.parameters_table(effect))
    return parts


def _table(table: tables.Table | None) -> list[str]:
    """Caption, table and notes, or nothing."""
    if table is None or not table.rows:
        return []
    lines = markdown.text_table(table.headings, table.rows, table.left)
    notes = map(markdown.escape, table.notes)
    return [f"{markdown.escape(table.caption)}:", lines, *notes]
