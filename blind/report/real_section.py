"""Answers about labelled real flights as tables that are kept, and the page on them."""

from pathlib import Path
from typing import Any

import pandas as pd

from bench.report.page import write_both
from bench.stats.statistics import records
from bench.text import markdown
from bench.text.numbers import MISSING
from blind.report.sections import several_programs
from blind.report.tables import save_tables
from blind.score.real import OUTCOMES, by_airframe

TITLE = "Diagnosis of labelled real flights"
METHOD = (
    "Each set was diagnosed in a process of its own that was given copies of its flights, and of "
    "those of its reference, under names that say nothing. *Right*: every effect of the label is "
    "blamed, or one that these flights cannot tell from it, and nothing else; *in part*: some of "
    "them and nothing else; *missed*: `none`, though something acts; *abstained*: something acts "
    "but nothing is blamed, too few flights, or logs refused with a reason. *True* is the share of "
    "the answers that are right, in part or whole. Intervals are 95 %, Clopper and Pearson's."
)
CHANGED = (
    "**The manifest was changed after the first diagnosis**, so that these labels may have been "
    "written with an answer in view."
)


def write_real(
    rows: pd.DataFrame, numbers: pd.DataFrame, run: dict[str, Any], directory: Path
) -> Path:
    """The Markdown file that was written; tables and HTML stand beside it."""
    save_tables(directory, {"sets": rows, "numbers": numbers}, run=run)
    text = "\n\n".join([f"# {TITLE}", *_section(rows, numbers, run)]) + "\n"
    path = directory / "real.md"
    write_both(path, text, TITLE)
    return path


def _section(rows: pd.DataFrame, numbers: pd.DataFrame, run: dict[str, Any]) -> list[str]:
    facts = (
        f"{len(rows)} sets of {run['manifest']}, begun {run['started']}. SHA-256 of sets and "
        f"labels: `{run['sha256']}`. A diagnosis took {rows['seconds'].median():.0f} s in the "
        f"median and {rows['seconds'].max():.0f} s at most. Program {run['sources'][0][:12]}."
    )
    lines = [METHOD, facts]
    if run["sha256"] != run["first_sha256"]:
        lines.append(CHANGED)
    lines += several_programs(run)
    lines += ["## By airframe", _airframes(rows), "## Set by set", _sets(rows)]
    if len(numbers):
        lines += ["## Numbers", _numbers(numbers)]
    if wrong := [row for row in records(rows) if row["outcome"] != "right"]:
        named = [f"{markdown.escape(row['set'])} ({row['outcome']})" for row in wrong]
        lines += [f"Not right: {', '.join(named)}."]
    return lines


def _airframes(rows: pd.DataFrame) -> str:
    lines = [
        (
            markdown.escape(row["airframe"]),
            str(row["sets"]),
            *(str(row[name]) for name in OUTCOMES),
            _share(row, "answered"),
            _share(row, "true"),
        )
        for row in records(by_airframe(rows))
    ]
    return markdown.table(("airframe", "sets", *OUTCOMES, "answered", "true"), lines, (0,))


def _share(row: dict[str, Any], name: str) -> str:
    value, low, high = (100.0 * row[key] for key in (name, f"{name}_low", f"{name}_high"))
    return MISSING if pd.isna(value) else f"{value:.0f} % ({low:.0f} to {high:.0f})"


def _sets(rows: pd.DataFrame) -> str:
    lines = [
        (
            markdown.escape(row["set"]),
            markdown.escape(row["label"]),
            markdown.escape(row["reference"]) or MISSING,
            row["verdict"],
            markdown.escape(row["answer"] or row["cause"]) or MISSING,
            f"{row['probability']:.2f}" if pd.notna(row["probability"]) else MISSING,
            f"{row['drift_falls']:.0f} %" if pd.notna(row["drift_falls"]) else MISSING,
            f"**{row['outcome']}**",
        )
        for row in records(rows)
    ]
    headings = ("set", "label", "beside", "verdict", "blamed, or why there is no answer",
                "probability", "drift falls by", "outcome")  # fmt: skip
    return markdown.table(headings, lines, (0, 1, 2, 3, 4, 7))


def _numbers(numbers: pd.DataFrame) -> str:
    lines = [
        (
            markdown.escape(row["set"]),
            f"{markdown.escape(row['effect'])}.{markdown.escape(row['parameter'])}",
            f"{row['true']:.4g}",
            f"{row['value']:.4g}",
            f"{row['low']:.4g} to {row['high']:.4g}" if pd.notna(row["low"]) else MISSING,
            row["use"],
            "yes" if row["inside"] else "no",
        )
        for row in records(numbers)
    ]
    headings = ("set", "parameter [SI]", "true", "answer", "95 % interval", "use", "inside")
    return markdown.table(headings, lines, (0, 1))
