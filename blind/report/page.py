"""The blind report as Markdown and HTML, from tables alone, on two pages.

The first says what was right, how it was counted and what went wrong; the second has the numbers by
effect, the baselines, and how small effects may be.
"""

import re
from collections.abc import Mapping, Sequence
from pathlib import Path

from bench.report.page import write_both
from bench.text import markdown
from bench.text.pages import read_notes
from blind.report import failures, injected_section, sections
from blind.report import limits_section as limits
from blind.report import next_flight_section as next_flight
from blind.report.in_short import in_short
from blind.report.injected_section import InjectedTables
from blind.report.pictures import write_pictures
from blind.report.tables import Tables

TITLE = "Diagnosis of effects that were withheld"
DETAILS = "Diagnosis of withheld effects, by effect"
INTRODUCTION = (
    "Flights were simulated, most of them with an effect, and the diagnosis was not told which. "
    "Every diagnosis ran in a process "
    "of its own that was given nothing but a folder of flights with a random name; what was done "
    "to the vehicle stood in a separate, salted file whose SHA-256 was printed before the first "
    "diagnosis and checked after the last. The controller flew on the noisy estimates that are "
    "logged, rows come at uneven times and some are missing. Air and loads have equations of the "
    "generator's own; in the reality crazyflow, what changes the vehicle (its mass, thrust, "
    "inertia, motors, battery) changes the same numbers of the same simulator that the diagnosis "
    "has, which tests inference where the model is exact. RotorPy's equations are its own."
)
DECIDABLE = (
    "Kinds of cases: in *single* and *pair*, one or two effects of the library act; in *clean*, "
    "none; in *unknown*, something acts for which the library has no effect; in *excluded*, an "
    "effect of the library acts that the diagnosis was told to leave out. In the last two an "
    "answer is right if it says that something else acts, too; whether it blames an effect all the "
    "same is counted apart. A case is *decidable* if its flights without noise differ, at "
    "the noise that was logged, from the nominal simulator and from every refitted rival by a "
    "chi-square of 25 or more. In an undecidable case an answer is right if it is `none`, or if "
    "the true effect is the named one or among its aliases. For realities with equations of their "
    "own, decidability and Cramér-Rao bounds are computed from the same effects and paths in "
    "crazyflow. Both include the uncertainty that reference flights leave."
)


def write_report(
    found: Sequence[Tables],
    path: Path,
    notes: Path | None = None,
    injected: Sequence[InjectedTables] = (),
) -> Path:
    """The Markdown file that was written; its details, HTML and pictures stand beside it.

    Args:
        found: Tables of one run a reality.
        path: Markdown file to write; the details go to a file of the same name with `_details`.
        notes: Hand-written Markdown. What stands under a heading that is a case's name becomes the
            remark on that failure; the rest is appended.
        injected: Tables of faults that were injected into logs, a run a flight set.
    """
    remarks, rest = _notes(notes)
    details = path.with_name(f"{path.stem}_details.md")
    pictures, drawn = [], []
    for tables in found:
        own = write_pictures(tables, path.with_name(path.stem))
        pictures += [picture for picture, _ in own]
        prefix = f"{tables.run['reality']}_"
        figures = {
            p.stem.removeprefix(prefix): [f"![{text}]({path.stem}/{p.name})", f"*{text}.*"]
            for p, text in own
        }
        drawn.append((tables, figures))

    more = f"By effect and size, and beside baselines: [{DETAILS}]({details.name})."
    answers = [f"# {TITLE}", *in_short(found, injected), more]
    answers += ["## How it was done", INTRODUCTION, DECIDABLE]
    by_effect = [f"# {DETAILS}"]
    by_effect += [f"The [answers]({path.name}) say how the cases were made and counted."]
    for tables, figures in drawn:
        answers += _answers(tables, figures, remarks)
        by_effect += _by_effect(tables, figures)
    if injected:
        answers += [f"## {injected_section.TITLE}", *injected_section.report(injected)]
    answers += rest
    by_effect += injected_section.by_size(injected)
    pages = (path, details)
    write_both(path, "\n\n".join(answers) + "\n", TITLE, pictures, pages)
    write_both(details, "\n\n".join(by_effect) + "\n", DETAILS, pictures, pages)
    return path


Figures = Mapping[str, list[str]]
"""Link and caption of the pictures that there are, by what they show."""


def _answers(tables: Tables, figures: Figures, remarks: Mapping[str, str]) -> list[str]:
    """How many answers are right in one reality, and which are not."""
    return [
        f"## Reality: {markdown.escape(tables.run['reality'])}",
        *sections.facts(tables),
        "### Aims and what was measured",
        *sections.aims(tables),
        *figures.get("aims", []),
        "### Failures, one by one",
        *failures.failures(tables, remarks),
    ]


def _by_effect(tables: Tables, figures: Figures) -> list[str]:
    """Numbers by effect of one reality."""
    return [
        f"## Reality: {markdown.escape(tables.run['reality'])}",
        "### Beside simple baselines",
        *sections.baselines(tables),
        "### Which effects",
        *figures.get("confusion", []),
        *sections.by_effect(tables),
        "### How large",
        *sections.parameters(tables),
        *figures.get("errors", []),
        "### How sure",
        *sections.reliability(tables),
        *figures.get("reliability", []),
        *limits.section(tables, figures.get("limits", [])),
        *next_flight.section(tables, figures.get("next_flight", [])),
    ]


def _notes(path: Path | None) -> tuple[dict[str, str], list[str]]:
    """Remarks by case, and everything else."""
    if path is None:
        return {}, []
    parts = re.split(r"(?m)^#+ *([0-9a-f]{16}) *$", read_notes(path))
    remarks, rest = {}, [parts[0].strip()]
    for name, text in zip(parts[1::2], parts[2::2], strict=True):
        # A remark ends where the next heading begins.
        own, *after = re.split(r"(?m)^(?=#)", text, maxsplit=1)
        remarks[name] = own.strip()
        rest += [part.strip() for part in after]
    return remarks, [part for part in rest if part]
