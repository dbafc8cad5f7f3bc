"""Which method to choose at which budget of flight, what flight gives, and what settings change."""

import re
from collections.abc import Mapping, Sequence

from bench.paper.values import LF, name_of, name_of_method, sizes, varied
from bench.stats.choices import BUDGET_VARIANT, BUDGETS, NEAR, Better, Choice, Tie
from bench.stats.scores import (
    PRIMARY,
    STEADY,
    fallen_references,
    steadied_references,
    undisturbed,
)
from bench.stats.statistics import LEVEL, Entry, Values, difference, estimate
from bench.stats.verdicts import Verdict, above, by_cell
from bench.store.tables import Tables
from bench.text import markdown
from bench.text.numbers import MISSING, mean_std, measured, number, significant, span
from bench.text.words import join

TIES = (
    "In brackets are methods that are not shown to be worse than the best and whose mean settled "
    f"reward is lower by at most {100.0 * NEAR:g} % of the best's on each task. "
)
"""What a name in brackets in the table of whom to choose means."""
SCATTERED = (
    "Where seeds scatter widely, other methods cannot be separated from the best, though they may "
    "be far worse. "
)
"""What is said of ties that stand in no brackets."""
TUNED = (
    "Each line names a method with other settings than its defaults. It scores higher than every "
    "method with default settings that spends as much flight or less, by the mean over tasks with "
    "Holm's correction over all settings that were tried. Its own default may spend more and score "
    "as high. We chose these settings among many by the same tables, so their scores are a little "
    "too good. On tasks that a line does not name, the method had its defaults:"
)
"""What is said of settings that are better than all defaults."""
BETTER_SETTINGS = (
    "The table has the methods' default settings only. Other settings score higher than every "
    "method with default settings that spends as much flight or less"
)
"""What is said where the names of such settings follow."""
BETTER = "Settings that score higher than all defaults"
"""Heading of their list."""
CHOSEN = "Which method to choose, and how far below it the others may be"
"""Heading of the table with all numbers."""
CHANGED = re.compile(rf"{BUDGET_VARIANT.pattern}|flown=\w+")
"""Variants that differ from the default in which high-fidelity flight is flown, or how much."""
FLOWN = (
    "Settled reward, mean ± standard deviation over seeds, of methods whose flight was varied, and "
    "of the LF baseline, which flies nothing. Of default settings only those seeds count that the "
    "others have, too. The flight is a mean over tasks and seeds. `flights` counts calibration "
    "flights of 10 s, `trainer.share` is the part of the epochs after which a training was cut "
    "off, and with `flown=grey_box` Hybrid is fitted to grey box's flights, with their sensor "
    "noise"
)
"""What the tables of rewards by flight show."""


def whom(
    found: Sequence[Choice], tables: Tables, better: Sequence[Better], cells: str
) -> list[str]:
    """Which method to choose at which budget: a line a team size, a column a budget.

    Args:
        found: What to choose.
        tables: What the sweep found.
        better: Settings that score higher than all defaults (`better_defaults`).
        cells: Name of the page that has the details.
    """
    if not found:
        return []
    means = f"Scores are means over {_tasks(found[0])}. " if _alike(found) else ""
    near = {tie.near for choice in found for tie in choice.tied}
    ties = (TIES if True in near else "") + (SCATTERED if False in near else "")
    shown = sorted({c.budget for c in found})
    lines = [
        (
            _team(next(filter(None, own)), found),
            *(MISSING if c is None else _cell(c) for c in own),
        )
        for own in _by_team(found, shown)
    ]
    parts = [
        "## Which method to choose",
        markdown.table(("team size", *map(_flight, shown)), lines, range(len(shown) + 1)),
        "Rows are team sizes, columns the high-fidelity flight that may be spent. Each entry "
        "names the best method and its score (0: a team that stays at its spawn; 1: the upper "
        f"reference). {ties}[By how much the others are worse]"
        f"({cells}#{markdown.anchor(CHOSEN)}). {means}Compare scores within a "
        "row only: each task and team size has an upper reference of its own, which is one "
        "training. Hybrid without a "
        "residual's name has the MLP ensemble.",
    ]
    if better:
        names = dict.fromkeys(
            f"{markdown.escape(name_of_method(b.entry))} with `{b.entry.variant}` and "
            f"{b.team_size} drones ({markdown.escape(', '.join(b.tasks))})"
            for b in better
        )
        where = f"[where, and by how much]({cells}#{markdown.anchor(BETTER)})"
        parts.append(f"{BETTER_SETTINGS}: {join(names)} ({where}).")
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


