"""Scores of diagnoses against withheld labels, each proportion with a Clopper-Pearson interval.

An answer is right on a decidable case only if it names the truth: the first effect (top-1) or the
set. On an undecidable one, `none` is right as well, and so is every answer whose effects each have
an alias class with a true effect in it. A case without an answer is wrong everywhere.

Source of the interval: Clopper and Pearson (1934), Biometrika 26, 404-413.
"""

import dataclasses
import math
from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
import pandas as pd
from scipy import stats

from blind.draw.cases import Case
from blind.draw.catalogue import Withheld
from blind.score.identifiable import Bounds, Comparison, compare, distance, over_bound, seen
from diagnosis.statements import judged_of

FLAGGED = 0.1
"""Unexplained share from which an answer that names an effect also says that more is there [-]."""

BINS = 5
"""Bins of stated probabilities."""

Answer = Mapping[str, Any]
"""An answer in the form of `answers.scored_form`; `verdict` and `effects`, those that it blames,
are required."""

Measured = Mapping[str, Any]
"""What `measures.measure` says of a case; without it, no shrink is compared."""

Row = dict[str, Any]
"""One row of a table."""


@dataclasses.dataclass(frozen=True)
class Scores:
    """Tables of one set of answers."""

    cases: pd.DataFrame
    """One row a case: what it was, what was answered, what of it was right."""
    proportions: pd.DataFrame
    """One row a score and subset of cases: hits, cases, value and 95 % interval."""
    by_effect: pd.DataFrame
    """Top-1 of singles by effect and size, decidable cases counted apart."""
    parameters: pd.DataFrame
    """One row a compared quantity of a right answer."""
    reliability: pd.DataFrame
    """Stated probabilities of named effects, in bins, against how often they were true."""
    summary: dict[str, float | None]
    """Numbers that are no proportions; None where nothing could be compared."""


@dataclasses.dataclass(frozen=True)
class Proportion:
    """So many of so many cases, with the exact 95 % interval."""

    hits: int
    """Cases that count."""
    n: int
    """All cases."""
    value: float
    """Their ratio; NaN without cases, as the interval."""
    low: float
    """Lower end of the interval."""
    high: float
    """Upper end of the interval."""

    def text(self, digits: int = 0) -> str:
        """As `3/4 (19 to 99 %)`."""
        return f"{self.hits}/{self.n} ({self.interval(digits)})"

    def interval(self, digits: int = 0) -> str:
        """As `19 to 99 %`."""
        return f"{100 * self.low:.{digits}f} to {100 * self.high:.{digits}f} %"


def proportion(hits: int, n: int) -> Proportion:
    """`hits` of `n` cases with their interval."""
    if n == 0:
        return Proportion(hits, n, math.nan, math.nan, math.nan)
    interval = stats.binomtest(hits, n).proportion_ci(0.95, method="exact")
    return Proportion(hits, n, hits / n, float(interval.low), float(interval.high))


def score(
    cases: Mapping[str, Case],
    answers: Mapping[str, Answer],
    measured: Mapping[str, Measured] | None = None,
) -> Scores:
    """All tables. A case that was not measured counts as decidable.

    Raises:
        ValueError: An answer or a measure belongs to no case.
    """
    for what, given in {"answers": answers, "measured": measured or {}}.items():
        if strange := sorted(set(given) - set(cases)):
            raise ValueError(f"`{what}` names a case that has no label: {strange[0]}.")
    own = {name: (measured or {}).get(name, {}) for name in cases}
    judged = [_judge(case, answers.get(name), own[name]) for name, case in cases.items()]
    parameters = [
        row
        for name, case in cases.items()
        for row in _compared(case, answers.get(name), own[name].get("bound", {}))
    ]
    stated = [row for name, case in cases.items() for row in _stated(case, answers.get(name))]
    singles = [row for row in judged if row["kind"] == "single"]
    columns = ["case", "reference", "effect", "size", "quantity", "error", "relative"]
    columns += ["over_bound", "inside", "intervals", "half_width"]
    return Scores(
        cases=pd.DataFrame(judged),
        proportions=_proportions(judged, parameters),
        by_effect=_by_effect(singles),
        parameters=pd.DataFrame(parameters, columns=columns),
        reliability=_reliability(stated),
        summary=_summary(judged, parameters, stated),
    )


