"""Scores of diagnoses of labelled real flights, by airframe, with abstention.

| outcome | the label names effects | it is `none` | it is `unknown` |
|---|---|---|---|
| right | blames them all, nothing else | `none` | something acts, nothing is blamed |
| in part | blames some of them, nothing else | | |
| wrong | blames an effect that does not act | something acts | blames an effect |
| missed | `none` | | `none` |
| abstained | anything else, or the logs are refused | `too_few`, refused | `too_few`, refused |

An effect that flights cannot tell from one in the label (an alias) counts as that one. Shares have
the interval of Clopper and Pearson (1934), Biometrika 26, 404-413.
"""

from collections.abc import Mapping
from typing import Any

import pandas as pd

from blind.draw.manifest import NONE, UNKNOWN, LabelledSet, Manifest
from blind.score.answers import REFUSED, beside_truth
from blind.score.scoring import proportion
from diagnosis.result import Diagnosis, Effect

OUTCOMES = ("right", "in part", "wrong", "missed", "abstained", "failed")
"""What an answer can be; `failed`: the program ended without one, which is a fault of its own."""


def real_rows(
    manifest: Manifest,
    answers: Mapping[str, Mapping[str, Any]],
    statuses: Mapping[str, Mapping[str, Any]],
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """A table with one row a set, and one with one row a number that has a true value."""
    rows, numbers = [], []
    for name, own in manifest.sets.items():
        found = Diagnosis.of_json(answers[name]) if name in answers else None
        status, blamed = statuses[name], found.blamed if found else ()
        rows.append(
            {
                "set": name,
                "airframe": own.airframe,
                "licence": own.licence,
                "sha256": own.sha256,
                "label": own.label if isinstance(own.label, str) else " + ".join(own.label),
                "reference": own.reference or "",
                "outcome": outcome(own, found, str(status["cause"])),
                "verdict": found.verdict if found else "failed",
                "answer": " + ".join(effect.name for effect in blamed),
                "probability": found.probability if found else None,
                "drift_falls": found.shrink.percent if found else None,
                "cause": status["cause"],
                "seconds": status["seconds"],
            }
        )
        numbers += beside_truth({"set": name}, blamed, own.parameters)
    columns = ["set", "effect", "parameter", "true", "value", "low", "high", "use", "inside"]
    return pd.DataFrame(rows), pd.DataFrame(numbers, columns=columns)


def outcome(own: LabelledSet, found: Diagnosis | None, cause: str = "") -> str:
    """One of `OUTCOMES`."""
    if found is None:
        return "abstained" if cause.startswith(REFUSED) else "failed"
    if own.label == NONE and found.interface:
        return "wrong"
    if found.verdict == "too_few":
        return "abstained"
    blamed = found.blamed
    if own.label == NONE:
        return "right" if found.verdict == "none" else "wrong"
    if any(not _means(own, effect) for effect in blamed):
        return "wrong"
    if found.verdict == "none" and not found.interface:
        return "missed"
    if own.label == UNKNOWN:
        return "right"
    if not blamed:
        return "abstained"
    named = set().union(*(_means(own, effect) for effect in blamed))
    return "right" if named == set(own.acting) else "in part"


def _means(own: LabelledSet, effect: Effect) -> set[str]:
    """Those of the label that a blamed effect may stand for."""
    return {effect.name, *effect.aliases} & set(own.acting)


def by_airframe(rows: pd.DataFrame) -> pd.DataFrame:
    """One row an airframe: outcomes, the share answered, and of those the share right."""
    found = []
    for airframe in sorted(set(rows["airframe"])):
        mine = rows.loc[rows["airframe"].eq(airframe), "outcome"]
        counts = {name: int((mine == name).sum()) for name in OUTCOMES}
        answered = len(mine) - counts["abstained"] - counts["failed"]
        right = counts["right"] + counts["in part"]
        own: dict[str, Any] = {"airframe": airframe, "sets": len(mine), **counts}
        for name, share in (
            ("answered", proportion(answered, len(mine))),
            ("true", proportion(right, answered)),
        ):
            own |= {name: share.value, f"{name}_low": share.low, f"{name}_high": share.high}
        found.append(own)
    return pd.DataFrame(found)