def by_task(found: Mapping[str, Sequence[Choice]]) -> list[str]:
    """The best method of each task alone: a line a task, a column a budget."""
    if len(found) < 2:
        return []
    shown = sorted({c.budget for own in found.values() for c in own})
    lines = []
    for task, own in found.items():
        columns = zip(*_by_team(own, shown), strict=True)
        lines.append((markdown.escape(task), *map(_by_name, columns)))
    return [
        "### On one task",
        markdown.table(("task", *map(_flight, shown)), lines, range(len(shown) + 1)),
        "The best method where only one task is flown, with the team sizes for which it is the "
        "best. `bench choose --task` gives its score, and the methods that are not shown to be "
        "worse. Means over tasks, as above, hide this: a method that diverges on one task loses "
        "there what it gains on the others. A method stands only in columns that allow the flight "
        "it needs; training in high fidelity may need more than any of them with many drones.",
    ]


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
        f"## {CHOSEN}",
        markdown.table(headings, lines, (0, 2, 5)),
        f"Asked at {asked} fleet-minutes; there is a row wherever the answer changes. "
        "`bench choose` answers for any other budget. The deficit is how far below the best a mean "
        "may lie.",
    ]


def better_defaults(found: Sequence[Choice], better: Sequence[Better]) -> list[str]:
    """The list of settings that score higher than every default of the same flight."""
    lines = [
        f"- {_team(next(c for c in found if c.team_size == b.team_size), found)}: "
        f"**{markdown.escape(name_of_method(b.entry))}** with `{b.entry.variant}` "
        f"on {markdown.escape(', '.join(b.tasks))}: {number(b.score, 4)} for "
        f"{significant(b.minutes)} fleet-minutes, where {markdown.escape(name_of(b.above))} has "
        f"{number(b.above_score, 4)}"
        for b in better
    ]
    return [f"## {BETTER}", TUNED, "\n".join(lines)] if lines else []


def _by_team(found: Sequence[Choice], budgets: Sequence[float]) -> list[list[Choice | None]]:
    """For each team size what holds at each budget; None where nothing can be afforded."""
    teams = []
    for size in sorted({c.team_size for c in found}):
        own = sorted((c for c in found if c.team_size == size), key=lambda c: c.budget)
        teams.append([next((c for c in reversed(own) if c.budget <= b), None) for b in budgets])
    return teams


def _by_name(teams: Sequence[Choice | None]) -> str:
    """The best methods of some team sizes, each with its sizes where there are several."""
    best: dict[str, list[str]] = {}
    for choice in filter(None, teams):
        best.setdefault(name_of(choice.best), []).append(str(choice.team_size))
    names = [f"**{markdown.escape(name)}**" for name in best]
    if len(best) > 1:
        names = [f"{n} (N = {', '.join(s)})" for n, s in zip(names, best.values(), strict=True)]
    return ", ".join(names) or MISSING


def _flight(budget: float) -> str:
    return f"{significant(budget)} fleet-minutes" if budget else "no flight"


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


