"""Injected faults as tables that are kept, and the section of the report on them."""

import dataclasses
import json
import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pandas as pd

from bench.report.page import write_both
from bench.stats.statistics import records
from bench.text import markdown
from bench.text.numbers import MISSING, percent
from blind.draw.injected import NOTHING
from blind.report.sections import several_programs
from blind.report.tables import load_tables, save_tables
from blind.score.injected import power, shares
from blind.score.scoring import proportion

TITLE = "Diagnosis of faults that were injected into logs"
METHOD = (
    "Every case splits the flights of a set at random into two halves. One half gets a fault: "
    "its columns are changed by arithmetic, such that they are what a vehicle, a clock or a "
    "logger with this fault would have logged. A quarter of the cases get no fault. Each "
    "diagnosis runs in a process of its own that is given folders of flights with a random "
    "name; files of flights keep theirs, which the diagnosis does not read. What was done stands "
    "in a salted file whose SHA-256 was printed before the first "
    "diagnosis and checked after the last. Halves of one set are not independent: they share "
    "their flights, so that intervals are those of more draws from these flights, not of other "
    "vehicles."
)
WORDS = (
    "*Found*: the verdict is neither `none` nor `too_few`, or a part of the logs is said to "
    "be wrong, or the logs are refused with a reason. *Named*: the answer blames an effect that "
    "describes the fault, or an effect that these flights cannot tell from it, or it says that "
    "the part of the logs is wrong that has the fault. *Wrong effect*: the answer blames "
    "effects, and none of them describes the fault. Undisturbed cases with the verdict `too_few` "
    "could raise no alarm and are not among those that did not. Intervals are 95 %, Clopper and "
    "Pearson's."
)
FRAMES = ("cases", "numbers")
"""Tables by file name."""


@dataclasses.dataclass(frozen=True)
class InjectedTables:
    """All tables of one run."""

    cases: pd.DataFrame
    """One row a case."""
    numbers: pd.DataFrame
    """One row a compared number of a right answer."""
    run: dict[str, Any]
    """What was drawn, and the SHA-256 of the labels."""

    def save(self, directory: Path) -> None:
        """Writes them all."""
        save_tables(directory, {name: getattr(self, name) for name in FRAMES}, run=self.run)

    @classmethod
    def load(cls, directory: Path) -> "InjectedTables":
        """What `save` wrote.

        Raises:
            UsageError: A table is missing or cannot be read.
        """
        return cls(**load_tables(directory, FRAMES, ("run",)))


def is_injected(directory: Path) -> bool:
    """Whether the tables in a folder are those of injected faults."""
    return all((directory / f"{name}.parquet").is_file() for name in FRAMES)


def report(runs: Sequence[InjectedTables]) -> list[str]:
    """What holds for all runs, and then the section of each."""
    return [METHOD, WORDS, *(part for tables in runs for part in section(tables))]


def section(tables: InjectedTables) -> list[str]:
    """The section of one run."""
    return [
        f"## Injected into: {markdown.escape(tables.run['injected'])}",
        *_facts(tables),
        "### False alarms and intervals",
        _shares(tables),
        "### Cases that were not answered rightly",
        _wrong(tables),
    ]


def by_size(runs: Sequence[InjectedTables]) -> list[str]:
    """How often faults were found and named, by size."""
    parts = []
    for tables in runs:
        heading = f"## Faults injected into {markdown.escape(tables.run['injected'])}, by size"
        parts += [heading, _power(tables)]
    return parts


def write_injected(tables: InjectedTables, path: Path) -> Path:
    """The Markdown file that was written; HTML stands beside it."""
    text = "\n\n".join([f"# {TITLE}", *report([tables]), *by_size([tables])]) + "\n"
    write_both(path, text, TITLE)
    return path


def _facts(tables: InjectedTables) -> list[str]:
    run, cases = tables.run, tables.cases
    quiet = sum(row["fault"] == NOTHING for row in records(cases))
    drawn = "of the operating system" if run["seed"] is None else f"{run['seed']}"
    beside = (
        "The half with the fault is diagnosed beside the other one (`--reference`)."
        if run["reference"]
        else "The half with the fault is diagnosed by itself; the other half is not used."
    )
    return [
        f"{beside} {len(cases)} cases of {run['flights']} flights, {quiet} of them undisturbed, "
        f"drawn {run['started']} with the seed {drawn}. SHA-256 of the labels: "
        f"`{run['sha256']}`. A diagnosis took {cases['seconds'].median():.0f} s in the median and "
        f"{cases['seconds'].max():.0f} s at most. Program {run['sources'][0][:12]}.",
        *several_programs(run),
    ]


def _power(tables: InjectedTables) -> str:
    order = {name: i for i, name in enumerate(("small", "medium", "large", "whole"))}
    rows = sorted(records(power(tables.cases)), key=lambda r: (r["fault"], order[r["size"]]))
    described = tables.run["described"]
    shown = [
        (
            markdown.escape(row["fault"]),
            f"{row['size']} ({_sizes(tables.cases, row)})" if row["size"] != "whole" else "whole",
            str(row["n"]),
            _share(row, "found"),
            _share(row, "named") if row["fault"] in described else "nothing describes it",
            str(row["misled"]),
            str(row["refused"]),
        )
        for row in rows
    ]
    headings = ("fault", "size", "cases", "found", "named", "wrong effect", "refused")
    return markdown.table(headings, shown, (0, 1)) if shown else "No case had a fault."


def _sizes(cases: pd.DataFrame, row: dict[str, Any]) -> str:
    """The sizes that were drawn, without signs and directions."""
    mine = cases.loc[(cases["fault"] == row["fault"]) & (cases["size"] == row["size"])]
    drawn = {
        f"{math.hypot(*json.loads(text).values()):.3g}" for text in mine["parameters"].tolist()
    }
    return ", ".join(sorted(drawn))


def _share(row: dict[str, Any], name: str) -> str:
    return proportion(row[name], row["n"]).text()


def _shares(tables: InjectedTables) -> str:
    rows = [
        (
            row["score"],
            f"{row['hits']}/{row['n']}",
            percent(row["value"], 1),
            proportion(row["hits"], row["n"]).interval(1) if row["n"] else MISSING,
        )
        for row in records(shares(tables.cases, tables.numbers))
    ]
    return markdown.table(("what", "hits", "measured", "95 % interval"), rows)


def _wrong(tables: InjectedTables) -> str:
    described = set(tables.run["described"])
    rows = [
        (
            row["case"],
            markdown.escape(row["fault"]),
            markdown.escape(_parameters(row["parameters"])),
            row["verdict"],
            markdown.escape(row["answer"] or row["interface"] or row["cause"] or MISSING),
        )
        for row in records(tables.cases)
        if _is_wrong(row, described)
    ]
    if not rows:
        return "None."
    headings = ("case", "fault", "its numbers [SI]", "verdict", "said")
    return markdown.table(headings, rows, (0, 1, 2, 3, 4))


def _is_wrong(row: dict[str, Any], described: set[str]) -> bool:
    if row["fault"] == NOTHING:
        return bool(row["found"]) or row["status"] != "ok"
    wanted = row["named"] if row["fault"] in described else row["found"]
    return bool(row["misled"]) or not (wanted or row["refused"])


def _parameters(text: str) -> str:
    return ", ".join(f"{name} {value:.3g}" for name, value in json.loads(text).items()) or MISSING
