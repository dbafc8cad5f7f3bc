"""The page that puts the paper's claims beside ours, and those that it links to.

The first gives answers: which method to choose, what holds, one line a claim. The second has the
tables that they rest on, cell by cell. The third, of notes that are given, says why. All are
written as Markdown and as HTML.
"""

import dataclasses
import re
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import NamedTuple

from bench.paper.choosing import (
    beside_defaults,
    better_defaults,
    by_task,
    in_detail,
    reward_by_flight,
    whom,
)
from bench.paper.claims import BILLS, BUDGET, CLAIMS, GRID, OFF_SPEC, OWN, PAPER, Claim
from bench.paper.figures import (
    FLIGHTS,
    SETTINGS,
    SUMMARY,
    WORLDS,
    write_flights,
    write_settings,
    write_summary,
    write_worlds,
)
from bench.paper.pictures import (
    COST,
    PIPELINE,
    VIEWS,
    write_cost,
    write_pipeline,
    write_top_views,
)
from bench.paper.rule import Finding
from bench.paper.values import WORDS
from bench.report.leaderboard import made_by
from bench.report.page import write_both
from bench.stats.choices import Better, Choice, better_settings, choices, on_task
from bench.stats.scores import PRIMARY
from bench.stats.statistics import REALITY
from bench.stats.verdicts import Verdict
from bench.store.tables import Tables
from bench.text import markdown
from bench.text.errors import UsageError
from bench.text.pages import read_notes, refuse_folder
from bench.text.words import clean, join

TITLE = "How to train a drone team{}: the paper's claims beside ours"
"""Of the first page, with the simulator flown in, where that is another."""
CELLS = "The paper's claims, cell by cell"
"""Title of the second page."""
WHY = "Why: experiments behind the answers"
"""Title of the third page."""
THE_PAPER = 'The paper (Mednikov and Gal, "Calibrate Once, Fly Any Team", arXiv 2609.17265)'
"""Whose claims the page judges."""
ENDED = {
    "ok": "finished",
    "budget": "used all their epochs while the reward still improved",
    "diverged": "diverged",
    "failed": "failed",
}
"""How a run ended, in words."""
HOLDS = "What holds"
"""Heading of the list of claims by verdict."""
BY_CONSTRUCTION = (
    "True by construction: a setting fixes the bill, or nothing trains in high fidelity"
)
"""What is said of claims that no measurement could refute."""
SOURCE = "Where the rows come from"
"""Heading of the table of commits and machines."""
HOW = (
    "Every number is computed from the tables of the sweep. The settled reward, from 2 s on, is "
    "judged first; the verdict by the whole return stands beside it. A claim about every cell (a "
    "task and a team size) is **supported** if every cell supports it after Holm's correction, "
    "**refuted** if one cell refutes it, and **undecided** otherwise: a tie is no win, and cells "
    "that were not run support nothing. Differences are paired by training seed; a run that "
    "diverged counts with its last policy. Intervals are of one cell, without correction; "
    "p values are corrected. For a claim about every cell the correction is stricter than it needs "
    "to be. "
    "The settled reward leaves out take-off, so that relative gaps are far larger by it than by "
    "the whole return. Contacts are flags in this simulator: drones never push each other."
)
"""How verdicts are made."""
FIGURES = {
    "pipeline": (PIPELINE, write_pipeline),
    "views": (VIEWS, write_top_views),
    "cost": (COST, write_cost),
    "summary": (SUMMARY, write_summary),
    "flights": (FLIGHTS, write_flights),
    "worlds": (WORLDS, write_worlds),
    "settings": (SETTINGS, write_settings),
}
"""Figures by the end of their file's name: what each shows, and who draws it."""
SHOWN = {PAPER: "summary", BUDGET: "flights", OFF_SPEC: "worlds"}
"""The figure of a section."""


