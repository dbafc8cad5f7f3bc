"""Which method to choose at which budget of high-fidelity flight, from the scores of a sweep.

At a team size, a method is affordable if its mean bill over tasks and seeds is at most the budget.
Of the affordable ones that have a score on every task, the best has the highest mean score; whoever
is not shown to be below it (`bench/stats/verdicts.py`, all tasks pooled) is tied with it.
"""

from collections.abc import Sequence
from typing import NamedTuple

from bench.stats.scores import UPPER, at_home, scored, undisturbed
from bench.stats.statistics import FEWEST, Entry, Values, estimate, seed_values
from bench.stats.verdicts import Verdict, over_cells
from bench.store.tables import Tables

BUDGETS = (0.0, 0.5, 5.0, 50.0, 500.0, 5000.0)
"""Fleet-minutes that are asked about."""


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


def _ladders(tables: Tables, budgets: Sequence[float]) -> dict[int, list[Choice]]:
    """A choice for each budget at which anybody is affordable, by team size."""
    values = at_home(seed_values(scored(tables), "score"), tables)
    scores, minutes = _default(values), minutes_of(tables)
    found = {}
    for n in sorted({cell.team_size for cell in scores}):
        bills = {e: estimate(x).mean for (e, size), x in minutes.items() if size == n}
        ladder = [
            _choose(scores, {e: m for e, m in bills.items() if m <= budget}, n, budget)
            for budget in budgets
        ]
        found[n] = [choice for choice in ladder if choice]
    return found


def _who(choice: Choice) -> list[Entry]:
    return [choice.best, *(tie.entry for tie in choice.tied)]


def minutes_of(tables: Tables) -> dict[tuple[Entry, int], list[float]]:
    """Bills by entry and team size, of default settings in the undisturbed simulator."""
    found: dict[tuple[Entry, int], list[float]] = {}
    for cell, own in _default(undisturbed(tables, "fleet_minutes")).items():
        for entry, seeds in own.items():
            found.setdefault((entry, cell.team_size), []).extend(seeds.values())
    return found


def _default(values: Values) -> Values:
    """Default settings, at least two seeds, no reference."""
    return {
        cell: {
            entry: seeds
            for entry, seeds in own.items()
            if not entry.variant and entry.method != UPPER and len(seeds) >= FEWEST
        }
        for cell, own in values.items()
    }


def _choose(
    scores: Values, bills: dict[Entry, float], team_size: int, budget: float
) -> Choice | None:
    cells = [cell for cell, own in scores.items() if own and cell.team_size == team_size]
    entries = [e for e in bills if all(e in scores[cell] for cell in cells)]
    if not entries or not cells:
        return None
    mean = {
        e: estimate(estimate(scores[cell][e].values()).mean for cell in cells).mean for e in entries
    }
    best = max(entries, key=lambda e: mean[e])
    apart = {
        e: over_cells((scores[cell][best], scores[cell][e]) for cell in cells)
        for e in sorted(entries, key=lambda e: -mean[e])
        if e != best
    }
    tied = tuple(
        Tie(e, mean[e], test.low, test.high)
        for e, test in apart.items()
        if test.verdict is not Verdict.SUPPORTED
    )
    tasks = tuple(sorted(cell.task for cell in cells))
    return Choice(team_size, budget, best, mean[best], bills[best], tied, tasks)
