"""Which method to choose at which budget of flight, as Markdown."""

from collections.abc import Sequence

from bench.paper.values import name_of
from bench.stats.choices import BUDGETS, NEAR, Choice, Tie, better_settings
from bench.stats.scores import STEADY, fallen_references, steadied_references
from bench.store.tables import Tables
from bench.text import markdown
from bench.text.numbers import MISSING, number, significant, span

TIES = (
    "In brackets are methods that are not shown to be worse than the best and whose 95 % interval "
    f"ends at most {NEAR:g} below it. Where seeds scatter widely, other methods cannot be "
    "separated from the best, though they may be far worse"
)
"""What a name in brackets in the table of whom to choose means."""
TUNED = (
    "Each line names a method with other settings than its defaults. It scores higher than every "
    "method with default settings that spends as much flight or less. We chose these settings "
    "among many by the same tables, so their scores are a little too good. On tasks that a line "
    "does not name, the method had its defaults:"
)
"""What is said of settings that are better than all defaults."""
CHOSEN = "Which method to choose, and how far below it the others may be"
"""Heading of the table with all numbers."""


def whom(found: Sequence[Choice], tables: Tables) -> list[str]:
    """Which method to choose at which budget: a line a team size, a column a budget."""
    if not found:
        return []
    means = f"Scores are means over {_tasks(found[0])}. " if _alike(found) else ""
    shown = sorted({c.budget for c in found})
    lines = []
    for size in sorted({c.team_size for c in found}):
        own = {c.budget: c for c in found if c.team_size == size}
        cells, last = [], None
        for budget in shown:
            last = own.get(budget, last)
            cells.append(MISSING if last is None else _cell(last))
        lines.append((_team(next(iter(own.values())), found), *cells))
    budgets = [f"{significant(b)} fleet-minutes" if b else "no flight" for b in shown]
    parts = [
        "## Which method to choose",
        markdown.table(("team size", *budgets), lines, range(len(shown) + 1)),
        "Each line is a team size, each column the high-fidelity flight that may be spent. A cell "
        "names the best method and its score (0: a team that stays at its spawn; 1: the upper "
        f"reference). {TIES} ([which, and by how much]"
        f"(#{markdown.anchor(CHOSEN)})). {means}Scores are for comparing methods of one line: "
        "references differ from line to line, and each is one training. Hybrid without a "
        "residual's name has the MLP ensemble.",
    ]
    better = [
        f"- {_team(next(c for c in found if c.team_size == b.team_size), found)}: "
        f"**{markdown.escape(name_of(b.entry._replace(variant='')))}** with `{b.entry.variant}` "
        f"on {markdown.escape(', '.join(b.tasks))}: {number(b.score, 4)} for "
        f"{significant(b.minutes)} fleet-minutes, where {markdown.escape(name_of(b.above))} has "
        f"{number(b.above_score, 4)}"
        for b in better_settings(tables)
    ]
    if better:
        parts += [TUNED, "\n".join(better)]
    fallen = [cell.label for cell in sorted(fallen_references(tables))]
    if fallen:
        parts.append(f"Without a score, because the upper reference diverged: {'; '.join(fallen)}.")
    steadied = [cell.label for cell in sorted(steadied_references(tables))]
    if steadied:
        parts.append(
            "The upper reference diverged, and a score of 1 is what it reaches with "
            f"`{STEADY}`: {'; '.join(steadied)}."
        )
    return parts


def in_detail(found: Sequence[Choice]) -> list[str]:
    """The same with what the best needs and how far below it the others may be."""
    if not found:
        return []
    lines = [
        (
            _team(c, found),
            f"from {significant(c.budget)}",
            f"**{markdown.escape(name_of(c.best))}**",
            number(c.score, 3),
            significant(c.minutes),
            "; ".join(map(_tie_text, c.tied)) or MISSING,
        )
        for c in found
    ]
    headings = (
        "team size" if _alike(found) else "team size (tasks)",
        "budget [fleet-minutes]",
        "best method",
        "score",
        "it needs",
        "not shown to be worse: score (95 % interval of the deficit)",
    )
    asked = ", ".join(significant(budget) for budget in BUDGETS)
    return [
        f"### {CHOSEN}",
        markdown.table(headings, lines, (0, 2, 5)),
        f"Asked at {asked} fleet-minutes; there is a row wherever the answer changes. "
        "`bench choose` answers for any other budget. The deficit is how far below the best a mean "
        "may lie.",
    ]


def _cell(choice: Choice) -> str:
    near = (tie.entry for tie in choice.tied if tie.near)
    others = ", ".join(markdown.escape(name_of(entry)) for entry in near)
    best = f"**{markdown.escape(name_of(choice.best))}** {number(choice.score, 3)}"
    return f"{best} (or {others})" if others else best


def _tasks(choice: Choice) -> str:
    return markdown.escape(", ".join(choice.tasks))


def _alike(found: Sequence[Choice]) -> bool:
    """Whether all choices rest on the same tasks."""
    return len({c.tasks for c in found}) == 1


def _team(choice: Choice, found: Sequence[Choice]) -> str:
    return f"N = {choice.team_size}" + ("" if _alike(found) else f" ({_tasks(choice)})")


def _tie_text(tie: Tie) -> str:
    name = markdown.escape(name_of(tie.entry))
    return f"{name}: {number(tie.score, 3)} ({span(tie.low, tie.high, 3)})"
