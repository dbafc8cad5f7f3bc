"""Writes the three documents of a diagnosis: all of them or none."""

import json
import os
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path

from bench.diagnosis_report.page import diagnosis_page
from bench.diagnosis_report.text import diagnosis_text
from bench.text.errors import UsageError
from bench.text.pages import refuse_folder
from diagnosis.result import Diagnosis

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
