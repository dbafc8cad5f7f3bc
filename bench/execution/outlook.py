"""`bench plan`: the runs of a suite, which of them exist, and what the missing ones will cost."""

from collections import Counter
from collections.abc import Iterable, Sequence
from pathlib import Path

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from bench.execution.executor import usual_jobs
from bench.execution.sweep import recorded_tables
from bench.plan.expansion import Plan
from bench.stats.forecast import (
    BASES,
    Guess,
    Past,
    guess,
    longest_chain,
    past_of_states,
    past_of_tables,
)
from bench.stats.statistics import Entry
from bench.store.kept import restorer
from bench.store.missing import State, states
from bench.store.resume import make_standing
from bench.store.reuse import reusable
from bench.store.store import Store
from bench.store.tables import TableError, Tables
from bench.text.numbers import number, seconds
from bench.text.say import say

NAMED = 3
"""Most runs that are named for one reason."""
TRAINED_AGAIN = "trained again, because others start from their lost policies"
"""Why a finished run is to do."""


def show_plan(
    name: str,
    plan: Plan,
    tables_dir: Path,
    jobs: int | None,
    every: bool,
    console: Console,
    retry_failed: bool = False,
    reuse: Sequence[Path] = (),
) -> int:
    """Prints the outlook; exit status 0, or 1 if a plug-in is broken.

    Options as in `bench plan`.
    """
    recorded = recorded_tables(tables_dir).merged(reusable(plan, reuse))
    store = Store(tables_dir)
    found = states(plan.runs, store, recorded)
    failed = set() if retry_failed else _failed(found)
    kept = restorer([tables_dir, *reuse], recorded, lambda text: say(console, f"Warning: {text}"))
    sound = {r.name: content for r in plan.runs if (content := store.content(r.name)) is not None}
    again = make_standing(plan, sound, recorded, retry_failed, kept=kept).again
    found = [s._replace(reason=TRAINED_AGAIN) if s.run in again else s for s in found]
    missing = [state for state in found if state.reason and state.run.name not in failed]
    past = {p.run: p for p in [*past_rows(tables_dir, console), *past_of_states(found)]}
    guesses = {s.run.name: guess(s.run, past.values()) for s in missing}
    n_finished = sum(not state.reason for state in found)
    say(
        console,
        f"Suite '{name}': {len(found)} runs, {n_finished} finished in {tables_dir}, "
        f"{len(missing)} to do.",
    )
    for line in plan.broken:
        say(console, f"Left out: {line}")
    if line := own_rows(plan, recorded):
        say(console, line)
    if failed:
        say(
            console,
            f"{len(failed)} failed earlier, or start from one that did; --retry-failed tries them "
            "again.",
        )
    console.print(_table(found, guesses))
    for line in reasons(state for state in found if state.reason):
        say(console, line)
    for line in expectations(missing, guesses, jobs or usual_jobs(), len(past)):
        say(console, line)
    if every:
        for state in missing:
            say(console, f"  {state.run.label}: {state.reason}; {_cost(guesses[state.run.name])}")
    return 1 if plan.broken else 0


def own_rows(plan: Plan, recorded: Tables) -> str:
    """How many rows of a plan this program made, as text; empty without rows."""
    programs = recorded.column("program")
    own = [run for run in plan.runs if run.name in programs]
    same = sum(programs[run.name] == run.program for run in own)
    return f"{same} of {len(own)} rows are of this program." if own else ""


def _failed(found: Iterable[State]) -> set[str]:
    """Names of runs that `bench run` leaves alone, and of those that start from them."""
    names: set[str] = set()
    for state in found:  # parents before their children
        if state.failed or (state.reason and names & set(state.run.parents.values())):
            names.add(state.run.name)
    return names


def past_rows(tables_dir: Path, console: Console) -> list[Past]:
    """Costs of past runs in a folder's tables and in `results/`; unreadable tables are named."""
    folders = {tables_dir.resolve(), *(path.resolve() for path in Path("results").glob("*"))}
    found = []
    for folder in sorted(folders):
        if (folder / "results.parquet").is_file():
            try:
                found += past_of_tables(Tables.load(folder))
            except TableError as error:
                say(console, f"Past rows left out: {error}")
    return found


def reasons(missing: Iterable[State]) -> list[str]:
    """A line for each reason, the most frequent first, with some of the runs."""
    by_reason: dict[str, list[str]] = {}
    for state in missing:
        by_reason.setdefault(state.reason, []).append(state.run.label)
    lines = []
    for reason, labels in sorted(by_reason.items(), key=lambda item: (-len(item[1]), item[0])):
        more = f", and {len(labels) - NAMED} more" if len(labels) > NAMED else ""
        lines.append(f"{len(labels)} {reason}: {', '.join(labels[:NAMED])}{more}.")
    return lines


def expectations(
    missing: list[State], guesses: dict[str, Guess | None], jobs: int, n_past: int
) -> list[str]:
    """What the missing runs will cost, and what that is based on."""
    if not missing:
        return ["Nothing to do."]
    known = {name: found for name, found in guesses.items() if found is not None}
    times = {name: found.seconds for name, found in known.items()}
    total, chain = sum(times.values()), longest_chain((s.run for s in missing), times)
    minutes = sum(found.minutes for found in known.values())
    used = Counter(found.basis for found in known.values())
    lines = []
    if known:
        lines.append(
            f"Expected: {number(minutes, 0)} HF fleet-minutes and {seconds(total)} of training, "
            f"{seconds(max(total / jobs, chain))} on {jobs} worker{'s' * (jobs > 1)}; this "
            "includes compilation, but not evaluation."
        )
    parts = [f"{used[basis]} from the {basis}".replace("the other", "another") for basis in BASES]
    parts = [part for part, basis in zip(parts, BASES, strict=True) if used[basis]]
    if idle := used["no training"]:
        parts.append(f"{idle} that train nothing")
    if unknown := len(missing) - len(known):
        parts.append(f"{unknown} unknown, because no past run is like them")
    lines.append(f"The estimate rests on {n_past} past runs: {', '.join(parts)}.")
    return lines


def _table(found: list[State], guesses: dict[str, Guess | None]) -> Table:
    """A line for each entry."""
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    headings = ("method", "finished", "missing", "HF fleet-minutes", "training time")
    for heading in headings:
        table.add_column(heading, justify="left" if heading == "method" else "right")
    by_entry: dict[str, list[State]] = {}
    for state in found:
        run = state.run
        by_entry.setdefault(Entry(run.method, run.residual, run.variant).label, []).append(state)
    for label, own in by_entry.items():
        missing = [state for state in own if state.run.name in guesses]
        known = [g for s in missing if (g := guesses[s.run.name]) is not None]
        costs = (number(sum(g.minutes for g in known), 0), seconds(sum(g.seconds for g in known)))
        costs = costs if len(known) == len(missing) else tuple(f"{c} + ?" for c in costs)
        counts = (str(sum(not state.reason for state in own)), str(len(missing)))
        table.add_row(*(Text(text) for text in (label, *counts, *costs)))
    return table


def _cost(found: Guess | None) -> str:
    if found is None:
        return "cost unknown"
    return f"{number(found.minutes, 0)} fleet-minutes, {seconds(found.seconds)} ({found.basis})"