def _judge(case: Case, answer: Answer | None, measured: Measured) -> Row:
    truth = {effect.name for effect in case.effects}
    decidable = bool(measured.get("decidable", True))
    said = "failed" if answer is None else str(answer["verdict"])
    verdict = judged_of(said)
    every = list(answer["effects"]) if answer is not None else []
    chosen = every if verdict == "effect" else []
    chosen.sort(key=lambda effect: -(effect.get("probability") or 0.0))
    names = [effect["name"] for effect in chosen]
    classes = [{effect["name"], *effect.get("aliases", ())} for effect in chosen]
    forgiven = not decidable and (
        verdict == "none" or (bool(classes) and all(group & truth for group in classes))
    )
    share = (answer or {}).get("unexplained_share") or 0.0
    abstained = verdict == "unexplained" or (verdict == "effect" and share >= FLAGGED)
    return {
        "case": case.id,
        "kind": case.kind,
        "truth": " + ".join(sorted(truth)) or "none",
        "size": case.size,
        "decidable": decidable,
        "verdict": said,
        "answer": " + ".join(sorted(effect["name"] for effect in every)) or said,
        "top1": (bool(names[:1]) and names[0] in truth) or forgiven,
        "class1": (bool(classes) and bool(classes[0] & truth)) or forgiven,
        "exact": (bool(truth) and set(names) == truth) or forgiven,
        "quiet": verdict == "none",
        "silent": (verdict == "unexplained" and not every) or (not decidable and verdict == "none"),
        "abstained": abstained or (not decidable and verdict == "none"),
        "blamed": verdict == "effect" and not abstained,
        **_shrink(answer or {}, measured),
    }


def _shrink(answer: Answer, measured: Measured) -> dict[str, float | None]:
    """Shrink of the answer, of the true set and of the best without a true effect [%]."""
    return {
        "shrink": (answer.get("shrink") or {}).get("percent"),
        "shrink_oracle": measured.get("shrink_oracle"),
        "shrink_wrong": measured.get("shrink_wrong"),
    }


def _compared(case: Case, answer: Answer | None, bounds: Bounds) -> list[Row]:
    """Quantities of an answer that names exactly the true effects or partners of theirs."""
    rows: list[Row] = []
    if answer is None or answer["verdict"] != "effect" or case.kind not in ("single", "pair"):
        return rows
    for flown in case.effects:
        truth = seen(flown, case.reality)
        for effect in answer["effects"]:
            given = effect["parameters"]
            values = {name: entry["value"] for name, entry in given.items()}
            # What is stated is compared with what was flown, in whatever unit it can be told.
            inside = [
                given[p]["low"] <= true <= given[p]["high"]
                for p, true in flown.parameters.items()
                if effect["name"] == truth.name and p in given and given[p]["low"] is not None
            ]
            for i, found in enumerate(compare(truth, effect["name"], values)):
                row = {"case": case.id, "reference": case.reference, "effect": truth.name}
                row |= {"size": case.size, **dataclasses.asdict(found)}
                row["over_bound"] = over_bound(truth, found, bounds)
                row["half_width"] = _half_width(truth, found, given)
                counted = inside if i == 0 else []
                rows.append({**row, "inside": sum(counted), "intervals": len(counted)})
    return rows


def _half_width(truth: Withheld, found: Comparison, given: Mapping[str, Any]) -> float | None:
    """Half of an interval, in the unit of the error; None for combinations of effects."""
    names = [name for name in found.quantity.removeprefix(truth.name).split() if name in given]
    known = [given[name] for name in names if given[name]["low"] is not None]
    if not known or not found.quantity.startswith(truth.name):
        return None
    half = math.hypot(*((entry["high"] - entry["low"]) / 2.0 for entry in known))
    return half / distance(truth, names) if found.relative else half


def _stated(case: Case, answer: Answer | None) -> list[tuple[float, bool]]:
    """Probabilities of the blamed effects, and whether they were there."""
    if answer is None:
        return []
    # An excluded effect is not in the library: whatever is named instead is wrong.
    truth = {e.name for e in case.effects} if case.kind in ("single", "pair") else set()
    return [
        (effect["probability"], effect["name"] in truth)
        for effect in answer["effects"]
        if effect.get("probability") is not None
    ]


