"""What a sweep says, in a sentence or two: who wins at which budget, and what is not separated."""

from collections import Counter
from collections.abc import Iterable

from bench.stats.choices import Choice, better_settings, choices
from bench.stats.leaderboard_rows import Row, best_rows
from bench.stats.scores import at_home
from bench.stats.statistics import FAILURES, Entry, endings
from bench.store.tables import Tables
from bench.text import markdown
from bench.text.numbers import number, significant

ONE_SEED = "One seed a method, so no order is claimed. Highest settled reward: "
UNSCORED = "Without an upper reference nothing is pooled over cells. Best mean of each cell: "


def answer(tables: Tables, rows: Iterable[Row]) -> list[str]:
    """Markdown, a sentence a team size; empty without runs."""
    found: dict[int, list[Choice]] = {}
    for choice in choices(tables):
        own = found.setdefault(choice.team_size, [])
        # More flight that leaves the same method the best buys nothing.
        if not own or own[-1].best != choice.best:
            own.append(choice)
    if found:
        return [_sentence(n, own) for n, own in found.items()]
    return _best_of_cells(rows)


def chosen(choice: Choice, tables: Tables) -> list[str]:
    """A choice in sentences: the method, its cost and score, its ties, better settings."""
    lines = [
        f"N = {choice.team_size}, up to {choice.budget:g} fleet-minutes: {choice.best.label}.",
        f"It needs {significant(choice.minutes)} fleet-minutes. Its mean score is "
        f"{number(choice.score, 3)} on {', '.join(choice.tasks)} "
        "(0: a team that stays at its spawn, 1: the upper reference).",
    ]
    lines += [
        f"Not shown to be worse: {tie.entry.label}, score {number(tie.score, 3)}, at most "
        f"{significant(tie.high)} below."
        for tie in choice.tied
    ]
    lines += _failures(choice, tables)
    lines += [
        f"With other settings: {b.entry.label} on {', '.join(b.tasks)} "
        f"({b.entry._replace(variant='').label} elsewhere), score {number(b.score, 4)}, "
        f"{significant(b.minutes)} fleet-minutes. It was found by comparing many settings on "
        "these tables, so the score is a little too good."
        for b in better_settings(tables)
        if b.team_size == choice.team_size and b.minutes <= choice.budget and b.score > choice.score
    ]
    return lines


def _failures(choice: Choice, tables: Tables) -> list[str]:
    """Runs that failed or diverged, of the methods that are named, and of those left without any.

    A failed run is in no score, so that a method of which most fail may look the best.
    """
    runs: dict[Entry, Counter[str]] = {}
    for cell, own in at_home(endings(tables), tables).items():
        if cell.team_size == choice.team_size and cell.task in choice.tasks:
            for entry, ended in own.items():
                counts = {status: len(seeds) for status, seeds in ended.items()}
                runs[entry] = runs.get(entry, Counter()) + Counter(counts)
    named = [choice.best, *(tie.entry for tie in choice.tied)]
    lines = [
        f"{entry.label}: {gone} of {runs[entry].total()} runs failed or diverged."
        for entry in named
        if (gone := sum(runs[entry][status] for status in FAILURES))
    ]
    empty = [e for e, n in runs.items() if not e.variant and n["failed"] == n.total()]
    return lines + [f"{entry.label} is not compared: all its runs failed." for entry in empty]


def _sentence(team_size: int, own: list[Choice]) -> str:
    parts = []
    for choice in own:
        minutes = significant(choice.minutes)
        free = choice.minutes == 0.0
        budget = "without high-fidelity flight" if free else f"from {minutes} fleet-minutes on"
        parts.append(f"{budget} **{markdown.escape(choice.best.label)}**{_ties(choice)}")
    tasks = markdown.escape(", ".join(own[0].tasks))
    return f"N = {team_size} ({tasks}): {'; '.join(parts)}."


def _ties(choice: Choice) -> str:
    """Who is not separated from the best, and by how much score each may lie below it."""
    if not choice.tied:
        return ""
    named = (
        f"{markdown.escape(tie.entry.label)} (score at most {significant(tie.high)} lower)"
        for tie in choice.tied
    )
    return f", not separated from {' and '.join(named)}"


def _best_of_cells(rows: Iterable[Row]) -> list[str]:
    """The best mean of each cell, where nothing is scored or ranked."""
    first = best_rows(rows)
    best: dict[str, list[str]] = {}
    for cell, row in first.items():
        best.setdefault(row["method"], []).append(cell.label)
    if not best:
        return []
    one_seed = all(row["reward"].n == 1 for row in first.values())
    named = (
        f"**{markdown.escape(method)}** on {markdown.escape('; '.join(cells))}"
        for method, cells in best.items()
    )
    return [(ONE_SEED if one_seed else UNSCORED) + ", ".join(named) + "."]
