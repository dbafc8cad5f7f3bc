"""Paragraphs and tables of the blind report."""

import math
from typing import Any

import numpy as np
import pandas as pd

from bench import markdown
from bench.blind.tables import OURS, Tables
from bench.statistics import records

MISSING = "—"
INTERVALS = "truth inside 95 % intervals"
COVERAGE = (0.93, 0.97)
"""Share of intervals that should hold the truth."""

NUMBERS: tuple[tuple[str, str, str, float, str], ...] = (
    ("median_parameter_error", "median parameter error", "≤", 0.03, "%"),
    ("rms_over_cramer_rao", "RMS parameter error over the Cramér-Rao bound", "≤", 1.5, ""),
    ("median_shrink_over_oracle", "median shrink over the true effect's", "≥", 0.97, "%"),
)
"""Summary key, its name, the direction of the aim, the aim, the unit in which it is shown."""


def facts(tables: Tables) -> list[str]:
    """What was run."""
    cases, run = tables.cases, tables.run
    kinds = ", ".join(f"{n} {kind}" for kind, n in run["counts"].items())
    rows = records(cases)
    failed = sum(row["status"] != "ok" for row in rows)
    effects = [row for row in rows if row["kind"] != "clean"]
    undecidable = sum(not row["decidable"] for row in effects)
    unmeasured = sum(not row["measured"] for row in rows)
    drawn = "of the operating system" if run["seed"] is None else f"{run['seed']}"
    versions = ", ".join(f"{name} {version}" for name, version in run["versions"].items())
    lines = [
        f"{len(cases)} cases ({kinds}), drawn {run['started']} with the seed {drawn}. SHA-256 of "
        f"the labels: `{run['sha256']}`.",
        f"{failed} diagnoses failed; they count as wrong. A diagnosis took "
        f"{cases['seconds'].median():.0f} s (median, with start and compilation). "
        f"{undecidable} of {len(effects)} cases with an effect are undecidable"
        f"{_percent_of(undecidable, len(effects))}.",
    ]
    if unmeasured:
        lines.append(f"{unmeasured} cases could not be measured and count as decidable.")
    sources = run["sources"]
    if len(sources) > 1:
        lines.append(f"**The answers come from {len(sources)} versions of the program.**")
    lines.append(f"Versions: {markdown.escape(versions)}; program {sources[0][:12]}.")
    return lines


def aims(tables: Tables) -> list[str]:
    """Aims beside measured scores."""
    rows = []
    for row in records(tables.proportions):
        subset = "all" if row["score"] == INTERVALS else "decidable"
        if row["who"] != OURS or not row["n"] or row["cases"] != subset:
            continue
        rows.append(
            (
                markdown.escape(row["score"]),
                f"{row['hits']}/{row['n']}",
                _percent(row["value"]),
                f"{_percent(row['low'])} to {_percent(row['high'])}",
                _aim(row),
                _verdict(row),
            )
        )
    summary = tables.summary[OURS]
    for key, name, sign, aim, unit in NUMBERS:
        value = summary.get(key)
        shown, wanted = _shown(value, unit), f"{sign} {_shown(aim, unit)}"
        met = value is not None and (value <= aim if sign == "≤" else value >= aim)
        word = MISSING if value is None else "met" if met else "**missed**"
        rows.append((name, "", shown, "", wanted, word))
    headings = ("score", "hits", "measured", "95 % interval", "aim", "verdict")
    lines = [markdown.table(headings, rows, (0, 5)), _shrinks(summary)]
    return [
        "On decidable cases; *met* is said of the measured value, *within the interval* where only "
        "the interval reaches the aim.",
        *filter(None, lines),
    ]


def baselines(tables: Tables) -> list[str]:
    """The same scores for everybody."""
    table = tables.proportions
    shown = table.loc[(table["cases"] == "decidable") & (table["n"] > 0)]
    everybody = list(dict.fromkeys(table["who"]))
    rows = []
    for name in dict.fromkeys(shown["score"]):
        by_who = shown.loc[shown["score"] == name].set_index("who")
        rows.append((markdown.escape(name), *(_cell(by_who, who) for who in everybody)))
    for key, name, _, _, unit in NUMBERS[:1]:
        rows.append((name, *(_shown(tables.summary[who].get(key), unit) for who in everybody)))
    return [
        "Residual correlation, sparse regression (STLSQ) and a fit of everything, each with a "
        "threshold set on undisturbed flights; they cannot say `unexplained`.",
        markdown.table(("score", *map(markdown.escape, everybody)), rows),
    ]