class Judged(NamedTuple):
    """A claim with what the tables say of it."""

    claim: Claim
    finding: Finding
    whole: Finding
    """The same by the return of the whole episode, the paper's metric."""
    so_far: Verdict
    """The verdict if the cells that were run were all."""
    whole_so_far: Verdict
    """The same by the return of the whole episode."""

    @property
    def word(self) -> str:
        """The verdict as Markdown."""
        return self._word(self.finding.verdict, self.so_far)

    @property
    def whole_word(self) -> str:
        """The same by the return of the whole episode."""
        return self._word(self.whole.verdict, self.whole_so_far)

    def _word(self, verdict: Verdict, so_far: Verdict) -> str:
        return (
            "true by construction"
            if _by_construction(self.claim, so_far)
            else word_of(verdict, so_far)
        )


def judged(tables: Tables) -> list[Judged]:
    """All claims, judged."""
    found = []
    for claim in CLAIMS:
        so_far = claim.rule.judge(tables, PRIMARY)
        whole = claim.rule.judge(tables, "reward")
        both = _whole(claim, so_far), _whole(claim, whole)
        found.append(Judged(claim, *both, so_far.verdict, whole.verdict))
    return found


class Content(NamedTuple):
    """What both pages are made of."""

    tables: Tables
    found: Sequence[Judged]
    chosen: Sequence[Choice]
    better: Sequence[Better]
    """Settings that score higher than every default of the same flight."""
    alone: Mapping[str, Sequence[Choice]]
    """What to choose where one task alone is flown, by task."""


def content_of(tables: Tables) -> Content:
    """What the pages say of a sweep."""
    alone = {task: choices(on_task(tables, task)) for task in sorted({*tables.runs["task"]})}
    return Content(tables, judged(tables), choices(tables), better_settings(tables), alone)


def _whole(claim: Claim, found: Finding) -> Finding:
    """A finding as one on the whole claim: nothing supports it where part of it was not run."""
    if len(found.lines) >= claim.lines or found.verdict is Verdict.UNTESTED:
        return found
    partial = f"{found.ours} (run: {len(found.lines)} of {claim.lines})"
    refuted = found.verdict is Verdict.REFUTED and claim.rule.one_refutes
    verdict = found.verdict if refuted else Verdict.UNDECIDED
    return dataclasses.replace(found, ours=partial, verdict=verdict, pooled=Verdict.UNTESTED)


def beside(path_md: Path, part: str) -> Path:
    """Path of a page that belongs to the page of answers; `part` is `cells` or `why`."""
    return path_md.with_name(f"{path_md.stem}_{part}.md")


def write_claims(tables: Tables, path_md: Path, notes: Path | None = None) -> list[Path]:
    """Writes the page of answers and those beside it, as Markdown and as HTML.

    Args:
        tables: What the sweep found.
        path_md: Where to write the answers; the cells get `_cells.md`, the notes `_why.md`, the
            HTML the suffix `.html`, the figures `_cost.png`, `_summary.png`, and so on (`FIGURES`).
        notes: A Markdown file that says why, e.g. why a claim fails; the answers list its headings
            of the second level.

    Returns:
        The Markdown files: answers, cells and, if there are notes, why.

    Raises:
        UsageError: The notes cannot be read, `path_md` names the HTML, or a folder is in the way.
    """
    path = Path(path_md)
    if path.suffix == ".html":
        raise UsageError(f"Markdown is written to {path} and HTML beside it: name the former.")
    cells, why = beside(path, "cells"), beside(path, "why")
    for place in (path, cells, why):
        refuse_folder(place)
    notes_text = "" if notes is None else read_notes(notes).strip()
    path.parent.mkdir(parents=True, exist_ok=True)
    drawn = {}
    for name, (title, write) in FIGURES.items():
        picture = path.with_name(f"{path.stem}_{name}.png")
        if write(tables, picture):
            drawn[name] = (title, picture)

    figures = {
        name: [f"![{title}]({picture.name})", f"*{title}.*"]
        for name, (title, picture) in drawn.items()
    }
    own = content_of(tables)
    reasons = _reasons(notes_text, why.name)
    texts = {
        path: (title_of(tables), document(own, reasons, figures, cells.name)),
        cells: (CELLS, cells_document(own, figures, path.name)),
    }
    if notes_text:
        texts[why] = (WHY, f"# {WHY}\n\n[The answers]({path.name}).\n\n{notes_text}\n")
    pictures = [picture for _, picture in drawn.values()]
    for place, (title, text) in texts.items():
        write_both(place, text, title, pictures, texts)
    return list(texts)


