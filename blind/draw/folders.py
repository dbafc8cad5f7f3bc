"""Where a blind run keeps what: `OUT/runs` holds flights, labels and answers, `OUT` the tables.

| path | |
|---|---|
| `OUT/runs/run.json` | what was drawn, and the SHA-256 of the labels |
| `OUT/runs/cases/ID` | the flights of a case, all that a diagnosis is given |
| `OUT/runs/labels` | what the cases are, and their flights without noise |
| `OUT/runs/reference`, `undisturbed/N` | flights of the undisturbed vehicle, for the baselines |
| `OUT/runs/references/N` | such flights for the diagnoses: a set for several cases, or for one |
| `OUT/runs/answers/ID` | documents of a diagnosis and `status.json` |
| `OUT/runs/measures/ID.json` | what the case allows, measured with its label |
| `OUT/runs/baselines` | what baselines answer |

A draw goes on elsewhere from `run.json`, `labels/labels.json` and `answers`: flights that are gone
are flown again from its seeds.
"""

import json
from pathlib import Path
from typing import Any

from bench.text.errors import UsageError
from bench.text.pages import write_text
from blind.draw.cases import KINDS, Case, digest, reference_sets_in

DEFAULT_COUNTS = {"single": 126, "pair": 60, "clean": 75, "unknown": 30, "excluded": 30}
"""Cases of each kind in a counted run."""
RESULTS = Path("results") / "blind"
"""Where the tables of both realities go."""
INJECTED = "injected"
"""Folder in it with tables of faults that were injected into logs, a folder a flight set."""


class Folders:
    """The folders of one blind run; what they hold stands at the top of this module."""

    def __init__(self, out: Path) -> None:
        self.out, self.runs = out, out / "runs"
        self.state = self.runs / "run.json"
        self.labels = self.runs / "labels" / "labels.json"
        self.cases, self.answers = self.runs / "cases", self.runs / "answers"
        self.measures, self.baselines = self.runs / "measures", self.runs / "baselines"
        self.reference, self.references = self.runs / "reference", self.runs / "references"
        self.undisturbed = self.runs / "undisturbed"

    def flown(self) -> list[Path]:
        """Cases whose flights are there, with and without noise."""
        true = self.labels.parent / "true"
        return [path for path in _whole(self.cases) if (true / path.name).is_dir()]

    def gone(self, n_cases: int) -> bool:
        """Whether flights of a draw of so many cases are missing."""
        state = self.read_state()
        wanted = [(self.reference, 0), (self.undisturbed, state.get("undisturbed", 0))]
        if sets := reference_sets_in(state["reality"]):
            wanted.append((self.references, sets))
        there = (path.is_dir() and len(_whole(path)) >= n for path, n in wanted)
        return not all(there) or len(self.flown()) < n_cases

    def reference_of(self, case: Case) -> Path | None:
        """The flights beside which a case of effects is diagnosed; None where it needs none.

        Raises:
            UsageError: The draw is an older one, in which all cases had one reference.
        """
        if not reference_sets_in(case.reality):
            return None
        if case.reference is None:
            raise UsageError(
                f"{self.labels} is of an older draw, with one reference for all cases. Make a new "
                "draw in another folder (`--out`)."
            )
        return self.references / str(case.reference)

    def drawn(self) -> list[Path]:
        """All that a draw makes; studies, which lie beside it, are none of it."""
        made = (self.cases, self.labels.parent, self.reference, self.undisturbed)
        made = (*made, self.references)
        return [*made, self.answers, self.measures, self.baselines, self.runs / "logs"]

    def read_state(self) -> dict[str, Any]:
        """What was drawn, and the SHA-256 of the labels."""
        return json.loads(self.state.read_text(encoding="utf-8"))

    def tampered(self) -> str:
        """What is wrong with the labels, empty if they are those whose SHA-256 was printed."""
        printed = self.read_state()["sha256"]
        found = digest(self.labels) if self.labels.is_file() else "gone"
        if found == printed:
            return ""
        return f"{self.labels} has changed: its SHA-256 was {printed} and is {found}."


def _whole(folder: Path) -> list[Path]:
    """Complete flight sets in a folder. The name of an incomplete set ends in `.part`."""
    return [path for path in sorted(folder.glob("*")) if path.suffix == ""]


def scaled_counts(total: int) -> dict[str, int]:
    """Cases of each kind that add up to `total`, in the usual proportions, one of each at least.

    Raises:
        UsageError: There are fewer cases than kinds.
    """
    if total < len(KINDS):
        raise UsageError(f"`--cases` must be at least {len(KINDS)}, one of each kind, got {total}.")
    usual = sum(DEFAULT_COUNTS.values())
    exact = {kind: total * DEFAULT_COUNTS[kind] / usual for kind in KINDS}
    counts = {kind: max(1, int(share)) for kind, share in exact.items()}
    while sum(counts.values()) < total:
        counts[max(KINDS, key=lambda kind: exact[kind] - counts[kind])] += 1
    while sum(counts.values()) > total:
        many = [kind for kind in KINDS if counts[kind] > 1]
        counts[max(many, key=lambda kind: counts[kind] - exact[kind])] -= 1
    return counts


def write_json(path: Path, content: Any) -> None:
    """Writes a JSON file that is there whole or not at all."""
    write_text(path, json.dumps(content, indent=1))