def by_effect(tables: Tables) -> list[str]:
    """Singles that were named, by effect and size."""
    table = tables.by_effect
    if table.empty:
        return []
    rows = []
    for effect, part in table.groupby("effect"):
        sizes = part.set_index("size").to_dict("index")
        cells = [_named(sizes.get(size)) for size in ("small", "medium", "large")]
        rows.append((markdown.escape(str(effect)), *cells))
    note = "Right first answers over cases; in brackets those that are decidable."
    return [note, markdown.table(("effect", "small", "medium", "large"), rows)]


def parameters(tables: Tables) -> list[str]:
    """Errors, bounds and coverage by quantity."""
    table = tables.parameters
    if table.empty:
        return ["No parameter could be compared."]
    rows = []
    compared = records(table)
    for quantity in sorted({row["quantity"] for row in compared}):
        part = [row for row in compared if row["quantity"] == quantity]
        middle = float(np.median([row["error"] for row in part]))
        inside, n = (sum(row[key] for row in part) for key in ("inside", "intervals"))
        over = np.asarray([row["over_bound"] for row in part], float)
        over = over[np.isfinite(over)]
        rows.append(
            (
                markdown.escape(quantity),
                str(len(part)),
                _percent(middle) if part[0]["relative"] else f"{middle:.2g}",
                f"{np.sqrt(np.mean(over**2)):.2f}" if len(over) else MISSING,
                f"{np.median(over):.2f}" if len(over) else MISSING,
                f"{inside}/{n}",
            )
        )
    headings = ("quantity", "answers", "median error", "RMS / bound", "median / bound", "inside")
    return [
        "Right answers in singles and pairs. Errors are relative to the size of the effect, except "
        "those of onsets [s] and widths [m]. The bound is Cramér and Rao's, from the same flights "
        "without noise; *inside* counts 95 % intervals that hold the truth.",
        markdown.table(headings, rows),
    ]


def reliability(tables: Tables) -> list[str]:
    """Stated probabilities and how often they were right."""
    rows = [
        (
            f"{row['from']:.1f} to {row['to']:.1f}",
            str(row["n"]),
            _percent(row["stated"]),
            _percent(row["value"]),
            f"{_percent(row['low'])} to {_percent(row['high'])}",
        )
        for row in records(tables.reliability)
    ]
    if not rows:
        return ["No effect was named with a probability."]
    brier = tables.summary[OURS].get("brier")
    headings = ("stated", "effects", "mean stated", "true", "95 % interval")
    return [
        markdown.table(headings, rows),
        f"Brier score {brier:.3f}." if brier is not None else "",
    ]


def _shrinks(summary: dict[str, Any]) -> str:
    ours, wrong = summary.get("median_shrink"), summary.get("median_shrink_of_best_wrong")
    if ours is None or wrong is None:
        return ""
    return (
        f"Drift on flights left out shrinks by {ours:.1f} % in the median, and by {wrong:.1f} % "
        "under the single wrong effect that looks best."
    )


def _aim(row: dict[str, Any]) -> str:
    if row["score"] == INTERVALS:
        return f"{_percent(COVERAGE[0])} to {_percent(COVERAGE[1])}"
    return f"≥ {_percent(row['aim'])}" if pd.notna(row["aim"]) else MISSING


def _verdict(row: dict[str, Any]) -> str:
    """Met, missed, or missed with an interval that reaches the aim."""
    if pd.isna(row["aim"]):
        return MISSING
    low, high = COVERAGE if row["score"] == INTERVALS else (row["aim"], 1.0)
    if low <= row["value"] <= high:
        return "met"
    reaches = row["low"] <= high and row["high"] >= low
    return "missed, within the interval" if reaches else "**missed**"


def _cell(by_who: pd.DataFrame, who: str) -> str:
    if who not in by_who.index:
        return MISSING
    row = by_who.loc[who]
    return f"{_percent(row['value'])} ({_percent(row['low'])} to {_percent(row['high'])})"


def _named(cell: dict[str, Any] | None) -> str:
    if cell is None:
        return MISSING
    return f"{cell['right']}/{cell['n']} ({cell['right_decidable']}/{cell['decidable']})"


def _shown(value: float | None, unit: str) -> str:
    if value is None:
        return MISSING
    return _percent(value) if unit == "%" else f"{value:.2f}"


def _percent(value: float) -> str:
    return f"{100.0 * value:.1f} %" if math.isfinite(value) else MISSING


def _percent_of(count: int, total: int) -> str:
    return f" ({_percent(count / total)})" if total else ""
