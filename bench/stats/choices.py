"""Which method to choose at which budget of high-fidelity flight, from the scores of a sweep.

At a team size, a method is affordable if its mean bill over tasks and seeds is at most the budget.
Of the affordable ones that have a score on every task, the best has the highest mean score; whoever
is not shown to be below it (`bench/stats/verdicts.py`, all tasks pooled) is tied with it.
"""

import re
from collections.abc import Iterable, Mapping, Sequence
from typing import NamedTuple

from bench.stats.scores import PRIMARY, at_home, scored, undisturbed
from bench.stats.statistics import (
    FEWEST_SEEDS,
    Entry,
    Values,
    estimate,
    matched,
    on_top,
    seed_values,
)
from bench.stats.verdicts import Verdict, above, by_cell, over_cells
from bench.store.tables import Tables

BUDGETS = (0.0, 0.5, 5.0, 50.0, 500.0, 5000.0)
"""Fleet-minutes that are asked about."""
BUDGET_VARIANT = re.compile(r"flights=\d+|trainer\.share=[\d.]+")
"""Variants that differ from the default in their budget of flight alone."""
NEAR = 0.1
"""A method that is not shown to be worse is named beside the best where its settled reward is lower
by at most this share of the best's on every task; a choice."""


class Choice(NamedTuple):
    """Which method to choose."""

    team_size: int
    budget: float
    """High-fidelity flight that may be spent [fleet-minutes]."""
    best: Entry
    score: float
    minutes: float
    """Flight that the best method is billed for [fleet-minutes]."""
    tied: "tuple[Tie, ...]"
    """Methods that are not shown to be below the best, by score."""
    tasks: tuple[str, ...]
    """Tasks whose scores this rests on."""


class Tie(NamedTuple):
    """A method that is not shown to be below the best: near it, or scattered too widely to tell."""

    entry: Entry
    score: float
    """Its mean score."""
    low: float
    """How far below the best it is, lower end of the 95 % interval; NaN without one."""
    high: float
    near: bool
    """Whether its mean settled reward is near the best's on every task (`NEAR`)."""


class Better(NamedTuple):
    """A method with other settings than its default, shown to be above the best default."""

    team_size: int
    entry: Entry
    """The method with the settings that it had on `tasks`; on the others it had its default."""
    tasks: tuple[str, ...]
    score: float
    """Mean over all tasks, of the seeds that `above` has, too."""
    minutes: float
    """Flight that it is billed for, mean over tasks [fleet-minutes]."""
    above: Entry
    """The best of the methods with default settings whose flight is at most `minutes`."""
    above_score: float
    """Its mean over the same seeds."""


def choices(tables: Tables) -> list[Choice]:
    """A choice for each team size and budget at which it differs from the smaller budget's."""
    found: list[Choice] = []
    for ladder in _ladders(tables, BUDGETS).values():
        last: Choice | None = None
        for choice in ladder:
            if last is None or _who(choice) != _who(last):
                found.append(choice)
                last = choice
    return found


def choose(tables: Tables, team_size: int, budget: float) -> Choice | None:
    """The choice at a team size and a budget [fleet-minutes]; None where nobody has a score."""
    return next(iter(_ladders(tables, (budget,)).get(team_size, [])), None)


def on_task(tables: Tables, task: str) -> Tables:
    """The rows of one task, for who has only that one to fly."""
    runs = tables.runs
    return tables.of_runs({*runs["run"][runs["task"] == task]})


def _ladders(tables: Tables, budgets: Sequence[float]) -> dict[int, list[Choice]]:
    """A choice for each budget at which anybody is affordable, by team size."""
    scores, rewards = _default(_scores(tables)), _default(undisturbed(tables, PRIMARY))
    found = {}
    for n, bills in _bills(tables).items():
        ladder = [_affordable(scores, rewards, bills, n, budget) for budget in budgets]
        found[n] = [choice for choice in ladder if choice]
    return found


