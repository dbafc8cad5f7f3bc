"""Cases that were answered wrongly, each with truth, answer, evidence and a remark by hand."""

import json
from collections.abc import Mapping
from typing import Any

import pandas as pd

from bench.text import markdown
from blind.report.tables import Tables

RIGHT = {"single": "exact", "pair": "exact", "clean": "quiet"}
"""Column that says whether a case of a kind is right; for the others it is `abstained`."""


def failures(tables: Tables, remarks: Mapping[str, str]) -> list[str]:
    """A paragraph a failure; decidable cases first."""
    wrong = [row for row in tables.cases.to_dict("records") if failed(row)]
    wrong.sort(key=lambda row: (not row["decidable"], row["kind"], row["truth"], row["case"]))
    if not wrong:
        return ["None."]
    sure = sum(bool(row["decidable"]) for row in wrong)
    were = "was" if len(wrong) == 1 else "were"
    n = len(tables.cases)
    intro = f"{len(wrong)} of {n} cases {were} not answered exactly; decidable: {sure}."
    parts = [intro]
    for row in wrong:
        parts += [f"#### {row['case']}", "\n".join(_lines(row))]
        if row["case"] in remarks:
            parts.append(f"Remark: {remarks[row['case']]}")
    return parts


def failed(row: Mapping[str, Any]) -> bool:
    """Whether a case was answered wrongly, or not at all."""
    return row["status"] != "ok" or not row[RIGHT.get(row["kind"], "abstained")]


def _lines(row: Mapping[str, Any]) -> list[str]:
    kind = row["kind"] + ("" if row["decidable"] else ", undecidable")
    size = f", {row['size']}" if row["size"] else ""
    lines = [
        f"- Truth: {_named(row['truth'], json.loads(row['truth_parameters']))} ({kind}{size}"
        f"{', two drones' if row['drones'] > 1 else ''})"
    ]
    if row["status"] != "ok":
        return [*lines, f"- No answer: {markdown.escape(row['cause'])}"]
    given = {
        name: {p: entry["value"] for p, entry in parameters.items()}
        for name, parameters in json.loads(row["answer_parameters"]).items()
    }
    left = row["unexplained_share"]
    share = f"; {100.0 * left:.0f} % of the gap unexplained" if pd.notna(left) else ""
    lines.append(f"- Answer: {_named(row['answer'], given)}{share}")
    lines.append(f"- Evidence: {_candidates(row)}{_structure(row)}")
    if pd.notna(row["margin"]):
        rival = row["rival"] or "nominal"
        lines.append(
            f"- Without noise, {markdown.escape(rival)} is {row['margin']:.3g} in chi-square from "
            f"the truth, nominal {row['gap']:.3g}; the truth itself leaves {row['left']:.3g}"
        )
    if pd.notna(row["shrink"]):
        oracle = row["shrink_oracle"]
        beside = f", {oracle:.1f} % under the true effect" if pd.notna(oracle) else ""
        lines.append(f"- Shrink: {row['shrink']:.1f} %{beside}")
    return lines


def _named(names: str, parameters: Mapping[str, Mapping[str, float]]) -> str:
    """Effects with their parameters, or a verdict."""
    if not parameters:
        return markdown.escape(names)
    parts = [
        f"{name} ({', '.join(f'{p} {value:.3g}' for p, value in values.items())})"
        for name, values in parameters.items()
    ]
    return markdown.escape(" + ".join(parts))


def _candidates(row: Mapping[str, Any]) -> str:
    found = [
        f"{' + '.join(c['effects']) or 'nominal'} {c['probability'] or 0.0:.2f} "
        f"({c['evidence'] or 0.0:.0f} nats)"
        for c in json.loads(row["candidates"])
    ]
    return markdown.escape(", ".join(found)) or "no candidates"


def _structure(row: Mapping[str, Any]) -> str:
    return f"; structure left {row['structure']:.2f}" if pd.notna(row["structure"]) else ""
