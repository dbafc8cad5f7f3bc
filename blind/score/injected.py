"""Scores of diagnoses of injected faults: power against size, false alarms, coverage.

| word | an answer with it |
|---|---|
| found | says that something acts: any verdict but `none` and `too_few`, or refuses the logs |
| named | blames an effect that describes the fault, or one that flights cannot tell from it |
| misled | blames an effect, and none that describes the fault |
| refused | could not be given, because the program said what is wrong with the logs |

An answer that says what is wrong with the interface has found something; it has named the fault if
that part of the interface has it.

Each share has the interval of Clopper and Pearson (1934), Biometrika 26, 404-413.
"""

import json
from collections.abc import Mapping
from typing import Any

import pandas as pd

from bench.stats.statistics import records
from blind.draw.faults import ALL
from blind.draw.injected import NOTHING, Injected
from blind.score.answers import REFUSED, beside_truth
from blind.score.scoring import proportion
from diagnosis.result import Diagnosis, Effect
from diagnosis.statements import judged_of

Json = Mapping[str, Any]
Row = dict[str, Any]

UNTOLD = ("too_few", "failed")
"""Verdicts that say nothing of whether something changed."""
FALSE_ALARM = "anything wrong found in undisturbed flights"
MISLED = "a wrong effect blamed for a fault"
INSIDE = "truth inside stated 95 % intervals"
"""Scores of `shares` by name."""


def injected_rows(
    cases: Mapping[str, Injected], answers: Mapping[str, Json], statuses: Mapping[str, Json]
) -> tuple[pd.DataFrame, pd.DataFrame]:
    """A table with one row a case, and one with one row a compared number of a right answer."""
    judged, numbers = [], []
    for name, case in cases.items():
        found = Diagnosis.of_json(answers[name]) if name in answers else None
        judged.append(_judge(case, found, statuses[name]))
        if found is not None:
            own = {"case": case.id, "fault": case.fault, "size": case.size}
            numbers += beside_truth(own, found.blamed, case.answers)
    columns = ["case", "fault", "size", "effect", "parameter", "true", "value", "low", "high"]
    return pd.DataFrame(judged), pd.DataFrame(numbers, columns=[*columns, "use", "inside"])


def power(cases: pd.DataFrame) -> pd.DataFrame:
    """One row a fault and size: how many were found, named and misled, with intervals."""
    faulty, rows = [row for row in records(cases) if row["fault"] != NOTHING], []
    for fault, size in dict.fromkeys((row["fault"], row["size"]) for row in faulty):
        part = [row for row in faulty if (row["fault"], row["size"]) == (fault, size)]
        own: Row = {"fault": fault, "size": size, "n": len(part)}
        for column in ("found", "named", "misled", "refused"):
            share = proportion(sum(bool(row[column]) for row in part), len(part))
            own |= {column: share.hits, f"{column}_low": share.low, f"{column}_high": share.high}
        rows.append(own)
    return pd.DataFrame(rows)


def shares(cases: pd.DataFrame, numbers: pd.DataFrame) -> pd.DataFrame:
    """False alarms and coverage: hits, cases, value and interval of each."""
    rows = records(cases)
    # An answer that nothing can be told, or none at all, could have been no false alarm.
    quiet = [row for row in rows if row["fault"] == NOTHING]
    quiet = [row for row in quiet if row["found"] or row["verdict"] not in UNTOLD]
    faulty = [row for row in rows if row["fault"] != NOTHING]
    # An interval that is marked as descriptive is not meant to hold the truth.
    stated = [
        row for row in records(numbers) if pd.notna(row["low"]) and row["use"] != "descriptive"
    ]
    wanted = (
        ("an effect blamed in undisturbed flights", quiet, "misled"),
        (FALSE_ALARM, quiet, "found"),
        ("faults found", faulty, "found"),
        (MISLED, faulty, "misled"),
        (INSIDE, stated, "inside"),
    )
    rows = [
        {"score": name, **vars(proportion(sum(bool(row[column]) for row in among), len(among)))}
        for name, among, column in wanted
    ]
    return pd.DataFrame(rows)


def _judge(case: Injected, found: Diagnosis | None, status: Json) -> Row:
    blamed = [effect for effect in found.effects if effect.blamed] if found else []
    parts = [fault.part for fault in found.interface] if found else []
    told = case.fault in ALL and bool({*parts} & {*ALL[case.fault].parts})
    described = any(_describes(case, effect) for effect in blamed)
    refused = found is None and str(status["cause"]).startswith(REFUSED)
    return {
        "case": case.id,
        "fault": case.fault,
        "size": case.size,
        "parameters": json.dumps(dict(case.parameters)),
        "target": " ".join(case.target),
        "verdict": "failed" if found is None else found.verdict,
        "answer": " + ".join(effect.name for effect in blamed),
        "probability": found.probability if found else None,
        "drift_falls": found.shrink.percent if found else None,
        "interface": ", ".join(parts),
        "found": refused
        or bool(parts)
        or (found is not None and judged_of(found.verdict) != "none"),
        "named": described or told,
        "misled": bool(blamed) and not described,
        "refused": refused,
        "status": status["status"],
        "cause": status["cause"],
        "seconds": status["seconds"],
    }


def _describes(case: Injected, effect: Effect) -> bool:
    return bool({effect.name, *effect.aliases} & set(case.answers))
