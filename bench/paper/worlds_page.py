"""The page of worlds: who survives where, what the worst world costs, and which claims hold there.

A score is the mean over cells (task and team size) that were flown in every world; its interval is
that of the mean over seeds. The worst world of a method decides: nobody knows beforehand in which
world a policy will be flown.
"""

import math
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from bench.paper.claims import OWN, PAPER
from bench.paper.page import judged
from bench.paper.values import name_of
from bench.paper.world_views import AS_IS, World, views
from bench.report.page import write_page
from bench.stats.scores import UPPER, recovered, scored
from bench.stats.statistics import REALITY, Cell, Entry, Values, default_of, estimate, seed_values
from bench.stats.verdicts import Verdict, over_cells
from bench.store.tables import Tables
from bench.text import markdown
from bench.text.numbers import MISSING, measured, significant
from bench.text.pages import write_text
from bench.text.say import say

TITLE = "Worlds that differ: which way of training survives"
MOST_TELLING = 3
"""Worlds from which on `bench run` adds the page."""
FEWEST = 2
"""Worlds without which there is nothing to compare."""
TO_UPPER = (
    "Scores: settled reward between that of a team that stays at its spawn (0) and that of the "
    "upper reference of the same world (1)"
)
TO_PERFECT = (
    "Scores: settled reward between that of a team that stays at its spawn (0) and 0, which is "
    "perfect and out of reach (1); some world has no upper reference in these tables"
)
HEADINGS = ("worst world", "worst score", "flight [fleet-minutes]")


class Standing(NamedTuple):
    """A method over all worlds."""

    entry: Entry
    scores: Mapping[World, tuple[float, float, float]]
    """Mean with the ends of its interval, NaN without one, by world that it flew in every cell."""
    deciles: Mapping[World, float]
    """Settled reward of the worst tenth of its drones, mean over cells and seeds, by world."""
    minutes: float
    """High-fidelity flight, mean over worlds, cells and seeds [min]."""
    worst: World | None
    """The world of its lowest score; None unless it flew in all worlds."""

    @property
    def worst_score(self) -> float:
        """The lowest score; NaN unless it flew in all worlds."""
        return self.scores[self.worst][0] if self.worst is not None else math.nan


class Matrix(NamedTuple):
    """Methods against worlds."""

    worlds: tuple[World, ...]
    cells: tuple[Cell, ...]
    """Tasks and team sizes that were flown in every world, named as if at home."""
    standings: list[Standing]
    """Highest worst-world score first, then who did not fly everywhere."""
    front: frozenset[Entry]
    """Methods that no other beats in worst-world score without flying more."""
    scale: str
    """What a score is."""


def matrix(found: Mapping[World, Tables]) -> Matrix:
    """The matrix of the views of worlds."""
    values = {world: _default(seed_values(scored(t), "score")) for world, t in found.items()}
    scale = TO_UPPER
    if not all(values.values()):
        values, scale = {w: _default(recovered(t)) for w, t in found.items()}, TO_PERFECT
    shared = set.intersection(*({(c.task, c.team_size) for c in own} for own in values.values()))
    cells = tuple(Cell(*cell) for cell in sorted(shared))
    entries = sorted({e for own in values.values() for entries in own.values() for e in entries})
    standings = [_standing(entry, values, found, shared) for entry in entries]
    standings = sorted(
        (s for s in standings if s.scores),
        key=lambda s: (s.worst is None, -s.worst_score if s.worst else 0.0, s.entry),
    )
    front = frozenset(s.entry for s in standings if _on_front(s, standings))
    return Matrix(tuple(found), cells, standings, front, scale)


def _default(values: Values) -> Values:
    """Default settings without the upper reference, at home or as they are elsewhere."""
    return {
        cell: {
            e: own
            for e, own in entries.items()
            if e.method != UPPER and (e.variant == AS_IS or default_of(e) == e)
        }
        for cell, entries in values.items()
    }