def better_settings(tables: Tables) -> list[Better]:
    """Settings with which a method is above whatever is best by default at its bill.

    Settings are compared with the default on the tasks that flew them, all tasks pooled, with
    Holm's correction over all settings and team sizes. Scores of those that were chosen among many
    are a little too good all the same.
    """
    scores, flight = _scores(tables), undisturbed(tables, "fleet_minutes")
    defaults = _default(scores)
    rewards = _default(undisturbed(tables, PRIMARY))
    found, tests = [], []
    for n, bills in _bills(tables).items():
        cells = [cell for cell, own in defaults.items() if own and cell.team_size == n]
        for entry in sorted({e for cell in cells for e in scores[cell] if e.variant}):
            default = entry._replace(variant="")
            flown = {
                cell: entry if len(scores[cell].get(entry, {})) >= FEWEST_SEEDS else default
                for cell in cells
            }
            if entry not in flown.values() or not all(e in scores[c] for c, e in flown.items()):
                continue
            minutes = _mean(flight[cell][e].values() for cell, e in flown.items())
            best = _affordable(defaults, rewards, bills, n, minutes)
            if best is None:
                continue
            pairs = [(scores[cell][e], scores[cell][best.best]) for cell, e in flown.items()]
            tasks = tuple(sorted(cell.task for cell, e in flown.items() if e == entry))
            common = [matched(own, other) for own, other in pairs]
            score, below = (_mean(both[i].values() for both in common) for i in (0, 1))
            found.append(Better(n, entry, tasks, score, minutes, best.best, below))
            tests.append(over_cells(pairs))
    verdicts = zip(found, by_cell(tests), strict=True)
    return [better for better, verdict in verdicts if verdict is Verdict.SUPPORTED]


def _scores(tables: Tables) -> Values:
    """Scores in the undisturbed simulator, of all settings."""
    return at_home(seed_values(scored(tables), "score"), tables)


def _bills(tables: Tables) -> dict[int, dict[Entry, float]]:
    """Mean bill of each method by default, by team size, ascending."""
    found: dict[int, dict[Entry, list[float]]] = {}
    for cell, own in _default(undisturbed(tables, "fleet_minutes")).items():
        for entry, seeds in own.items():
            found.setdefault(cell.team_size, {}).setdefault(entry, []).extend(seeds.values())
    return {n: {e: estimate(m).mean for e, m in own.items()} for n, own in sorted(found.items())}


def _mean(cells: Iterable[Iterable[float]]) -> float:
    """Mean over cells of the means over seeds."""
    return estimate(estimate(own).mean for own in cells).mean


def _who(choice: Choice) -> list[Entry]:
    return [choice.best, *(tie.entry for tie in choice.tied)]


def at_budgets(values: Values, fewest: int = 1) -> Values:
    """Default settings and other budgets, with at least so many seeds in a cell."""
    settings = on_top(entry for own in values.values() for entry in own)
    return {
        cell: {
            entry: seeds
            for entry, seeds in own.items()
            if len(seeds) >= fewest
            and entry not in settings
            and (not entry.variant or BUDGET_VARIANT.fullmatch(entry.variant))
        }
        for cell, own in values.items()
    }


def _default(values: Values) -> Values:
    """Default settings, at least two seeds."""
    return {
        cell: {entry: seeds for entry, seeds in own.items() if not entry.variant}
        for cell, own in at_budgets(values, FEWEST_SEEDS).items()
    }


def _affordable(
    scores: Values, rewards: Values, bills: dict[Entry, float], team_size: int, budget: float
) -> Choice | None:
    """The choice among those whose bill is at most the budget."""
    cells = [cell for cell, own in scores.items() if own and cell.team_size == team_size]
    affordable = [e for e, minutes in bills.items() if minutes <= budget]
    entries = [e for e in affordable if all(e in scores[cell] for cell in cells)]
    if not entries or not cells:
        return None
    mean = {e: _mean(scores[cell][e].values() for cell in cells) for e in entries}
    best = max(entries, key=lambda e: mean[e])
    apart = {
        e: over_cells((scores[cell][best], scores[cell][e]) for cell in cells)
        for e in sorted(entries, key=lambda e: -mean[e])
        if e != best
    }
    tied = tuple(
        Tie(e, mean[e], behind.low, behind.high, _near(e, best, [rewards[cell] for cell in cells]))
        for e, behind in apart.items()
        if above(behind, behind.p) is not Verdict.SUPPORTED
    )
    tasks = tuple(sorted(cell.task for cell in cells))
    return Choice(team_size, budget, best, mean[best], bills[best], tied, tasks)


def _near(entry: Entry, best: Entry, cells: Sequence[Mapping[Entry, Mapping[int, float]]]) -> bool:
    """Whether an entry's mean reward is near that of the best in every cell."""
    means = [[estimate(own[e].values()).mean for e in (entry, best)] for own in cells]
    return all(one >= first - NEAR * abs(first) for one, first in means)
