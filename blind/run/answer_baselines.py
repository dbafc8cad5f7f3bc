"""What simple baselines say of the same cases, calibrated on undisturbed flights.

`python -m blind.run.answer_baselines` takes its settings as one JSON object and writes one file.
"""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from bench.text.errors import UsageError
from blind.draw.folders import Folders, write_json
from blind.run.children import Task, leave_with_parent, python, run_one

ALARMS = 0.02
"""Share of undisturbed flight sets that a baseline may find something in: the aim that we have."""


def answer_baselines(folders: Folders) -> dict[str, dict[str, Any]]:
    """Answers by baseline and case, computed if they are not there yet.

    Raises:
        UsageError: The process that computes them failed.
    """
    path = folders.runs / "baselines.json"
    if not path.is_file():
        runs = folders.runs.resolve()
        settings = json.dumps({"out": str(folders.out.resolve())})
        command = python("-m", "blind.run.answer_baselines", settings)
        if cause := run_one(Task("baselines", command, runs, runs / "logs" / "baselines")):
            raise UsageError(f"The baselines failed, {cause}; running again tries again.")
    return json.loads(path.read_text(encoding="utf-8"))["answers"]


def _answers(folders: Folders) -> dict[str, Any]:
    """Thresholds by baseline, and answers by baseline and case."""
    from blind.draw.cases import read_labels
    from blind.score.baselines import BASELINES, answer, threshold
    from diagnosis.logs.flights import load_flights

    reference = load_flights(folders.reference)
    undisturbed = [load_flights(path) for path in sorted(folders.undisturbed.iterdir())]
    cases = read_labels(folders.labels)
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


if __name__ == "__main__":
    leave_with_parent()
    place = Folders(Path(json.loads(sys.argv[1])["out"]))
    write_json(place.runs / "baselines.json", _answers(place))
