"""Paragraphs and tables of the blind report.

What can be computed from the rows of the cases is computed here, so that tables of earlier draws
are read like those of later ones.
"""

import math
from typing import Any

import numpy as np
import pandas as pd

from bench.stats.statistics import records
from bench.text import markdown
from bench.text.numbers import MISSING, percent
from bench.text.words import count
from blind.draw.catalogue import LIBRARY
from blind.report.tables import OURS, Json, Tables
from blind.score.scoring import Proportion, proportion

OUR_COLOR = "#00527f"
"""The accent of the pages."""
INTERVALS = "truth inside 95 % intervals"
COVERAGE = (0.93, 0.97)
"""Share of intervals that should hold the truth."""
ONE_EFFECT = ("correlation", "everything")
"""Baselines that name one effect at most."""
SHRUNK = 0.97
"""Share of the true effect's shrink that an answer should reach."""
RESAMPLED = 4000
"""Draws of cases for the interval of a coverage."""

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
    known = [row for row in effects if row["measured"]]
    undecidable = sum(not row["decidable"] for row in known)
    unmeasured = [row for row in rows if not row["measured"]]
    share = f" ({percent(undecidable / len(known), 1)})" if known else ""
    drawn = "of the operating system" if run["seed"] is None else f"{run['seed']}"
    versions = ", ".join(f"{name} {version}" for name, version in run["versions"].items())
    lines = [
        f"{len(cases)} cases ({kinds}), drawn {run['started']} with the seed {drawn}. SHA-256 of "
        f"the labels: `{run['sha256']}`.",
        f"{failed} diagnoses failed; they count as wrong. A diagnosis took "
        f"{cases['seconds'].median():.0f} s (median, with start and compilation). "
        f"{undecidable} of {len(known)} cases with an effect that were measured are undecidable"
        f"{share}.",
    ]
    if unmeasured:
        several = sum(row["drones"] > 1 for row in unmeasured)
        lines.append(
            f"**{len(unmeasured)} cases were not measured, {several} of them with several "
            "drones.** They count as decidable; Cramér-Rao bounds and shrinks of the true effect "
            "are those of the others."
        )
    lines += several_programs(run)
    if len(run.get("measured_by", ())) > 1:
        n = len(run["measured_by"])
        lines.append(f"Decidability and bounds were measured by {n} versions of the program.")
    lines.append(f"Versions: {markdown.escape(versions)}; program {run['sources'][0][:12]}.")
    return lines


def several_programs(run: Json) -> list[str]:
    """A line that says how many programs answered, if it was not one."""
    n = len(run["sources"])
    return [f"**The answers come from {n} versions of the program.**"] if n > 1 else []