def reward_by_flight(tables: Tables) -> list[str]:
    """The section: a table for each team size; nothing where no method's flight was varied."""
    rewards, bills = (undisturbed(tables, metric) for metric in (PRIMARY, "fleet_minutes"))
    shown = {cell: found for cell, own in rewards.items() if (found := _compared(own))}
    if not shown:
        return []
    parts = ["## Reward against flight", f"{FLOWN}."]
    for n in sizes(shown):
        own = {cell: values for cell, values in shown.items() if cell.team_size == n}
        parts += [f"### Reward against flight, N = {n}", _flown_table(own, bills)]
    return parts


def _compared(own: dict[Entry, dict[int, float]]) -> dict[Entry, dict[int, float]]:
    """Of a cell: methods whose flight was varied and the LF baseline, with their common seeds.

    Nothing where no method's flight was varied.
    """
    varied = {entry: seeds for entry, seeds in own.items() if CHANGED.fullmatch(entry.variant)}
    common = {seed for seeds in varied.values() for seed in seeds}
    default = {
        entry: {seed: value for seed, value in own.get(entry, {}).items() if seed in common}
        for entry in {LF, *(entry._replace(variant="") for entry in varied)}
    }
    return varied | {entry: seeds for entry, seeds in default.items() if seeds}


def _flown_table(own: Values, bills: Values) -> str:
    """Lines of one team size, by method and flight; `own` and `bills` by cell."""
    minutes = {
        entry: estimate(x for cell in own for x in bills[cell].get(entry, {}).values()).mean
        for entry in {entry for values in own.values() for entry in values}
    }
    lines = [
        (
            markdown.escape(name_of_method(entry)),
            f"`{entry.variant}`" if entry.variant else "default",
            significant(minutes[entry], 3),
            *(_reward(values.get(entry, {})) for values in own.values()),
        )
        for entry in sorted(minutes, key=lambda e: (e != LF, e.method, minutes[e], e.variant))
    ]
    tasks = (markdown.escape(cell.task) for cell in own)
    return markdown.table(("method", "setting", "flight [fleet-minutes]", *tasks), lines, (0, 1))


def _reward(seeds: dict[int, float]) -> str:
    if not seeds:
        return MISSING
    found = estimate(seeds.values())
    return mean_std(found.mean, found.std, 2 if abs(found.mean) < 10.0 else 1)


def beside_defaults(tables: Tables, figures: Sequence[str]) -> list[str]:
    """The section on settings that differ from the default, cell by cell, after its figures."""
    words = {Verdict.SUPPORTED: "better", Verdict.REFUTED: "worse", Verdict.UNDECIDED: "tied"}
    lines, tests = [], []
    for cell, entry, other, base in varied(tables):
        apart = difference(other, base)
        both = (estimate(base.values()), estimate(other.values()))
        shown = (f"{mean_std(x.mean, x.std)} (n = {x.n})" if x.n else MISSING for x in both)
        alone = "one seed: no order" if base else "no default row"
        lines.append(
            (
                markdown.escape(cell.label),
                markdown.escape(entry.label),
                *shown,
                measured(apart.mean, apart.low, apart.high),
                words.get(above(apart, apart.p), alone),
            )
        )
        tests.append(apart)
    if not lines:
        return []
    counts = {word: sum(line[-1] == word for line in lines) for word in words.values()}
    left = sum(v in (Verdict.SUPPORTED, Verdict.REFUTED) for v in by_cell(tests))
    chance = sum(counts.values()) * (1.0 - LEVEL) / 2.0
    headings = ("cell", "method", "default", "variant", "difference (95 % t-interval)", "verdict")
    return [
        "## Settings that differ from the default",
        *figures,
        "The settled reward of each setting less that of its default. Each line is judged by its "
        f"own interval alone: {counts['better']} are better and {counts['worse']} worse, where "
        f"chance alone would make about {number(chance, 0)} of either. With Holm's correction over "
        f"the whole table {left or 'none'} of these remain{'s' if left == 1 else ''}.",
        markdown.table(headings, lines, (0, 1)),
    ]
