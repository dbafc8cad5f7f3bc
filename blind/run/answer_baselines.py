"""What simple baselines say of the same cases, calibrated on undisturbed flights."""

import json
from collections.abc import Mapping
from typing import Any

from blind.draw.cases import Case, read_labels
from blind.draw.folders import Folders, write_json
from blind.run.answering import sources_digest

ALARMS = 0.02
"""Share of undisturbed flight sets that a baseline may find something in: the aim that we have."""


def answer_baselines(folders: Folders) -> dict[str, dict[str, Any]]:
    """Answers by baseline and case, computed if this program has not done so yet."""
    path = folders.baselines / "answers.json"
    program = sources_digest(with_generator=True)
    kept: dict[str, Any] = json.loads(path.read_text(encoding="utf-8")) if path.is_file() else {}
    if kept.get("program") != program:
        kept = {**_answers(folders), "program": program}
        write_json(path, kept)
    return kept["answers"]


def _answers(folders: Folders) -> dict[str, Any]:
    """Thresholds by baseline, and answers by baseline and case."""
    from blind.score.baselines import BASELINES, answer, threshold
    from diagnosis.logs.flights import load_flights

    reference = load_flights(folders.reference)
    undisturbed = [load_flights(path) for path in sorted(folders.undisturbed.iterdir())]
    cases = read_labels(folders.labels, Case.of)
    limits: dict[str, float] = {}
    answers: dict[str, Mapping[str, Any]] = {}
    for name, find in BASELINES.items():
        limits[name] = threshold([find(f, reference).strength for f in undisturbed], ALARMS)
        answers[name] = {
            case.id: answer(
                find(load_flights(folders.cases / case.id), reference), limits[name], case.seconds
            )
            for case in cases.values()
        }
    return {"thresholds": limits, "answers": answers}