def title_of(tables: Tables) -> str:
    """The title of the first page, with the simulator that is flown, if it is not the paper's."""
    other = _other_simulator(tables)
    return TITLE.format(f" in {clean(other)}" if other else "")


def _other_simulator(tables: Tables) -> str:
    """The simulator in which most runs flew; empty if it is the paper's, or nothing flew."""
    most = [*tables.results["simulator"].mode(), REALITY][0]
    return "" if most == REALITY else most


def _flown_elsewhere(tables: Tables) -> list[str]:
    """What was flown, if not in the paper's simulator."""
    if not (other := _other_simulator(tables)):
        return []
    cells = tables.results.loc[tables.results["simulator"] == other, ["task", "team_size"]]
    return [
        f"Here {clean(other)} stands in for the real drone, as {REALITY} does in the paper. Of the "
        f"paper's {GRID} cells (a task and a team size) {len(cells.drop_duplicates())} were run."
    ]


def _reasons(notes: str, why: str) -> list[str]:
    """The section that lists the headings of the notes, each a link to the page `why`."""
    titles = re.findall(r"^## (.+)$", notes, re.MULTILINE)
    lines = [f"- [{title}]({why}#{markdown.anchor(title)})" for title in titles]
    return ["## Why", "\n".join(lines)] if lines else []


def document(
    own: Content, reasons: Sequence[str], figures: Mapping[str, Sequence[str]], cells: str
) -> str:
    """The page of answers as Markdown.

    Args:
        own: What it says.
        reasons: Paragraphs that link to why.
        figures: Paragraphs of each figure, by its name in `FIGURES`.
        cells: Name of the page that has all cells.
    """
    parts = [f"# {title_of(own.tables)}", *_flown_elsewhere(own.tables), _count(own.found), WORDS]
    parts += whom(own.chosen, own.tables, own.better, cells)
    parts += by_task(own.alone)
    parts += [*_answer(own.found), *figures.get("cost", []), *reasons]
    sections = list(dict.fromkeys(j.claim.section for j in own.found))
    for section in sections:
        claims = [j for j in own.found if j.claim.section == section]
        if section != PAPER and all(j.finding.verdict is Verdict.UNTESTED for j in claims):
            continue
        theirs = "aim" if section == sections[-1] else "paper"
        parts += [f"## {section}"]
        if section == PAPER:
            parts += [HOW, f"[Each claim, cell by cell]({cells})."]
            parts += [*figures.get("pipeline", []), *figures.get("views", [])]
        lines = [
            (
                _title(j, cells),
                j.claim.stated,
                j.finding.ours,
                j.word,
                # Its numbers stand above unless the whole return has others.
                j.whole_word + (f": {j.whole.ours}" if j.whole.ours != j.finding.ours else ""),
            )
            for j in claims
        ]
        whole = "by the whole return, as in the paper"
        headings = ("claim", theirs, "ours, settled reward", "verdict", whole)
        parts += [markdown.table(headings, lines, range(5))]
        parts += figures.get(SHOWN.get(section, ""), [])
    more = f" [Commits and machines]({cells}#{markdown.anchor(SOURCE)})."
    parts += [_ended(own.tables) + (more if made_by(own.tables) else "")]
    return "\n\n".join(parts) + "\n"


def cells_document(own: Content, figures: Mapping[str, Sequence[str]], answers: str) -> str:
    """The page of all cells as Markdown; `answers` is the name of the page of answers."""
    parts = [f"# {CELLS}", f"[What follows from these tables]({answers})."]
    parts += [*in_detail(own.chosen), *better_defaults(own.chosen, own.better)]
    for j in own.found:
        if j.finding.lines:
            parts += [f"## {j.claim.title}", f"Supported if {j.claim.rule.text}."]
            parts += [markdown.table(j.finding.headings, j.finding.lines)]
    parts += reward_by_flight(own.tables)
    parts += beside_defaults(own.tables, figures.get("settings", []))
    if made := made_by(own.tables):
        lines = [(commit, markdown.escape(machine), f"{n:,}") for commit, machine, n in made]
        parts += [f"## {SOURCE}", _ended(own.tables)]
        parts += [markdown.table(("commit", "machine", "rows"), lines, (0, 1))]
    return "\n\n".join(parts) + "\n"


