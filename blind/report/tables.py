"""The tables of a blind run: what was true, what was answered, how good that is; small, to be kept.

| Parquet file | one row |
|---|---|
| `cases` | a case: truth, answer, evidence, decidability, shrink, seconds |
| `parameters` | a parameter of a right answer: error, over the Cramer-Rao bound, inside interval |
| `proportions` | a score on a subset of cases, ours and the baselines', with its interval |
| `by_effect`, `reliability` | see `blind.score.scoring` |
| `next_flight`, `limits` | see `blind.run.studies`; there if these were measured |
| `summary.json`, `run.json`, `labels.json` | numbers that are no proportions; the run; its labels |
"""

import dataclasses
import json
import shutil
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from bench.text.errors import UsageError
from blind.draw.cases import Case
from blind.draw.folders import Folders, write_json
from blind.score.scoring import score

Json = Mapping[str, Any]

OURS = "bench diagnose"
"""Who answers, beside the baselines."""
FRAMES = ("cases", "parameters", "proportions", "by_effect", "reliability")
"""Tables by file name."""
MOST_CANDIDATES = 4
"""Candidates that are kept as evidence of an answer."""


@dataclasses.dataclass(frozen=True)
class Tables:
    """All tables of one blind run."""

    cases: pd.DataFrame
    """One row a case."""
    parameters: pd.DataFrame
    """One row a compared quantity of a right answer."""
    proportions: pd.DataFrame
    """Scores of everybody in `who`, with intervals."""
    by_effect: pd.DataFrame
    """Singles by effect and size."""
    reliability: pd.DataFrame
    """Stated probability against frequency."""
    summary: dict[str, Any]
    """Numbers that are no proportions, by who answered."""
    run: dict[str, Any]
    """What was drawn, and the SHA-256 of the labels."""
    studies: Mapping[str, pd.DataFrame] = dataclasses.field(default_factory=dict)
    """The other tables that are there, by name; written by `blind.run.studies`."""

    def save(self, directory: Path) -> None:
        """Writes all of them but those of studies."""
        frames = {name: getattr(self, name) for name in FRAMES}
        save_tables(directory, frames, summary=self.summary, run=self.run)

    @classmethod
    def load(cls, directory: Path) -> "Tables":
        """What `save` wrote.

        Raises:
            UsageError: A table is missing or cannot be read.
        """
        others = [p.stem for p in directory.glob("*.parquet") if p.stem not in FRAMES]
        studies = load_tables(directory, others)
        return cls(**load_tables(directory, FRAMES, ("summary", "run")), studies=studies)


def make_tables(
    cases: Mapping[str, Case],
    answers: Mapping[str, Json],
    statuses: Mapping[str, Json],
    measures: Mapping[str, Json],
    baselines: Mapping[str, Mapping[str, Json]],
    run: Json,
) -> Tables:
    """The tables; cases that could not be measured count as decidable."""
    ours = score(cases, answers, measures)
    everybody = {OURS: ours} | {
        name: score(cases, given, measures) for name, given in baselines.items()
    }
    rows = [
        row
        | _evidence(cases[row["case"]], answers.get(row["case"], {}))
        | _status(statuses[row["case"]])
        | _measured(measures.get(row["case"], {}))
        | {f"{name} answers": _answer(given.get(row["case"])) for name, given in baselines.items()}
        for row in ours.cases.to_dict("records")
    ]
    return Tables(
        cases=pd.DataFrame(rows),
        parameters=ours.parameters,
        proportions=pd.concat(
            [s.proportions.assign(who=who) for who, s in everybody.items()], ignore_index=True
        ),
        by_effect=ours.by_effect,
        reliability=ours.reliability,
        summary={who: s.summary for who, s in everybody.items()},
        run=dict(run) | {"sources": sorted({s["sources"] for s in statuses.values()})},
    )


def save_tables(directory: Path, frames: Mapping[str, pd.DataFrame], **documents: Json) -> None:
    """Writes frames as Parquet and then documents as JSON, each whole or not at all."""
    directory.mkdir(parents=True, exist_ok=True)
    for name, frame in frames.items():
        part = directory / f".{name}.part"
        frame.to_parquet(part, index=False)
        part.replace(directory / f"{name}.parquet")
    for name, content in documents.items():
        write_json(directory / f"{name}.json", content)


def load_tables(
    directory: Path, frames: Sequence[str], documents: Sequence[str] = ()
) -> dict[str, Any]:
    """Frames and documents that `save_tables` wrote, by name.

    Raises:
        UsageError: One of them is missing or cannot be read.
    """
    files = {name: directory / f"{name}.parquet" for name in frames}
    texts = {name: directory / f"{name}.json" for name in documents}
    for path in (*files.values(), *texts.values()):
        if not path.is_file():
            raise UsageError(f"{path} is missing; `bench blind` writes it when a run has ended.")
    try:
        read = {name: json.loads(path.read_text(encoding="utf-8")) for name, path in texts.items()}
        return read | {name: pd.read_parquet(path) for name, path in files.items()}
    except (OSError, ValueError) as error:
        reason = str(error).splitlines()[0]
        raise UsageError(f"A table in {directory} cannot be read: {reason}") from error


def save_labels(folders: Folders) -> None:
    """Keeps the labels beside the tables: with them anybody can check their SHA-256."""
    shutil.copy(folders.labels, folders.out / "labels.json")


def _evidence(case: Case, answer: Json) -> dict[str, Any]:
    """Details of the truth and of the answer, lists as JSON text."""
    effects = answer.get("effects", ())
    candidates = list(answer.get("candidates", ()))[:MOST_CANDIDATES]
    shrink = answer.get("shrink") or {}
    return {
        "drones": case.drones,
        "truth_parameters": json.dumps({e.name: e.parameters for e in case.effects}),
        "answer_parameters": json.dumps({e["name"]: e["parameters"] for e in effects}),
        "probabilities": json.dumps({e["name"]: e.get("probability") for e in effects}),
        "aliases": json.dumps({e["name"]: e.get("aliases", []) for e in effects}),
        "candidates": json.dumps(candidates),
        "unexplained_share": answer.get("unexplained_share"),
        "structure": answer.get("structure"),
        "dispersion": answer.get("dispersion"),
        "shrink_low": shrink.get("low"),
        "shrink_high": shrink.get("high"),
    }


def _status(status: Json) -> dict[str, Any]:
    return {key: status[key] for key in ("status", "cause", "seconds")}


def _measured(found: Json) -> dict[str, Any]:
    return {
        "measured": bool(found),
        "margin": found.get("margin"),
        "rival": " + ".join(found.get("rival", ())),
        "gap": found.get("gap"),
        "left": found.get("left"),
        "wrong": found.get("wrong", ""),
        "bound": json.dumps(found.get("bound", {})),
        "oracle_parameters": json.dumps(found.get("oracle", {})),
    }


def _answer(answer: Json | None) -> str:
    if answer is None:
        return "failed"
    return " + ".join(e["name"] for e in answer["effects"]) or str(answer["verdict"])
