"""Rules on costs, crashes and residual classes."""

import dataclasses
import itertools
import math
from collections.abc import Mapping

from bench.paper.rule import UNTESTED, AbstractRule, Finding, counts_text, range_text, summary
from bench.paper.values import NAMES, of_size, sizes
from bench.stats.scores import undisturbed
from bench.stats.statistics import Cell, Entry, difference, estimate
from bench.stats.verdicts import Verdict, by_cell, every
from bench.store.tables import Tables
from bench.text import markdown
from bench.text.numbers import MISSING, significant


@dataclasses.dataclass(frozen=True)
class Cheaper(AbstractRule):
    """Flight is ordered: each needs less than the next, at every team size."""

    order: tuple[Entry, ...]
    """The cheapest first."""

    @property
    def text(self) -> str:
        names = " < ".join(NAMES[entry] for entry in self.order)
        return (
            f"{names} at every team size, mean over seeds and over the tasks that all have (bills "
            "are exact)"
        )

    def judge(self, tables: Tables, metric: str) -> Finding:
        values = undisturbed(tables, "fleet_minutes")
        shared = {c: own for c, own in values.items() if all(e in own for e in self.order)}
        found = {n: [of_size(shared, e, n) for e in self.order] for n in sizes(shared)}
        if not found:
            return UNTESTED
        means = {n: [math.fsum(x) / len(x) for x in own] for n, own in found.items()}
        rising = all(a < b for m in means.values() for a, b in itertools.pairwise(m))
        lines = tuple(
            (f"N = {n}", *map(significant, m), str(10 * (n + 1))) for n, m in means.items()
        )
        headings = ("team size", *(NAMES[e] for e in self.order), "10 (N + 1)")
        ends = {min(means), max(means)}
        text = "; ".join(
            f"N = {n}: "
            + ", ".join(f"{NAMES[e]} {significant(x)}" for e, x in zip(self.order, m, strict=True))
            for n, m in means.items()
            if n in ends
        )
        verdict = Verdict.SUPPORTED if rising else Verdict.REFUTED
        return Finding(text, verdict, headings, lines)


@dataclasses.dataclass(frozen=True)
class AtMost(AbstractRule):
    """A number of an entry is at most so much in every run."""

    entry: Entry
    metric: str
    """The metric's name."""
    bound: float
    """In the metric's unit."""
    what: str
    """The number in words, as the first of a sentence."""

    @property
    def text(self) -> str:
        return f"{self.what} of every run of {NAMES[self.entry]} is at most {self.bound:g}"

    def judge(self, tables: Tables, metric: str) -> Finding:
        values = undisturbed(tables, self.metric)
        cells = {c: [*own[self.entry].values()] for c, own in values.items() if own.get(self.entry)}
        found = [*itertools.chain(*cells.values())]
        if not found:
            return UNTESTED
        over = [cell.label for cell, own in cells.items() if max(own) > self.bound + 1e-9]
        text = f"{range_text(found)} in {len(found)} runs"
        if over:
            where = "; ".join(over)
            text += f"; more than {self.bound:g} in {len(over)} of {len(cells)} cells ({where})"
        lines = tuple(
            (markdown.escape(cell.label), range_text(own), str(len(own)))
            for cell, own in cells.items()
        )
        headings = ("cell", f"smallest to largest; at most {self.bound:g} is claimed", "runs")
        return Finding(text, Verdict.REFUTED if over else Verdict.SUPPORTED, headings, lines)


@dataclasses.dataclass(frozen=True)
class Grows(AbstractRule):
    """A number is larger for the largest team than for the smallest, on every task that has it."""

    entries: tuple[Entry, ...]
    metric: str
    """The metric's name."""
    what: str
    """The number in words, as the first of a sentence."""
    factor: float = 1.0
    """What the number is shown times, such as 100 for percent."""

    @property
    def text(self) -> str:
        names = " and ".join(NAMES[entry] for entry in self.entries)
        return (
            f"{self.what} of {names} is larger for the largest team than for the smallest on every "
            "task on which it is not zero (Welch's interval over seeds, Holm-corrected)"
        )

    def judge(self, tables: Tables, metric: str) -> Finding:
        values = undisturbed(tables, self.metric)
        ends = sizes(values)
        tests, lines = [], []
        for entry in self.entries:
            for task in sorted({cell.task for cell in values}):
                own = {n: values.get(Cell(task, n), {}).get(entry, {}) for n in ends}
                own = {n: x for n, x in own.items() if x}
                if len(own) < 2 or not any(max(x.values()) > 0 for x in own.values()):
                    continue
                small, large = own[min(own)], own[max(own)]
                tests.append(difference({s + 10**6: x for s, x in large.items()}, small))
                shown = (_spread(own[n], self.factor) if n in own else "" for n in ends)
                lines.append((f"{NAMES[entry]}, {markdown.escape(task)}", *shown))
        verdicts = by_cell(tests)
        lines = tuple((*line, v.value) for line, v in zip(lines, verdicts, strict=True))
        headings = ("method and task", *(f"N = {n}" for n in ends), "grows")
        return Finding(counts_text(verdicts) or MISSING, every(verdicts), headings, lines)


@dataclasses.dataclass(frozen=True)
class OnlyOneHolds(AbstractRule):
    """Of several residual classes, one alone collapses nowhere."""

    one: Entry
    """The class that holds everywhere."""
    others: tuple[Entry, ...]
    """Classes each of which collapses somewhere."""
    factor: float
    """A class has collapsed if it loses more than so many times what the best class loses."""

    one_refutes = False

    @property
    def text(self) -> str:
        return (
            f"{NAMES[self.one]} loses less than {self.factor:g} times what the best class loses in "
            "every cell, and each other class more in some cell (paired differences over seeds, "
            "Holm-corrected)"
        )

    def judge(self, tables: Tables, metric: str) -> Finding:
        classes = (*self.others, self.one)
        cells = {
            cell: {e: own[e] for e in classes}
            for cell, own in undisturbed(tables, metric).items()
            if all(e in own for e in classes)
        }
        if not cells:
            return UNTESTED
        lines, tests = [], {entry: [] for entry in classes}
        for cell, own in cells.items():
            means = {e: estimate(x.values()) for e, x in own.items()}
            top = max(classes, key=lambda e: means[e].mean)
            limit = {seed: x - (self.factor - 1.0) * abs(x) for seed, x in own[top].items()}
            for entry in classes:
                tests[entry].append(difference(own[entry], limit))
            shown = {e: summary(x.values()) for e, x in own.items()}
            texts = (f"**{x}**" if e == top else x for e, x in shown.items())
            lines.append((markdown.escape(cell.label), *texts))
        verdicts = {entry: by_cell(own) for entry, own in tests.items()}
        collapsed = {e: v.count(Verdict.REFUTED) for e, v in verdicts.items()}
        holds = every(verdicts[self.one])
        if holds is Verdict.SUPPORTED and not all(collapsed[e] for e in self.others):
            sound = any(every(verdicts[e]) is Verdict.SUPPORTED for e in self.others)
            holds = Verdict.REFUTED if sound else Verdict.UNDECIDED
        text = "; ".join(
            f"{NAMES[e]} collapses in {n} of {len(cells)} cells" for e, n in collapsed.items()
        )
        return Finding(text, holds, ("cell", *(NAMES[e] for e in classes)), tuple(lines))


def _spread(values: Mapping[int, float], factor: float) -> str:
    return summary((factor * x for x in values.values()), 2)