_WITHHELD = ("unknown", "excluded")
_SCORES: tuple[tuple[str, str, tuple[str, ...], float | None], ...] = (
    ("top-1 of singles", "top1", ("single",), 0.98),
    ("top-1 of singles, alias class", "class1", ("single",), None),
    ("exact set of singles", "exact", ("single",), None),
    ("top-1 of pairs", "top1", ("pair",), None),
    ("exact set of pairs", "exact", ("pair",), 0.92),
    ("nothing found in clean flights", "quiet", ("clean",), 0.98),
    ("abstention, unknown effect", "abstained", ("unknown",), 0.95),
    ("abstention, excluded effect", "abstained", ("excluded",), 0.95),
    ("abstention, both", "abstained", _WITHHELD, 0.95),
    ("nothing blamed at all, both", "silent", _WITHHELD, None),
)
"""Name, column, kinds of case and aim of each score."""


def _proportions(judged: list[Row], parameters: list[Row]) -> pd.DataFrame:
    rows = []
    for name, column, kinds, aim in _SCORES:
        among = [row for row in judged if row["kind"] in kinds]
        subsets = {
            "decidable": [row for row in among if row["decidable"]],
            "undecidable": [row for row in among if not row["decidable"]],
            "all": among,
        }
        for subset, part in subsets.items():
            rows.append(_row(name, subset, _count(part, column), len(part), aim))
    effects = [row for row in judged if row["kind"] != "clean"]
    rows.append(_row("decidable cases", "all", _count(effects, "decidable"), len(effects), None))
    inside, n = _count(parameters, "inside"), _count(parameters, "intervals")
    rows.append(_row("truth inside 95 % intervals", "all", inside, n, 0.95))
    return pd.DataFrame(rows)


def _count(rows: list[Row], column: str) -> int:
    return sum(int(row[column]) for row in rows)


def _row(name: str, subset: str, hits: int, n: int, aim: float | None) -> Row:
    return {"score": name, "cases": subset, **vars(proportion(hits, n)), "aim": aim}


def _by_effect(singles: list[Row]) -> pd.DataFrame:
    rows = []
    for truth, size in sorted({(row["truth"], row["size"]) for row in singles}):
        part = [row for row in singles if (row["truth"], row["size"]) == (truth, size)]
        sure = [row for row in part if row["decidable"]]
        right = {"right": _count(part, "top1"), "right_decidable": _count(sure, "top1")}
        counts = {"n": len(part), "decidable": len(sure)}
        rows.append({"effect": truth, "size": size, **counts, **right})
    columns = ["effect", "size", "n", "right", "decidable", "right_decidable"]
    return pd.DataFrame(rows, columns=columns)


def _reliability(stated: list[tuple[float, bool]]) -> pd.DataFrame:
    """Bins of equal width, those without an answer left out; probabilities count to six digits."""
    rows = []
    for i in range(BINS):
        low, high = i / BINS, (i + 1) / BINS
        here = [(p, t) for p, t in stated if min(int(round(p, 6) * BINS), BINS - 1) == i]
        if here:
            row = _row("", "", sum(true for _, true in here), len(here), None)
            mean = float(np.mean([p for p, _ in here]))
            bounds = {"from": low, "to": high, "stated": mean}
            rows.append(bounds | {key: row[key] for key in ("n", "value", "low", "high")})
    return pd.DataFrame(rows, columns=["from", "to", "stated", "n", "value", "low", "high"])


def _summary(
    judged: list[Row], parameters: list[Row], stated: list[tuple[float, bool]]
) -> dict[str, float | None]:
    errors = np.asarray([row["error"] for row in parameters if row["relative"]], float)
    over = np.asarray([row["over_bound"] for row in parameters if row["relative"]], float)
    named = [row for row in judged if row["kind"] in ("single", "pair") and row["decidable"]]
    found, oracle, wrong = (
        np.asarray([row[column] for row in named], float)
        for column in ("shrink", "shrink_oracle", "shrink_wrong")
    )
    beside = np.isfinite(found) & np.isfinite(wrong)
    probability, true = np.asarray(stated, float).reshape(-1, 2).T
    return {
        "median_parameter_error": _of(np.median, errors),
        "rms_over_cramer_rao": _of(lambda x: np.sqrt(np.mean(x**2)), over),
        "median_shrink_over_oracle": _of(np.median, (found / oracle)[oracle > 0]),
        "median_shrink": _of(np.median, found[beside]),
        "median_shrink_of_best_wrong": _of(np.median, wrong[beside]),
        "brier": _of(np.mean, (probability - true) ** 2),
    }


def _of(statistic: Callable[[np.ndarray], Any], values: np.ndarray) -> float | None:
    """A statistic of the finite values; None without any."""
    finite = values[np.isfinite(values)]
    return float(statistic(finite)) if len(finite) else None