def _standing(
    entry: Entry,
    values: Mapping[World, Values],
    found: Mapping[World, Tables],
    shared: set[tuple[str, int]],
) -> Standing:
    scores, deciles, minutes = {}, {}, []
    for world, own in values.items():
        here = _flown_as(entry, world)
        flown = _of(own, here, shared)
        if len(flown) < len(shared) or not flown:
            continue
        scores[world] = _mean(flown)
        results = found[world].results
        bills = _of(seed_values(results, "fleet_minutes"), here, shared)
        minutes += [x for seeds in bills for x in seeds.values()]
        tenths = _of(seed_values(results, "worst_decile_reward"), here, shared)
        if tenths:
            deciles[world] = float(np.mean([estimate(s.values()).mean for s in tenths]))
    complete = len(scores) == len(values)
    worst = min(scores, key=lambda world: scores[world][0]) if complete and scores else None
    return Standing(entry, scores, deciles, estimate(minutes).mean, worst)


def _flown_as(entry: Entry, world: World) -> Entry:
    """What an entry is called in a world: where it was trained, a policy is not *as it is*."""
    if entry.variant == AS_IS and world == World(REALITY):
        return entry._replace(variant="")
    return entry


def _of(values: Values, entry: Entry, shared: set[tuple[str, int]]) -> list[Mapping[int, float]]:
    """Values by seed of a method, in each of the shared cells that it flew."""
    return [
        own[entry]
        for cell, own in values.items()
        if (cell.task, cell.team_size) in shared and entry in own
    ]


def _mean(flown: Sequence[Mapping[int, float]]) -> tuple[float, float, float]:
    """Mean over cells, with the interval of the mean over seeds where every cell has two."""
    mean = float(np.mean([estimate(seeds.values()).mean for seeds in flown]))
    if min(map(len, flown)) < 2:
        return mean, math.nan, math.nan
    test = over_cells((seeds, dict.fromkeys(seeds, 0.0)) for seeds in flown)
    return mean, test.low, test.high


def _on_front(one: Standing, all_: Sequence[Standing]) -> bool:
    """Whether nobody has a higher worst score for no more flight, nor less flight for no less."""
    if one.worst is None:
        return False
    return not any(
        other.worst_score >= one.worst_score
        and other.minutes <= one.minutes
        and (other.worst_score > one.worst_score or other.minutes < one.minutes)
        for other in all_
        if other.worst is not None
    )


def _name(entry: Entry) -> str:
    """What the page calls an entry."""
    if entry.variant == AS_IS:
        return f"{name_of(entry._replace(variant=''))}, {AS_IS}"
    return name_of(entry)


def lines(found: Matrix) -> list[tuple[str, ...]]:
    """The matrix as text, a line a method; those on the front are bold."""
    made = []
    for standing in found.standings:
        name = _name(standing.entry)
        scores = (standing.scores.get(w, (math.nan,) * 3) for w in found.worlds)
        made.append(
            (
                f"**{markdown.escape(name)}**"
                if standing.entry in found.front
                else markdown.escape(name),
                *(measured(*score) for score in scores),
                standing.worst.name if standing.worst else MISSING,
                significant(standing.worst_score, 3) if standing.worst else MISSING,
                significant(standing.minutes) if standing.scores else MISSING,
            )
        )
    return made


def document(suites: Sequence[Tables]) -> str:
    """The page as Markdown."""
    found = views(suites)
    if len(found) < FEWEST:
        return f"# {TITLE}\n\nThese tables hold fewer than {FEWEST} worlds.\n"
    made = matrix(found)
    cells = "; ".join(markdown.escape(cell.label) for cell in made.cells) or "none"
    claims = _claims(found)
    names = [world.name for world in made.worlds]
    parts = [f"# {TITLE}", *_summary(made, claims), "## Scores"]
    parts += [
        f"{made.scale}; mean over the cells that were flown in every world ({cells}), with the "
        "95 % interval over seeds where there are two. Bold: on the front, where nobody has a "
        "higher score in the worst world without flying more. Flight: mean over worlds. A policy "
        "that is deployed *as it is* was trained in another world."
    ]
    parts += [markdown.table(("method", *names, *HEADINGS), lines(made), (0, len(names) + 1))]
    tenths = [
        (
            markdown.escape(_name(s.entry)),
            *(significant(s.deciles[w], 3) if w in s.deciles else MISSING for w in made.worlds),
        )
        for s in made.standings
        if s.deciles
    ]
    if tenths:
        parts += ["## The worst tenth of all drones", "Settled reward; higher is better."]
        parts += [markdown.table(("method", *names), tenths)]
    parts += ["## What of the claims holds where"]
    parts += [
        "Judged in each world by its settled rewards, as on the page of the paper. A claim about "
        "more cells than were flown in a world is undecided there unless what was flown refutes it."
    ]
    rows = [
        (title, *(f"**{v.value}**" if v is Verdict.REFUTED else v.value for v in verdicts.values()))
        for title, verdicts in claims.items()
    ]
    parts += [markdown.table(("claim", *names), rows, range(len(names) + 1))]
    legend = [f"- `{w.name}`: {markdown.escape(w.text)}" for w in made.worlds if w.name != w.text]
    parts += ["## The worlds", "\n".join(legend)] if legend else []
    return "\n\n".join(parts) + "\n"


