"""One's own rows beside those of another folder, such as the committed ones of results/paper.

A cell (a task and a team size in one world) can be compared if everything that decides its returns
is the same on both sides: the versions of task and simulator, and the task's settings. The fixed
initial states follow from these. Where both sides have a run of the same method, settings and seed,
such as a parent that was trained again, the other folder's counts.
"""

import dataclasses

from bench.stats.scores import flown_settings
from bench.stats.statistics import Cell, cell_of, records
from bench.store.tables import IDENTITY, Tables


@dataclasses.dataclass(frozen=True)
class Beside:
    """Own rows and those that can be compared with them."""

    tables: Tables
    """Both, in the cells that own runs flew."""
    remarks: tuple[str, ...]
    """What is compared, and what is not and why; a sentence each."""


def beside(own: Tables, others: Tables, name: str) -> Beside:
    """Own tables with the rows of `others`, a folder called `name`, of the same cells."""
    mine, theirs = _cells(own), _cells(others)
    shared = sorted(mine & theirs)
    differing = {cell: text for cell in shared if (text := _difference(own, others, cell))}
    wanted = {cell for cell in shared if cell not in differing}
    chosen = _in_cells(others, wanted)
    joined = _without_large(chosen).merged(_without_large(own))
    kept = set(joined.runs["run"])
    twice = sorted({row["method"] for row in records(own.runs) if row["run"] not in kept})
    remarks = []
    if wanted:
        remarks.append(f"Beside {len(chosen.runs)} runs of {name}, in {_named(sorted(wanted))}.")
    if alone := sorted(mine - theirs):
        remarks.append(f"Nothing of {name} to compare with: {_named(alone)}.")
    remarks += [f"Not comparable: {cell.label}: {text}." for cell, text in differing.items()]
    if twice:
        remarks.append(f"Where both have a run, that of {name} is shown: {', '.join(twice)}.")
    few = _fewest_seeds(own, wanted)
    if wanted and few == 1:
        remarks.append(
            "One seed says what happened once: own rows have a mean but no interval and no rank. "
            "Train the seeds of the others before you claim anything."
        )
    return Beside(joined, tuple(remarks))


def _cells(tables: Tables) -> set[Cell]:
    return {cell_of(row) for row in records(tables.results.drop_duplicates("run"))}


def _difference(own: Tables, others: Tables, cell: Cell) -> str:
    """What of two folders differs in a cell; empty if nothing does."""
    here, there = flown_settings(own, cell), flown_settings(others, cell)
    wrong = [
        f"{key} is {_values(here[key])} here and {_values(there[key])} there"
        for key in sorted(here.keys() & there.keys())
        if here[key] != there[key]
    ]
    return ", ".join(wrong)


def _values(found: set[str]) -> str:
    return " or ".join(sorted(found))


def _in_cells(tables: Tables, cells: set[Cell]) -> Tables:
    """The runs of some cells, failed ones too."""
    of_run = {row["run"]: cell_of(row) in cells for row in records(tables.results)}
    places = {(cell.task, cell.team_size) for cell in cells}
    kept = {
        row["run"]
        for row in records(tables.runs)
        if of_run.get(row["run"], (row["task"], row["team_size"]) in places)
    }
    return tables.of_runs(kept)


def _without_large(tables: Tables) -> Tables:
    """Documents of two folders together have no curves: one of them lacks those of its runs."""
    return dataclasses.replace(
        tables, curves=tables.curves.iloc[:0], trajectories=tables.trajectories.iloc[:0]
    )


def _fewest_seeds(tables: Tables, cells: set[Cell]) -> int:
    rows = tables.results.drop_duplicates("run")
    rows = rows.loc[[cell_of(row) in cells for row in records(rows)]]
    groups = [name for name in IDENTITY if name != "seed"]
    return int(min(rows.groupby(groups)["seed"].nunique(), default=0))


def _named(cells: list[Cell]) -> str:
    return "; ".join(cell.label for cell in cells)
