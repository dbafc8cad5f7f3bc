"""What the blind report found, on one screen: a table of the draws, and one of injected faults."""

from collections.abc import Mapping, Sequence
from typing import Any

from bench.stats.statistics import records
from bench.text import markdown
from bench.text.numbers import MISSING, percent
from blind.draw.injected import NOTHING
from blind.report.injected_section import InjectedTables
from blind.report.sections import COVERAGE, INTERVALS
from blind.report.tables import OURS, Tables
from blind.score.injected import FALSE_ALARM, INSIDE, MISLED, shares

ABSTAINED, SILENT = "abstention, both", "nothing blamed at all, both"
"""Scores of cases that no effect of the library explains."""
RIGHT = (
    ("one effect acts: it is named, and nothing else", "exact set of singles", "decidable"),
    ("two effects act: both are named, and nothing else", "exact set of pairs", "decidable"),
    ("nothing acts: nothing is found", "nothing found in clean flights", "decidable"),
    (
        "no candidate describes what acts: the answer says that more acts",
        ABSTAINED,
        "decidable",
    ),
    ("the same, and no effect is blamed", SILENT, "decidable"),
    ("a stated 95 % interval holds the true size", INTERVALS, "all"),
)
"""Lines of the first table: what is right, the score that counts it, and on which cases."""
SIMULATED = (
    "The flights were simulated. The diagnosis knows crazyflow and was not told what acts. "
    f"{100 * COVERAGE[0]:.0f} to {percent(COVERAGE[1])} of the intervals should hold the true size."
)
"""What stands over the first table."""
COUNTED = (MISLED, FALSE_ALARM, INSIDE)
"""Scores of the second table, beside the share that is right."""
INJECTED = "Faults were written into real flights."
BESIDE = " The diagnosis had other flights of the same set to compare with."
"""What stands over the second table, and what is added where it is so."""


def in_short(found: Sequence[Tables], injected: Sequence[InjectedTables]) -> list[str]:
    """The section; nothing without tables."""
    parts = []
    if found:
        parts += [SIMULATED, _simulated(found)]
    if injected:
        beside = BESIDE if all(tables.run["reference"] for tables in injected) else ""
        parts += [INJECTED + beside, _injected(injected)]
    return ["## In short", *parts] if parts else []


def _simulated(found: Sequence[Tables]) -> str:
    headings = ("what is right", *(_flown(t) for t in found))
    rows = [("cases", *(str(len(tables.cases)) for tables in found))]
    rows += [(text, *(_share(t, score, cases) for t in found)) for text, score, cases in RIGHT]
    fallen = [t.summary[OURS].get("median_shrink") for t in found]
    shown = (MISSING if value is None else f"{value:.0f} %" for value in fallen)
    rows.append(("on held-out flights, the drift falls by (median)", *shown))
    return markdown.table(headings, rows)


def _flown(tables: Tables) -> str:
    return f"flown in {markdown.escape(tables.run['reality'])}"


def _share(tables: Tables, score: str, cases: str) -> str:
    for row in records(tables.proportions):
        if (row["who"], row["score"], row["cases"]) == (OURS, score, cases) and row["n"]:
            share = f" ({percent(row['hits'] / row['n'])})" if score == INTERVALS else ""
            return f"{row['hits']} of {row['n']}{share}"
    return MISSING


def _hits(row: Mapping[str, Any]) -> str:
    return f"{row['hits']} of {row['n']}" if row["n"] else MISSING


def _injected(runs: Sequence[InjectedTables]) -> str:
    rows = []
    for tables in runs:
        faulty = tables.cases.loc[tables.cases["fault"] != NOTHING]
        right = int((faulty["named"].astype(bool) | faulty["refused"].astype(bool)).sum())
        counted = {row["score"]: row for row in records(shares(tables.cases, tables.numbers))}
        few = int(faulty["verdict"].eq("too_few").sum())
        others = (_hits(counted[score]) for score in COUNTED)
        name, n = markdown.escape(tables.run["injected"]), len(faulty)
        rows.append((name, f"{right} of {n}", f"{few} of {n}", *others))
    answers = ("faults named, or logs refused with the reason", "too few flights to tell")
    return markdown.table(("flights", *answers, *COUNTED), rows)
