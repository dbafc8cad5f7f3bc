"""The page of worlds: who survives where, what the worst world costs, and which claims hold there.

A score is the mean over cells (task and team size) that were flown in every world; its interval is
that of the mean over seeds. The worst world of a method decides: nobody knows beforehand in which
world a policy will be flown.
"""

import itertools
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from bench.paper.claims import DEPLOYED, OWN, PAPER
from bench.paper.figures import write_gaps
from bench.paper.page import judged, word_of
from bench.paper.values import WORDS, name_of_method
from bench.paper.world_views import (
    AS_IS,
    FEWEST_WORLDS,
    Matrix,
    Standing,
    World,
    is_as_it_is,
    matrix,
    settings_of,
    travelled,
    views,
    ways,
)
from bench.report.page import write_both
from bench.stats.statistics import Entry
from bench.stats.verdicts import Verdict
from bench.store.tables import Tables
from bench.text import markdown
from bench.text.numbers import MISSING, measured, number, significant
from bench.text.pages import read_notes, refuse_folder
from bench.text.say import say

TITLE = "Worlds that differ: which way of training survives"
MOST_TELLING = 3
"""Worlds from which on `bench run` adds the page."""
WORST_TENTH = (
    "Settled reward of the worst tenth of all drones; higher is better. Rows that are older than "
    "this metric have none, and a world in which most methods have none is left out."
)
NAMED = (
    "A suite file and `--reality` take the name alone. Here each name is spelled out, with the "
    "names of classes (a suite file would say `mass(e=0.2)+drag(c=1)`):"
)
"""What stands over the worlds."""
GAPS = (
    "1 minus the score of each method in each world, left is better: means over these cells, bars "
    "95 % intervals over seeds; a bar that would reach a score of 1 is cut"
)
"""What the figure shows."""
HEADINGS = ("worst world", "worst score", "flight [fleet-minutes]")


def _name(entry: Entry) -> str:
    """What the page calls an entry."""
    settings, name = settings_of(entry), name_of_method(entry)
    name += f" ({settings})" if settings else ""
    return f"{name}, {AS_IS}" if is_as_it_is(entry) else name


def lines(found: Matrix) -> list[tuple[str, ...]]:
    """The matrix as text, a line a method; those on the front are bold."""
    made = []
    for standing in travelled(found.standings):
        name = _name(standing.entry)
        scores = (standing.scores.get(w, (math.nan,) * 3) for w in found.worlds)
        made.append(
            (
                f"**{markdown.escape(name)}**"
                if standing.entry in found.front
                else markdown.escape(name),
                *(measured(*score) for score in scores),
                standing.worst.name if standing.worst else MISSING,
                number(standing.worst_score, 3) if standing.worst else MISSING,
                significant(standing.minutes) if standing.scores else MISSING,
            )
        )
    return made


def document(
    found: Mapping[World, Tables],
    made: Matrix | None,
    picture: str = "",
    title: str = TITLE,
    lead: str = "",
) -> str:
    """The page as Markdown.

    Args:
        found: The views of the worlds.
        made: Their matrix; None where there are fewer than `FEWEST_WORLDS`.
        picture: File name of the figure; empty without one.
        title: Heading of the page.
        lead: What is said first, in Markdown.
    """
    if made is None:
        return f"# {title}\n\nThese tables hold fewer than {FEWEST_WORLDS} worlds.\n"
    cells = "; ".join(markdown.escape(cell.label) for cell in made.cells) or "none"
    names = [world.name for world in made.worlds]
    claims = _claims(found)
    parts = [f"# {title}", "## In short", lead, *_summary(made, cells, claims)]
    if picture:
        parts += [f"![{GAPS}]({picture})", f"*{GAPS}.*"]
    parts += [WORDS, "## Scores"]
    parts += [
        "Means over the cells named above, which every method here flew in every world, with the "
        "95 % interval over seeds where there are at least two. Bold methods are Pareto-optimal: "
        "no other has a higher score in its worst world without flying more. Flight is the mean "
        "bill over these cells and worlds; for *as it is*, over the cells in crazyflow. *As it is* "
        "marks a policy that flew in crazyflow alone, in training or for its calibration, before "
        "it is deployed in the other worlds. A method that flies nowhere before it is deployed has "
        "no mark."
    ]
    if made.left_out:
        left_out = "; ".join(markdown.escape(cell.label) for cell in made.left_out)
        parts += [f"Left out, because not every method flew there in every world: {left_out}."]
    parts += [markdown.table(("method", *names, *HEADINGS), lines(made), (0, len(names) + 1))]
    parts += [*_worst_tenths(made), *_claims_table(claims, next(iter(found)).name)]
    legend = [f"- `{w.name}`: {markdown.escape(w.text)}" for w in made.worlds if w.name != w.text]
    parts += ["## The worlds", NAMED, "\n".join(legend)] if legend else []
    return "\n\n".join(filter(None, parts)) + "\n"


