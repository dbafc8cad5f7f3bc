"""Thresholds of `Decision` derived again from scored cases, beside the values that are in force.

`python -m blind.score.thresholds results/blind/crazyflow results/blind/rotorpy` takes seconds: it
reads the tables of answered cases and flies nothing. A value may be set by it only if other cases
count it afterwards. What is not here is not derived from cases (`Decision`, source of each field),
or the tables do not keep it.
"""

import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import pandas as pd
from scipy import stats

from bench.stats.statistics import records
from diagnosis.decision import Decision

Case = Mapping[str, Any]
"""A row of a table."""
Row = tuple[str, float, float, int]
"""Name of the threshold, value in force, the same number in the cases (NaN without any), and how
many answers or intervals it comes from."""


def derived(cases: Sequence[Case], parameters: Sequence[Case]) -> list[Row]:
    """Each threshold beside what these cases say of it.

    Structure and shares are the largest that a right answer left: every true effect and no other,
    or none in a clean case. Shares of true effects are of those that were named.
    """
    decision = Decision()
    clean, named = [c for c in cases if c["kind"] == "clean"], [c for c in cases if c["exact"]]
    right = [*named, *(c for c in clean if c["quiet"])]
    slight = [c for c in named if c["structure"] > decision.slight_structure]
    rows = [
        _largest("structure", "structure", right, decision),
        _largest("slight_structure", "structure", clean, decision),
        _largest("unexplained_share", "unexplained_share", slight, decision),
        _largest("unfollowed_share", "unexplained_share", slight, decision),
        _largest("much_share", "unexplained_share", named, decision),
    ]
    doubted = [c for c in cases if c["structure"] > decision.slight_structure]
    sure = [c for c in cases if c["structure"] <= decision.slight_structure]
    rows.append(_true("true_share", sure, decision.true_share))
    rows.append(_true("doubted_share", doubted, decision.doubted_share))
    return [*rows, _widening(parameters, decision.interval_widening)]


def _largest(name: str, column: str, cases: Sequence[Case], decision: Decision) -> Row:
    known = [float(case[column]) for case in cases if math.isfinite(case[column])]
    return name, getattr(decision, name), max(known, default=math.nan), len(known)


def _true(name: str, cases: Sequence[Case], given: float) -> Row:
    """The share of named effects that acted."""
    found = [
        effect in {true.strip() for true in case["truth"].split("+")}
        for case in cases
        for effect in json.loads(case["probabilities"])
    ]
    return name, given, sum(found) / len(found) if found else math.nan, len(found)


def _widening(parameters: Sequence[Case], given: float) -> Row:
    """The factor with which as many 95 % intervals would hold the truth as they say.

    Of Gaussian errors. It is zero if every interval holds it, infinite if none does.
    """
    n, inside = (sum(int(row[name]) for row in parameters) for name in ("intervals", "inside"))
    z = float(stats.norm.ppf(0.5 + 0.5 * inside / n)) if n else math.nan
    return "interval_widening", given, given * 1.96 / z if z else math.inf, n


def main(folders: Sequence[str]) -> int:
    """Prints a table a folder; exit status 0, or 2 without a folder."""
    if not folders:
        print("`folders` must name tables of `bench blind`, got none.", file=sys.stderr)  # noqa: T201
        return 2
    for folder in map(Path, folders):
        cases, parameters = (
            records(pd.read_parquet(folder / f"{name}.parquet")) for name in ("cases", "parameters")
        )
        rows = derived(cases, parameters)
        print(f"| {folder.name} | in force | in these cases | of |\n|---|---|---|---|")  # noqa: T201
        for name, given, found, n in rows:
            print(f"| {name} | {given:.4g} | {found:.4g} | {n} |")  # noqa: T201
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
