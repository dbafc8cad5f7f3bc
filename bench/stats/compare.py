"""Whether one entry is better than another: an answer, and an exit status that says it.

A side is an entry of a folder of tables, or a whole folder. Both must have two seeds or more in the
same strata: cells, for whole folders the cells of each entry. One stratum is decided by the
t-interval of the difference of mean settled rewards; several by the mean difference of scores, each
cell weighing alike (`bench/stats/verdicts.py`). Diverged runs count with the policy that they left.
"No difference" means that none can be shown, not that there is none.
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rich.console import Console
from rich.text import Text

from bench.stats.pooled import improvement
from bench.stats.scores import PRIMARY, UPPER, flown_settings, scored
from bench.stats.statistics import (
    FEWEST_SEEDS,
    Cell,
    Entry,
    difference,
    endings,
    estimate,
    lost,
    matched,
    seed_values,
)
from bench.stats.verdicts import Verdict, above, over_cells
from bench.store.tables import Tables
from bench.text.errors import UsageError
from bench.text.numbers import mean_std, measured, number, places, seconds, significant, span
from simulators.registry import did_you_mean

SECONDARY = {
    "crashes": ("crashes per episode", significant),
    "fleet_minutes": ("HF fleet-minutes", significant),
    "training_crashes": ("HF training crashes", significant),
    "train_seconds": ("training time", seconds),
}
"""Metrics shown beside the answer, lower is better: heading and how a number is written."""

Stratum = tuple[Cell, Entry | None]
"""A cell; with the entry where whole folders are compared."""


STATUSES = {
    Verdict.SUPPORTED: 0,
    Verdict.REFUTED: 3,
    Verdict.UNDECIDED: 4,
    Verdict.UNTESTED: 5,
}
"""Exit status of each verdict on "the first side is better"; untested: they cannot be compared."""


@dataclasses.dataclass(frozen=True)
class Side:
    """What is compared: an entry of a folder, or all of a folder."""

    label: str
    tables: Tables
    entry: Entry | None
    """None: all entries but the upper reference."""

    def values(self, name: str) -> dict[Stratum, dict[int, float]]:
        """Values by seed of a metric, or of the `score`, by stratum."""
        rows = scored(self.tables) if name == "score" else self.tables.results
        return {
            (cell, None if self.entry else entry): seeds
            for cell, own in seed_values(rows, name).items()
            for entry, seeds in own.items()
            if entry == self.entry or (self.entry is None and entry.method != UPPER)
        }

    def lost(self) -> int:
        """Runs that failed or diverged."""
        found = endings(self.tables).values()
        return sum(lost(e) for own in found for k, e in own.items() if self.entry in (None, k))


@dataclasses.dataclass(frozen=True)
class Comparison:
    """The answer, and what it rests on."""

    verdict: Verdict
    """On "the first side is better"."""
    lines: list[str]
    """What was found, for people."""


def load_side(text: str, default: Path | None) -> Side:
    """The side that `text` names: FOLDER, FOLDER:METHOD or METHOD, the last in `default`.

    A method is written as leaderboards show it ("hybrid (mlp)") or as `hybrid-mlp`.

    Raises:
        UsageError: There is no such folder or entry.
    """
    folder, _, name = text.rpartition(":")
    if Path(text).is_dir():
        folder, name = text, ""
    elif folder and not Path(folder).is_dir():  # a colon that belongs to the name
        folder, name = "", text
    place = Path(folder) if folder else default
    if place is None and (there := text.rpartition(":")[0]):
        raise UsageError(f"{there} is no folder.")
    if place is None:
        raise UsageError(f"'{text}' is no folder. Name one: FOLDER:METHOD, or give --results.")
    tables = Tables.load(place)
    if not name:
        return Side(text, tables, None)
    own = {entry for cell in endings(tables).values() for entry in cell}
    names = {spelling: entry for entry in own for spelling in (entry.label, _short(entry))}
    if name not in names:
        known = sorted(_short(e) for e in own)
        near = did_you_mean(name, known)
        raise UsageError(
            f"{place} has no rows of '{name}'.{near} It has rows of {', '.join(known)}."
        )
    return Side(text, tables, names[name])


def compare(a: Side, b: Side) -> Comparison:
    """Whether `a` is better than `b`."""
    first, second = a.values(PRIMARY), b.values(PRIMARY)
    common = [s for s in first if s in second]
    shared = [s for s in common if min(len(first[s]), len(second[s])) >= FEWEST_SEEDS]
    if (a.entry is None) != (b.entry is None):
        return _not_comparable("one is a whole folder, the other an entry")
    if not shared:
        few = f"they share {len(common)} cells, none with {FEWEST_SEEDS} seeds or more of each"
        return _not_comparable(few if common else "they have no cell in common")
    if changed := [text for s in shared if (text := _other_task(a, b, s[0]))]:
        return _not_comparable(changed[0])
    left = {f"not both have {FEWEST_SEEDS} seeds": sorted({*first, *second} - {*shared}, key=repr)}
    if len(shared) == 1:
        verdict, found = _one(first[shared[0]], second[shared[0]])
    elif UPPER in (side.entry.method for side in (a, b) if side.entry):
        return _not_comparable(
            f"{UPPER} defines what a score of 1 is in each cell, so it has no score to "
            f"compare over {len(shared)} cells. One cell alone is compared by its returns"
        )
    else:
        shared, bare = _with_scores(a, b, shared)
        why = "without an upper reference there is no score"
        if not shared:
            return _not_comparable(f"{why}: {_cells(bare)}")
        left[why] = bare
        verdict, found = _several(a, b, shared)
    lines = [
        f"Left out, because {reason}: {_cells(cells)}." for reason, cells in left.items() if cells
    ]
    if a.lost() or b.lost():
        lines.append(f"Failed or diverged: {a.lost()} of {a.label}, {b.lost()} of {b.label}.")
    where = f"{_cells(shared)}, {_seeds(a, first, shared)}, {_seeds(b, second, shared)}"
    return Comparison(verdict, [*found, f"Compared in {where}.", *lines, *_secondary(a, b, shared)])


def report(a: Side, b: Side, console: Console) -> int:
    """Prints the comparison; its exit status."""
    found = compare(a, b)
    words = {
        Verdict.SUPPORTED: f"{a.label} is better than {b.label}.",
        Verdict.REFUTED: f"{a.label} is worse than {b.label}.",
        Verdict.UNDECIDED: f"No difference between {a.label} and {b.label} can be shown.",
        Verdict.UNTESTED: f"{a.label} and {b.label} cannot be compared.",
    }
    console.print(Text(words[found.verdict], "bold"), soft_wrap=True)
    for line in found.lines:
        console.print(Text(line), soft_wrap=True)
    return STATUSES[found.verdict]


def _one(a: Mapping[int, float], b: Mapping[int, float]) -> tuple[Verdict, list[str]]:
    """The answer in one stratum."""
    first, second = (estimate(x.values()) for x in matched(a, b))
    apart = difference(a, b)
    means = [
        f"{mean_std(x.mean, x.std, places(0.5 * (x.high - x.low)))} (n = {x.n})"
        for x in (first, second)
    ]
    text = (
        f"Settled reward {means[0]} against {means[1]}: difference "
        f"{measured(apart.mean, apart.low, apart.high)}, 95 % t-interval."
    )
    return above(apart, apart.p), [text]


def _with_scores(a: Side, b: Side, shared: list[Stratum]) -> tuple[list[Stratum], list[Stratum]]:
    """The strata that scores over several can be compared in, and the others."""
    own, other = a.values("score"), b.values("score")
    bare = [s for s in shared if min(len(own.get(s, {})), len(other.get(s, {}))) < FEWEST_SEEDS]
    return [s for s in shared if s not in bare], bare


def _several(a: Side, b: Side, shared: list[Stratum]) -> tuple[Verdict, list[str]]:
    """The answer over several strata, from scores, which all of them have."""
    scores = [side.values("score") for side in (a, b)]
    found = over_cells((scores[0][s], scores[1][s]) for s in shared)
    better = improvement(*({s: own[s] for s in shared} for own in scores))
    lines = [
        f"Score higher by {measured(found.mean, found.low, found.high)}, mean over cells with its "
        f"95 % interval ({found.n} seeds).",
        f"Probability that a run of the first is better: {number(better.value, 2)}, 95 % "
        f"percentile-bootstrap interval {span(better.low, better.high, 2)}.",
    ]
    return above(found, found.p), lines


def _secondary(a: Side, b: Side, shared: list[Stratum]) -> list[str]:
    """A line for each other axis: in how many strata the first is lower or higher."""
    lines = []
    for metric, (heading, text) in SECONDARY.items():
        first, second = a.values(metric), b.values(metric)
        own = [s for s in shared if s in first and s in second]
        if not own:
            continue
        apart = [difference(first[s], second[s]) for s in own]
        lower = sum(d.excludes_zero and d.mean < 0.0 for d in apart)
        higher = sum(d.excludes_zero and d.mean > 0.0 for d in apart)
        means = [
            text(estimate([estimate(v[s].values()).mean for s in own]).mean)
            for v in (first, second)
        ]
        lines.append(
            f"{heading[0].upper()}{heading[1:]}: {means[0]} against {means[1]} (means over cells); "
            f"lower in {lower}, higher in {higher} of {len(own)} by the 95 % t-interval."
        )
    return lines


def _other_task(a: Side, b: Side, cell: Cell) -> str:
    """What says that a cell is not the same for both; empty if nothing does."""
    first, second = (flown_settings(side.tables, cell, side.entry) for side in (a, b))
    for name in sorted({*first, *second}):
        if (mine := first.get(name)) != (theirs := second.get(name)):
            return f"on {cell.label}, {name} is {_listed(mine)} against {_listed(theirs)}"
    return ""


def _not_comparable(reason: str) -> Comparison:
    return Comparison(Verdict.UNTESTED, [f"Reason: {reason}."])


def _cells(strata: list[Stratum]) -> str:
    names = [f"{cell.label} ({entry.label})" if entry else cell.label for cell, entry in strata]
    return names[0] if len(names) == 1 else f"{len(names)} cells: {'; '.join(names)}"


def _seeds(side: Side, values: Mapping[Stratum, Mapping[int, float]], shared: list[Stratum]) -> str:
    """How many seeds a side has in each stratum, as text."""
    n = sorted({len(values[s]) for s in shared})
    return f"{' to '.join(map(str, (n[0], n[-1])[: len(n)]))} seeds of {side.label}"


def _short(entry: Entry) -> str:
    """An entry as one can type it, e.g. `hybrid-mlp`."""
    name = f"{entry.method}-{entry.residual}" if entry.residual else entry.method
    return entry._replace(method=name, residual="").label


def _listed(values: Any) -> str:
    return "missing" if values is None else " or ".join(sorted(map(str, values)))