def _worst_tenths(made: Matrix) -> list[str]:
    """Settled reward of the worst tenth of the drones, a line a method; empty where unknown."""
    known = [s for s in travelled(made.standings) if s.deciles]
    worlds = [w for w in made.worlds if 2 * sum(w in s.deciles for s in known) > len(known)]
    if not worlds:
        return []
    lines = [
        (
            markdown.escape(_name(s.entry)),
            *(significant(s.deciles[w], 3) if w in s.deciles else MISSING for w in worlds),
        )
        for s in known
    ]
    headings = ("method", *(world.name for world in worlds))
    return ["## The worst tenth of all drones", WORST_TENTH, markdown.table(headings, lines)]


Claims = Mapping[str, Mapping[tuple[str, str], Verdict]]
"""Verdicts by the title of a claim and the world with the way of deployment (`ways`)."""


def _claims_table(claims: Claims, first: str) -> list[str]:
    """Verdicts by world on the claims that some other world than the `first` decides."""
    places = list(dict.fromkeys(place for own in claims.values() for place in own))
    lines = [
        (title, *(word_of(own.get(place, Verdict.UNTESTED)) for place in places))
        for title, own in claims.items()
    ]
    where = [", ".join(filter(None, place)) for place in places]
    if not claims:
        return []
    return [
        "## What of the claims holds where",
        "Claims about policies that train or fly in a world, judged there by settled rewards as on "
        "the page of the paper. A claim about more cells than were flown in a world is undecided "
        "there unless what was flown refutes it. If two worlds have different cells, their "
        "verdicts may differ because of the cells, not because of the worlds. Claims that are "
        f"decided in no world but {first} are left out.",
        markdown.table(("claim", *where), lines, range(len(where) + 1)),
    ]


def _claims(found: Mapping[World, Tables]) -> Claims:
    """Verdict on each claim by world, of the claims that another world than the first decides."""
    made: dict[str, dict[tuple[str, str], Verdict]] = {}
    for world, tables in found.items():
        for way, own in ways(tables).items():
            for one in judged(own):
                if one.claim.section in (PAPER, OWN) and one.claim.of == DEPLOYED:
                    place = (world.name, way)
                    made.setdefault(one.claim.title, {})[place] = one.finding.verdict
    first = next(iter(found)).name
    return {
        title: verdicts
        for title, verdicts in made.items()
        if {verdict for place, verdict in verdicts.items() if place != (first, "")}
        & {Verdict.SUPPORTED, Verdict.REFUTED}
    }


def _decided(claim: str, verdicts: Mapping[tuple[str, str], Verdict]) -> str:
    """A line of the summary: where a claim holds and where it does not."""
    parts = []
    for verdict, way in itertools.product((Verdict.SUPPORTED, Verdict.REFUTED), ("", AS_IS)):
        where = [name for (name, own), v in verdicts.items() if (v, own) == (verdict, way)]
        if where:
            parts.append(f"{word_of(verdict)} in {', '.join(where)}" + (f" ({way})" if way else ""))
    return f"- *{claim}*: {'; '.join(parts)}."


