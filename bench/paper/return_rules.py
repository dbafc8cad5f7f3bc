"""Rules on returns: one method above another, and how far behind."""

import dataclasses
import math
from collections import Counter
from collections.abc import Mapping

from bench.paper.rule import (
    UNTESTED,
    AbstractRule,
    Finding,
    counts_text,
    lost_share,
    range_text,
    relative,
    summary,
)
from bench.paper.values import HYBRID, NAMES, Source
from bench.stats.scores import at_home, scored, undisturbed
from bench.stats.statistics import Cell, Entry, Values, difference, estimate, matched, seed_values
from bench.stats.verdicts import Verdict, above, below, by_cell, every, holm, over_cells
from bench.store.tables import Tables
from bench.text import markdown
from bench.text.numbers import number, places, span


@dataclasses.dataclass(frozen=True)
class Above(AbstractRule):
    """The first deploys above the second, in every cell or in so many of them."""

    first: Entry
    second: Entry
    share: float = 0.0
    """Share of the second's loss that the first may lose beyond it."""
    but: frozenset[tuple[str, int]] = frozenset()
    """Cells in which the paper claims nothing."""
    at_least: float = 1.0
    """Share of the cells that must support it."""
    source: Source = undisturbed
    metric: str = ""
    """The metric, where the claim is not about returns as deployed."""
    task: str = ""
    """The only task that is meant; empty: all."""

    @property
    def text(self) -> str:
        names = NAMES[self.first], NAMES[self.second]
        what = f"{names[0]} is above {names[1]}"
        if self.share:
            what = f"{names[0]} loses at most {100 * self.share:.0f} % more than {names[1]}"
        where = (
            "every cell" if self.at_least == 1.0 else f"{100 * self.at_least:.0f} % of the cells"
        )
        if self.task:
            where += f" of {self.task}"
        if self.but:
            left_out = " and ".join(f"{task} at N = {n}" for task, n in sorted(self.but))
            where += f" but {left_out}"
        return f"{what} in {where}, by the paired difference over seeds, Holm-corrected over cells"

    @property
    def one_refutes(self) -> bool:
        return self.at_least == 1.0

    def judge(self, tables: Tables, metric: str) -> Finding:
        metric = self.metric or metric
        values = self.source(tables, metric)
        pairs = self._claimed(values)
        if not pairs:
            return UNTESTED
        tests = [difference(a, worse_by(self.share, b)) for _, a, b in pairs]
        verdicts = by_cell(tests)
        verdict = _enough(verdicts, self.at_least) if self.at_least < 1.0 else every(verdicts)
        names = NAMES[self.first], NAMES[self.second]
        apart = f"above {100 * self.share:.0f} % more loss" if self.share else "difference"
        headings = ("cell", *names, apart, "95 % interval", "p (Holm)", "verdict")
        p_values = holm([test.p for test in tests])
        lines = tuple(
            (
                markdown.escape(cell.label),
                summary(a.values()),
                summary(b.values()),
                number(test.mean, places(0.5 * (test.high - test.low))),
                span(test.low, test.high, places(0.5 * (test.high - test.low))),
                "< 0.001" if p < 0.001 else number(p, 3),
                verdict.value,
            )
            for (cell, a, b), test, p, verdict in zip(pairs, tests, p_values, verdicts, strict=True)
        )
        mean, pooled = self._pooled(tables, metric)
        return Finding(
            counts_text(verdicts) + self._alone(values) + mean, verdict, headings, lines, pooled
        )

    def _claimed(
        self, values: Values
    ) -> list[tuple[Cell, Mapping[int, float], Mapping[int, float]]]:
        """What both have in the cells that the claim is about."""
        pairs = pairs_of(values, self.first, self.second, self.task)
        return [pair for pair in pairs if (pair[0].task, pair[0].team_size) not in self.but]

    def _alone(self, values: Values) -> str:
        """In how many cells one of both left no policy, so that nothing is compared."""
        own = [own for cell, own in values.items() if self.task in ("", cell.task)]
        alone = sum((self.first in entries) != (self.second in entries) for entries in own)
        return f"; {alone} more where only one of the two was run" if alone else ""

    def _pooled(self, tables: Tables, metric: str) -> tuple[str, Verdict]:
        """The test over the claimed cells that have scores, where there are some.

        A mean that most cells contradict decides nothing: a few cells made it.
        """
        if self.share or metric != "settled_reward" or self.source is not undisturbed:
            return "", Verdict.UNTESTED
        plain = at_home(seed_values(scored(tables), "score"), tables)
        pairs = self._claimed(plain)
        test = over_cells((a, b) for _, a, b in pairs)
        if math.isnan(test.low):
            return "", Verdict.UNTESTED
        low, high = (test.low, test.high) if test.mean >= 0.0 else (-test.high, -test.low)
        apart = {
            cell: difference(a, b).mean * math.copysign(1.0, test.mean) for cell, a, b in pairs
        }
        against = sum(x < 0.0 for x in apart.values())
        few, worse = "", self.second if test.mean >= 0.0 else self.first
        if 2 * against > len(pairs):
            most = max(apart, key=lambda cell: apart[cell])
            few = (
                f". In {against} of these {NAMES[worse]} is better; the mean follows {most.label}, "
                "where the two differ most"
            )
        text = (
            f"; {NAMES[self.first]}'s score is {number(abs(test.mean), 4)} "
            f"({span(low, high, 4)}) {'higher' if test.mean >= 0.0 else 'lower'} over "
            f"{len(pairs)} {'cell' if len(pairs) == 1 else 'cells'}{few}"
        )
        return text, Verdict.UNDECIDED if few else above(test, test.p)