def aims(tables: Tables) -> list[str]:
    """Aims beside measured scores."""
    rows = []
    for row in records(tables.proportions):
        subset = "all" if row["score"] == INTERVALS else "decidable"
        if row["who"] != OURS or not row["n"] or row["cases"] != subset:
            continue
        if row["score"] == INTERVALS:
            row |= _resampled(tables.parameters, row)
        rows.append(
            (
                markdown.escape(row["score"]),
                f"{row['hits']}/{row['n']}",
                percent(row["value"], 1),
                _range(row["low"], row["high"]),
                _aim(row),
                _verdict(row),
            )
        )
    rows += [_near(tables.cases), _calibrated(tables)]
    summary, counts = tables.summary[OURS], _counts(tables)
    for key, name, sign, aim, unit in NUMBERS:
        value = summary.get(key)
        shown, wanted = _shown(value, unit), f"{sign} {_shown(aim, unit)}"
        met = value is not None and (value <= aim if sign == "≤" else value >= aim)
        word = MISSING if value is None else "met" if met else "**missed**"
        rows.append((name, f"n = {counts[key]}", shown, "", wanted, word))
    headings = ("score", "hits", "measured", "95 % interval", "aim", "verdict")
    lines = [markdown.table(headings, rows, (0, 5)), _shrinks(summary)]
    return [
        "Names are scored on decidable cases, numbers and intervals on all true effects that were "
        "named. *Single*, *pair*: one effect acts, or two. *Top-1*: the likeliest of the named "
        "effects is a true one; *alias class*: or one that these flights cannot tell from it. "
        "*Exact set*: all true effects are named, and no other. *Shrink*: by how much the drift on "
        "left-out flights falls. *Program*: a hash of the diagnosis's source. *Abstention* is the "
        "verdict `unexplained` or `partly`, or an effect with a tenth or more of the gap left "
        "unexplained. *Met* is said of the measured value, *within the interval* where only the "
        "interval reaches the aim. The interval of the share of intervals "
        f"resamples {_unit(tables.parameters)}s.",
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
        able = [who for who in everybody if asked(name, who)]
        cells = (_cell(by_who, who) if who in able else MISSING for who in everybody)
        rows.append((markdown.escape(name), *cells))
    for key, name, _, _, unit in NUMBERS[:1]:
        rows.append((name, *(_shown(tables.summary[who].get(key), unit) for who in everybody)))
    return [
        "Residual correlation, sparse regression (STLSQ) and a fit of everything, each with a "
        "threshold set on undisturbed flights. No baseline can answer `unexplained`, so that "
        "abstention is not scored for it. Correlation and the fit of everything name one effect at "
        "most. An error counts where the baseline named the true effect.",
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
        widths = np.asarray([row["half_width"] for row in part], float)
        known = widths[np.isfinite(widths)]
        show = percent if part[0]["relative"] else lambda x: f"{x:.2g}"
        rows.append(
            (
                markdown.escape(quantity),
                str(len(part)),
                show(middle),
                show(float(np.median(known))) if len(known) else MISSING,
                f"{np.sqrt(np.mean(over**2)):.2f}" if len(over) else MISSING,
                f"{np.median(over):.2f}" if len(over) else MISSING,
                f"{inside}/{n}" if n else MISSING,
            )
        )
    headings = ("quantity", "answers", "median error", "half-width")
    headings += ("RMS / bound", "median / bound", "inside")
    scaled = (
        " An offset of the centre of mass is compared in crazyflow's inertia (0.76 to 0.78 of the "
        "offset in metres), because flights beside a reference tell it only over the inertia; its "
        "intervals are compared with the metres."
    )
    return [
        "True effects that were named in singles and pairs. Errors and half-widths of 95 % "
        "intervals are relative to the size of the effect, except those of onsets [s] and widths "
        "[m]. The bound is Cramér and Rao's for what the diagnosis looks at, half seconds whose "
        "starts are unknown, in the same flights without noise; a flight followed from end to end "
        "could tell more. *Inside* counts 95 % intervals that hold the truth, all of an effect at "
        "its first quantity." + (scaled if tables.run["reality"] == "rotorpy" else ""),
        markdown.table(headings, rows),
    ]


def reliability(tables: Tables) -> list[str]:
    """Stated probabilities and how often they were right."""
    rows = [
        (
            f"{row['from']:.1f} to {row['to']:.1f}",
            str(row["n"]),
            percent(row["stated"], 1),
            percent(row["value"], 1),
            _range(row["low"], row["high"]),
        )
        for row in records(tables.reliability)
    ]
    if not rows:
        return ["No effect was named with a probability."]
    brier = tables.summary[OURS].get("brier")
    headings = ("stated", "effects", "mean stated", "true", "95 % interval")
    return [
        markdown.table(headings, rows),
        ""
        if brier is None
        else f"Brier score (mean squared error of what was stated): {brier:.3f}.",
    ]


def measured_by(tables: Tables, study: str) -> list[str]:
    """What of a study is not that of the cases: its program, and effects that it lacks."""
    table = tables.studies[study]
    known = table["diagnosis"].iloc[0]
    lines = []
    if known not in [source[:12] for source in tables.run["sources"]]:
        lines.append(f"**Measured with another version of the program than the cases: {known}.**")
    columns = [name for name in ("effect", "truth", "rival") if name in table]
    lost = sorted(set(LIBRARY) - {name for column in columns for name in table[column]})
    if lost:
        lines.append(f"Not measured: {markdown.escape(', '.join(lost))}.")
    return lines


def _resampled(parameters: pd.DataFrame, row: dict[str, Any]) -> dict[str, float]:
    """Interval of a coverage, resampled, but never narrower than with intervals as units."""
    sums = np.asarray(parameters.groupby(_unit(parameters))[["inside", "intervals"]].sum(), float)
    drawn = np.random.default_rng(0).integers(len(sums), size=(RESAMPLED, len(sums)))
    inside, n = np.moveaxis(sums[drawn].sum(axis=1), -1, 0)
    low, high = np.quantile(inside / n, [0.025, 0.975])
    return {"low": min(row["low"], float(low)), "high": max(row["high"], float(high))}


def _unit(parameters: pd.DataFrame) -> str:
    """What is resampled: references, or cases where none, or the only one, is in the table."""
    known = parameters.dropna(axis="columns", how="all").columns
    return "reference" if "reference" in known else "case"


def _ratios(cases: pd.DataFrame) -> np.ndarray:
    """Shrink over the true effect's in decidable singles and pairs that were measured."""
    asked = _asked(cases)
    found, oracle = (cases.loc[asked, name].to_numpy(float) for name in ("shrink", "shrink_oracle"))
    wanted = oracle > 0.0
    return found[wanted] / oracle[wanted]


def _asked(cases: pd.DataFrame) -> pd.Series:
    """Decidable singles and pairs whose true effect was flown on flights left out."""
    named = cases["kind"].isin(["single", "pair"]) & cases["decidable"]
    return pd.Series(named & cases["shrink_oracle"].notna())


def _near(cases: pd.DataFrame) -> tuple[str, ...]:
    """How many answers shrink the drift nearly as far as the true effect."""
    ratios = _ratios(cases)
    near = proportion(int(np.sum(ratios >= SHRUNK)), len(ratios))
    least = np.nanmin(ratios, initial=math.inf)
    name = f"drift: the answer takes at least {percent(SHRUNK, 1)} of what the true effect takes"
    name += f" (worst case: {percent(float(least), 1)})" if near.n else ""
    if grows := int(_asked(cases).sum()) - len(ratios):
        name += f"; {count(grows, 'case')} left out, in which that is nothing"
    return (name, *_shown_share(near), MISSING, MISSING)


def _calibrated(tables: Tables) -> tuple[str, ...]:
    """Whether as many of the named effects are true as their probabilities say."""
    rows = records(tables.reliability)
    n = sum(row["n"] for row in rows)
    hits = round(sum(row["n"] * row["value"] for row in rows))
    stated = sum(row["n"] * row["stated"] for row in rows) / n if n else math.nan
    true = proportion(hits, n)
    late = "missed, on the safe side" if stated < true.low else "**missed**"
    word = MISSING if not n else "met" if true.low <= stated <= true.high else late
    aim = f"{percent(stated, 1)}, the mean of what was stated"
    return ("named effects that are true", *_shown_share(true), aim, word)


def _shown_share(share: Proportion) -> tuple[str, str, str]:
    """Hits, value and interval as three cells."""
    hits = f"{share.hits}/{share.n}"
    return (hits, percent(share.value, 1), _range(share.low, share.high))


def _counts(tables: Tables) -> dict[str, int]:
    """How many values each of `NUMBERS` is of."""
    relative = tables.parameters.loc[tables.parameters["relative"].astype(bool)]
    finite = {
        name: int(np.isfinite(relative[name].to_numpy(float)).sum())
        for name in ("error", "over_bound")
    }
    return {
        "median_parameter_error": finite["error"],
        "rms_over_cramer_rao": finite["over_bound"],
        "median_shrink_over_oracle": int(np.isfinite(_ratios(tables.cases)).sum()),
    }


def asked(score: str, who: str) -> bool:
    """Whether a score means anything for somebody."""
    if who == OURS:
        return True
    if score.startswith(("abstention", "nothing blamed")):
        return False
    return not (score == "exact set of pairs" and who in ONE_EFFECT)


def _range(low: float, high: float) -> str:
    return f"{percent(low, 1)} to {percent(high, 1)}"


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
        return _range(*COVERAGE)
    return f"≥ {percent(row['aim'], 1)}" if pd.notna(row["aim"]) else MISSING


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
    return f"{percent(row['value'], 1)} ({_range(row['low'], row['high'])})"


def _named(cell: dict[str, Any] | None) -> str:
    if cell is None:
        return MISSING
    return f"{cell['right']}/{cell['n']} ({cell['right_decidable']}/{cell['decidable']})"


def _shown(value: float | None, unit: str) -> str:
    if value is None:
        return MISSING
    return percent(value, 1) if unit == "%" else f"{value:.2f}"