def _summary(made: Matrix, cells: str, claims: Claims) -> list[str]:
    """What to take away, in one screen: whom to choose, and what of the claims holds where."""
    front = [s for s in made.standings if s.worst is not None and s.entry in made.front]
    bullets = [
        f"- **Best in its worst world, {_flight(s)}**: {markdown.escape(_name(s.entry))}, "
        f"{number(s.worst_score, 3)} in {s.worst.name if s.worst else MISSING}"
        f"{_level(made.level[s.entry])}."
        for s in sorted(front, key=lambda s: s.minutes)
    ]
    for world, found in made.best.items():
        here = [s for s in travelled(made.standings) if world in s.scores]
        score = measured(*max(s.scores[world] for s in here))
        first = markdown.escape(_name(found[0]))
        bullets.append(f"- Highest mean in {world.name}: {first}, {score}{_level(found[1:])}.")
    if not bullets:
        return ["No method flew in every world."]
    bullets += [_decided(claim, verdicts) for claim, verdicts in claims.items()]
    travelled_at_all = any(is_as_it_is(s.entry) for s in made.standings)
    before = "*As it is*: the policy flew in crazyflow alone before. " if travelled_at_all else ""
    return [
        "\n".join(bullets),
        f"{before}{made.scale}. Scores here are means over {cells}. Methods that did not fly all "
        f"of these in at least {FEWEST_WORLDS} worlds are left out.",
    ]


def _level(others: Iterable[Entry]) -> str:
    """Above whom a method is not shown to be, as the end of a sentence."""
    names = " or ".join(markdown.escape(_name(entry)) for entry in others)
    return f"; not shown to be above {names}" if names else ""


def _flight(standing: Standing) -> str:
    minutes = standing.minutes
    return f"with {significant(minutes)} fleet-minutes of flight" if minutes else "without flight"


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
    _write(found, made, path)
    shown = Table(title="Score by world, mean", title_justify="left", box=SIMPLE_HEAD)
    for heading in ("method", *(world.name for world in made.worlds), *HEADINGS):
        left = heading in ("method", HEADINGS[0])
        shown.add_column(Text(heading), justify="left" if left else "right")
    for line in lines(made):
        shown.add_row(*(Text(re.sub(r"\*\*|\\", "", cell)) for cell in line))
    console = Console()
    console.print(shown)
    say(console, f"Worlds: {path}")


def write_worlds_page(suites: Sequence[Tables], path_md: Path, notes: Path | None = None) -> None:
    """Writes the page as Markdown, with its figure (`_gaps.png`), and as HTML beside it.

    `notes` is a Markdown file to append, e.g. why a method fails in a world. If it begins with a
    heading (`# ...`), the page has that title, and what it says before its first section is said
    first.

    Raises:
        UsageError: The notes cannot be read.
    """
    found = views(suites)
    made = matrix(found) if len(found) >= FEWEST_WORLDS else None
    _write(found, made, Path(path_md), "" if notes is None else read_notes(notes).strip())


def _write(found: Mapping[World, Tables], made: Matrix | None, path: Path, notes: str = "") -> None:
    refuse_folder(path)
    picture = path.with_name(f"{path.stem}_gaps.png")
    path.parent.mkdir(parents=True, exist_ok=True)
    drawn = made is not None and _draw(made, picture)
    heading = re.match(r"# (.+)\n*", notes)
    title = heading[1].strip() if heading else TITLE
    notes = notes[heading.end() :] if heading else notes
    lead, *sections = re.split(r"(?m)^(?=## )", notes, maxsplit=1)
    text = document(found, made, picture.name if drawn else "", title, lead.strip())
    text += "".join(f"\n{section}\n" for section in sections)
    write_both(path, text, title, [picture] if drawn else [])


def _draw(made: Matrix, path: Path) -> bool:
    """Draws who flew everywhere; False if nobody did."""
    shown = [s for s in made.standings if s.worst is not None]
    gaps = {
        world.name: [(1.0 - mean, 1.0 - high, 1.0 - low) for mean, low, high in own]
        for world in made.worlds
        for own in [[s.scores[world] for s in shown]]
    }
    if shown:
        write_gaps([_name(s.entry) for s in shown], gaps, path)
    return bool(shown)