@dataclasses.dataclass(frozen=True)
class GapNarrows(AbstractRule):
    """The relative gap of one to another is smaller for the largest team than for the smallest."""

    behind: Entry
    ahead: Entry

    one_refutes = False

    @property
    def text(self) -> str:
        return (
            f"the gap, ({NAMES[self.ahead]} - {NAMES[self.behind]}) / |{NAMES[self.ahead]}|, mean "
            "over all tasks, is smaller for the largest team that flew all of them than for the "
            "smallest (paired over seeds)"
        )

    def judge(self, tables: Tables, metric: str) -> Finding:
        gaps = gaps_by_size(undisturbed(tables, metric), self.behind, self.ahead)
        if len(gaps) < 2:
            return UNTESTED
        means = {n: estimate(gap.values()) for n, gap in gaps.items()}
        first, last = min(gaps), max(gaps)
        apart = difference(gaps[first], gaps[last])
        verdict = every(by_cell([apart]))
        lines = tuple(
            (f"N = {n}", _percent(m.mean, m.n), _percent_span(m.low, m.high))
            for n, m in means.items()
        )
        text = ", ".join(f"{number(100 * m.mean, 1)} % at N = {n}" for n, m in means.items())
        return Finding(text, verdict, ("team size", "gap [%]", "95 % t-interval"), lines)


@dataclasses.dataclass(frozen=True)
class GapAtMost(AbstractRule):
    """The relative gap is at most so large, from a team size on."""

    behind: Entry
    ahead: Entry
    bound: float
    """As a share of what the one ahead loses."""
    from_size: int = 0
    """The smallest team that the claim is about."""

    @property
    def text(self) -> str:
        since = f" at every team size from {self.from_size}" if self.from_size else ""
        return (
            f"the gap of {NAMES[self.behind]} to {NAMES[self.ahead]}, mean over tasks, is at most "
            f"{100 * self.bound:g} %{since}, by its t-interval over seeds"
        )

    def judge(self, tables: Tables, metric: str) -> Finding:
        gaps = gaps_by_size(undisturbed(tables, metric), self.behind, self.ahead)
        means = {n: estimate(g.values()) for n, g in gaps.items() if n >= self.from_size}
        if not means:
            return UNTESTED
        verdict = every(below(self.bound, m.low, m.high) for m in means.values())
        text = ", ".join(
            f"{number(100 * m.mean, 1)} % ({_percent_span(m.low, m.high)}) at N = {n}"
            for n, m in means.items()
        )
        lines = []
        for cell, mine, theirs in pairs_of(undisturbed(tables, metric), self.behind, self.ahead):
            if cell.team_size in means:
                both = [s for s in mine if s in theirs]
                gap = estimate(relative(theirs[s] - mine[s], theirs[s]) for s in both)
                share = (_percent(gap.mean, gap.n), _percent_span(gap.low, gap.high))
                lines.append((markdown.escape(cell.label), *share))
        return Finding(text, verdict, ("cell", "gap [%]", "95 % t-interval"), tuple(lines))