def _claims(found: Mapping[World, Tables]) -> dict[str, dict[World, Verdict]]:
    """Verdict on each claim by world, of the claims that some world tests."""
    made: dict[str, dict[World, Verdict]] = {}
    for world, tables in found.items():
        for one in judged(tables):
            if one.claim.section in (PAPER, OWN):
                made.setdefault(one.claim.title, {})[world] = one.finding.verdict
    return {
        title: verdicts
        for title, verdicts in made.items()
        if set(verdicts.values()) != {Verdict.UNTESTED}
    }


def _summary(made: Matrix, claims: Mapping[str, Mapping[World, Verdict]]) -> list[str]:
    """What to take away, in one screen."""
    complete = [s for s in made.standings if s.worst is not None]
    bullets = [
        f"- **{markdown.escape(_name(s.entry))}** keeps a score of "
        f"{significant(s.worst_score, 3)} in its worst world ({s.worst.name}) for "
        f"{significant(s.minutes)} fleet-minutes."
        for s in sorted(complete, key=lambda s: s.minutes)
        if s.entry in made.front and s.worst is not None
    ]
    for world in made.worlds:
        here = [s for s in made.standings if world in s.scores]
        if not here:
            continue
        best = max(here, key=lambda s: s.scores[world][0])
        verdicts = [own[world] for own in claims.values() if world in own]
        counts = ", ".join(
            f"{verdicts.count(v)} {v.value}"
            for v in (Verdict.SUPPORTED, Verdict.REFUTED, Verdict.UNDECIDED)
            if verdicts.count(v)
        )
        bullets.append(
            f"- {world.name}: best mean {markdown.escape(_name(best.entry))} "
            f"({measured(*best.scores[world])}); claims: {counts or 'none tested'}."
        )
    return ["## In short", "\n".join(bullets) or "No method flew in every world."]


def add_worlds_page(tables_dir: Path, documents_dir: Path) -> None:
    """Writes worlds.md among the documents of a sweep and shows its matrix.

    Nothing where the tables are not there, or where no method flew in `MOST_TELLING` worlds.
    """
    if not (tables_dir / "runs.parquet").is_file():
        return
    tables = Tables.load(tables_dir)
    found = views([tables])
    made = matrix(found) if len(found) >= MOST_TELLING else None
    if made is None or all(s.worst is None for s in made.standings):
        return
    path = documents_dir / "worlds.md"
    write_worlds_page([tables], path)
    shown = Table(title="Score by world, mean", title_justify="left", box=SIMPLE_HEAD)
    for heading in ("method", *(world.name for world in made.worlds), *HEADINGS):
        left = heading in ("method", HEADINGS[0])
        shown.add_column(Text(heading), justify="left" if left else "right")
    for line in lines(made):
        shown.add_row(*(Text(re.sub(r"\*\*|\\", "", cell)) for cell in line))
    console = Console()
    console.print(shown)
    say(console, f"Worlds: {path}")


def write_worlds_page(suites: Sequence[Tables], path_md: Path) -> None:
    """Writes the page as Markdown, and as HTML beside it."""
    text = document(suites)
    write_text(Path(path_md), text)
    write_page(text, Path(path_md).with_suffix(".html"), TITLE)
