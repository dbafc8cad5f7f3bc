"""What a sweep says, in a sentence or two: who wins at which budget, and what is not separated."""

from collections.abc import Iterable

from bench.stats.choices import Choice, choices
from bench.stats.leaderboard_rows import Row
from bench.stats.scores import UPPER
from bench.store.tables import Tables
from bench.text import markdown
from bench.text.numbers import significant

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
    best: dict[str, list[str]] = {}
    seeds, seen = 0, set()
    for row in rows:
        competes = row["n"] and row["default"] is None and row["entry"].method != UPPER
        if competes and row["cell"] not in seen:
            seen.add(row["cell"])
            best.setdefault(row["method"], []).append(row["cell"].label)
            seeds = max(seeds, row["n"])
    if not best:
        return []
    named = (
        f"**{markdown.escape(method)}** on {markdown.escape('; '.join(cells))}"
        for method, cells in best.items()
    )
    return [(ONE_SEED if seeds == 1 else UNSCORED) + ", ".join(named) + "."]