@dataclasses.dataclass(frozen=True)
class Shortfall(AbstractRule):
    """One trails another by at least so much, as a share of the other's loss, in every cell."""

    behind: Entry
    ahead: Entry
    low: float
    """The least share of the other's loss."""
    sizes: tuple[int, ...] = ()
    """Team sizes that the claim is about; empty: all."""

    @property
    def text(self) -> str:
        among = f" with {', '.join(map(str, self.sizes))} drones" if self.sizes else ""
        return (
            f"{NAMES[self.behind]} loses at least {100 * self.low:.0f} % more than "
            f"{NAMES[self.ahead]} in every cell{among}, by the paired difference over seeds"
        )

    def judge(self, tables: Tables, metric: str) -> Finding:
        found = pairs_of(undisturbed(tables, metric), self.ahead, self.behind)
        pairs = [p for p in found if not self.sizes or p[0].team_size in self.sizes]
        if not pairs:
            return UNTESTED
        verdict = every(by_cell([difference(worse_by(self.low, a), b) for _, a, b in pairs]))
        shares = [lost_share(best, worse) for _, best, worse in pairs]
        text = f"by {range_text([100 * share for share in shares])} %"
        lines = tuple(
            (markdown.escape(cell.label), _percent(share, len(best)))
            for (cell, best, _), share in zip(pairs, shares, strict=True)
        )
        return Finding(text, verdict, ("cell", "loses more [%]"), lines)


@dataclasses.dataclass(frozen=True)
class EnoughFlights(AbstractRule):
    """Hybrid with so many calibration flights is nearly as good as with the whole pool."""

    flights: int
    """Calibration flights."""
    share: float
    """Share of what Hybrid loses with its pool that it may lose beyond it."""
    task: str = ""
    """The only task that is meant; empty: all."""

    @property
    def text(self) -> str:
        where = f" on {self.task}" if self.task else ""
        return (
            f"with {self.flights} flights Hybrid loses at most {100 * self.share:.0f} % more than "
            f"with the whole pool in every cell{where}, by the paired difference over seeds"
        )

    def judge(self, tables: Tables, metric: str) -> Finding:
        few = HYBRID._replace(variant=f"flights={self.flights}")
        pairs = pairs_of(undisturbed(tables, metric), few, HYBRID, self.task)
        if not pairs:
            return UNTESTED
        verdicts = by_cell([difference(a, worse_by(self.share, b)) for _, a, b in pairs])
        lines = tuple(
            (markdown.escape(cell.label), _percent(lost_share(b, a), len(a)), v.value)
            for (cell, a, b), v in zip(pairs, verdicts, strict=True)
        )
        headings = ("cell", "loses more [%]", "verdict")
        return Finding(counts_text(verdicts), every(verdicts), headings, lines)


def pairs_of(
    values: Values, first: Entry, second: Entry, task: str = ""
) -> list[tuple[Cell, Mapping[int, float], Mapping[int, float]]]:
    """Cells in which both entries have returns, with these by seed; of one task, if it is named."""
    return [
        (cell, *matched(own[first], own[second]))
        for cell, own in values.items()
        if first in own and second in own and task in ("", cell.task)
    ]


def worse_by(share: float, values: Mapping[int, float]) -> dict[int, float]:
    """Returns by seed, each lowered by a share of its size."""
    return {seed: x - share * abs(x) for seed, x in values.items()}


def gaps_by_size(values: Values, behind: Entry, ahead: Entry) -> dict[int, dict[int, float]]:
    """By team size and seed: the relative gap, mean over all tasks that any team size flew.

    A team size that lacks one of these tasks is left out: the mean would be of other tasks.
    """
    found: dict[int, dict[str, dict[int, float]]] = {}
    for cell, own in values.items():
        if behind in own and ahead in own:
            mine, theirs = matched(own[behind], own[ahead])
            common = [seed for seed in mine if seed in theirs]
            gap = {s: relative(theirs[s] - mine[s], theirs[s]) for s in common}
            found.setdefault(cell.team_size, {})[cell.task] = gap
    tasks = sorted({task for own in found.values() for task in own})
    result = {}
    for n in sorted(n for n, own in found.items() if len(own) == len(tasks)):
        seeds = sorted(set.intersection(*(set(found[n][task]) for task in tasks)))
        if seeds:
            result[n] = {s: estimate(found[n][t][s] for t in tasks).mean for s in seeds}
    return result


def _enough(verdicts: list[Verdict], share: float) -> Verdict:
    """Whether so large a share of cells supports a statement; a cell that is undecided may yet."""
    found = Counter(v for v in verdicts if v is not Verdict.UNTESTED)
    if not found.total():
        return Verdict.UNTESTED
    needed = math.ceil(share * found.total() - 1e-9)
    if found[Verdict.SUPPORTED] >= needed:
        return Verdict.SUPPORTED
    possible = found[Verdict.SUPPORTED] + found[Verdict.UNDECIDED]
    return Verdict.UNDECIDED if possible >= needed else Verdict.REFUTED


def _percent(share: float, n: int) -> str:
    return f"{number(100 * share, 1)} (n = {n})"


def _percent_span(low: float, high: float) -> str:
    return span(100 * low, 100 * high, 1)