def _title(j: Judged, cells: str) -> str:
    """What is claimed, as a link to its table, if it has one."""
    title = j.claim.title
    return f"[{title}]({cells}#{markdown.anchor(title)})" if j.finding.lines else title


def _count(found: Sequence[Judged]) -> str:
    """How many claims of the paper stand, and how many of ours."""
    ours = [j for j in found if j.claim.section == OWN]
    papers = [j for j in found if j not in ours]
    return (
        f"{THE_PAPER} makes {len(papers)} claims that can be tested here. By the settled reward, "
        f"which leaves out take-off, {_verdicts(j.word for j in papers)} "
        f"([which](#{markdown.anchor(HOLDS)})). By the return of the whole episode, the paper's "
        f"own measure, {_verdicts(j.whole_word for j in papers)}. Of {len(ours)} claims that we "
        f"add, {_verdicts(j.word for j in ours)} by the settled reward."
    )


def _verdicts(words: Iterable[str]) -> str:
    """How many claims have each verdict."""
    counts = Counter(word.strip("*") for word in words)
    return join([f"{n} {'is' if n == 1 else 'are'} {word}" for word, n in counts.items()])


def _by_construction(claim: Claim, so_far: Verdict) -> bool:
    """Whether a supported claim is about what settings fix, and no measurement could refute it."""
    return claim.of == BILLS and so_far is Verdict.SUPPORTED


def _answer(found: Sequence[Judged]) -> list[str]:
    """Which claims stand: a list of verdicts, and below each the claims."""
    given = [j for j in found if _by_construction(j.claim, j.so_far)]
    found = [j for j in found if j not in given]
    undecided = [j for j in found if j.finding.verdict is Verdict.UNDECIDED]
    open_ = {
        f"{verdict.value.capitalize()} so far, with cells still to run": [
            j for j in undecided if j.so_far is verdict
        ]
        for verdict in (Verdict.SUPPORTED, Verdict.REFUTED)
    }
    rest = [j for j in undecided if j.so_far is Verdict.UNDECIDED]
    pooled = [j for j in rest if j.finding.pooled is Verdict.SUPPORTED]
    groups = {
        "Supported": [j for j in found if j.finding.verdict is Verdict.SUPPORTED],
        "Undecided cell by cell, though the mean over all cells speaks for it": pooled,
        **open_,
        "Refuted": [j for j in found if j.finding.verdict is Verdict.REFUTED],
        "Undecided": [j for j in rest if j not in pooled],
        "Not tested": [j for j in found if j.finding.verdict is Verdict.UNTESTED],
        BY_CONSTRUCTION: given,
    }
    lines = []
    for name, own in groups.items():
        if own:
            lines += [f"- **{name}** ({len(own)})", *(f"  - {j.claim.title}" for j in own)]
    return [f"## {HOLDS}", "\n".join(lines)]


def word_of(verdict: Verdict, so_far: Verdict = Verdict.UNDECIDED) -> str:
    """A verdict as Markdown, bold where it refutes; of a part that was run it says "so far"."""
    if verdict is Verdict.UNDECIDED and so_far in (Verdict.SUPPORTED, Verdict.REFUTED):
        return f"{so_far.value} so far"
    return f"**{verdict.value}**" if verdict is Verdict.REFUTED else verdict.value


def _ended(tables: Tables) -> str:
    counts = tables.runs["status"].value_counts().sort_index(ascending=False)
    ended = ", ".join(f"{n} {ENDED[str(status)]}" for status, n in counts.items())
    return f"{len(tables.runs)} runs{f': {ended}' if ended else ''}."
