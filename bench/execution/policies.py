"""Trained policies kept beside their tables, one file a cell, and flown again from there.

Rows of default settings in the undisturbed simulator are kept: others can be trained from them. A
run that is kept stays as it is unless its row was replaced. Residuals are large, so that only those
are kept from which a built-in suite trains other runs (`bench/store/kept.py`).
"""

import dataclasses
from collections.abc import Iterable
from pathlib import Path

import jax
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from bench.plan.expansion import expand
from bench.plan.planned_run import REALITY
from bench.plan.realities import NOMINAL, parse_reality
from bench.plan.settings import build
from bench.plan.suite import built_in, load_suite
from bench.stats.statistics import cell_of, entry_of, estimate, records
from bench.store.kept import RESIDUAL, KeptRun, load_kept, path_of, save_kept
from bench.store.record import UnreadableRunError, policy_of
from bench.store.resume import reproduces, resumed_names
from bench.store.store import Store
from bench.store.tables import Tables
from bench.text.errors import UsageError
from bench.text.numbers import number
from bench.text.say import say
from methods.training.evaluate import evaluate
from methods.training.policy import AbstractPolicy, PolicyController, make_policy
from simulators import registry
from tasks.contract import AbstractTask


def keep(tables_dir: Path, tasks: Iterable[str], team_sizes: Iterable[int]) -> dict[Path, int]:
    """Keeps the policies of runs whose folder still exists; returns the number in each file.

    Args:
        tables_dir: Folder of the tables and of `runs/`.
        tasks: Tasks whose cells are kept; none: all.
        team_sizes: Team sizes, likewise.

    Raises:
        TableError: There are no tables.
    """
    tables, store = Tables.load(tables_dir), Store(tables_dir)
    chosen, sizes, resumed = {*tasks}, {*team_sizes}, runs_to_resume()
    committed = tables.column("committed")
    kept: dict[Path, dict[str, KeptRun]] = {}
    for row in records(tables.results.drop_duplicates("run")):
        cell, run = cell_of(row), row["run"]
        meant = cell.task in (chosen or {cell.task}) and cell.team_size in (
            sizes or {cell.team_size}
        )
        if row["variant"] or cell.deployed_effects or not meant:
            continue
        path = path_of(tables_dir, cell.task, cell.team_size)
        own = kept.setdefault(path, load_kept(path))
        there = own.get(run)
        if there and there.committed == committed[run] and (there.residual or run not in resumed):
            continue
        if store.status(run) in ("", "failed"):
            continue
        if not reproduces(store.metrics(run), tables.metrics(run)):  # else it is not that row's run
            residual = [*store.arrays(run, RESIDUAL).values()] if run in resumed else []
            own[run] = KeptRun(store.arrays(run, "policy"), residual, committed[run])
    for path, own in kept.items():
        if own:
            save_kept(path, own)
    return {path: len(own) for path, own in kept.items() if own}


def runs_to_resume() -> set[str]:
    """Names of the runs whose residual other runs of a built-in suite start from."""
    found = set()
    for suite in map(load_suite, built_in()):
        rows = tuple(row for row in suite.methods if _resumes(row.method))
        if rows:
            found |= resumed_names(expand(dataclasses.replace(suite, methods=rows)).runs)
    return found


def _resumes(method: str) -> bool:
    """Whether a method or one of its parents starts from the residual of another run."""
    cls = registry.load("method", method)
    return bool(cls.resumes_from) or any(map(_resumes, cls.parents))


def kept_policy(tables_dir: Path, task: AbstractTask, name: str, run: str) -> AbstractPolicy:
    """The kept policy of the run called `run`, for a task that is registered as `name`.

    Raises:
        UsageError: No policy of the run is kept, or it has another shape.
    """
    path = path_of(tables_dir, name, task.n_drones)
    found = load_kept(path, run)
    if run not in found:
        raise UsageError(f"{path} holds no policy of {run}. `bench keep {tables_dir}` adds them.")
    nominal = registry.load("simulator", NOMINAL)()
    template = make_policy(task, nominal.spec, nominal.action_space, jax.random.key(0))
    try:
        return policy_of(found[run].policy, template, f"{run} in {path.name}")
    except UnreadableRunError as error:
        raise UsageError(str(error)) from error


def deploy(
    tables_dir: Path,
    name: str,
    team_size: int,
    reality: str,
    methods: Iterable[str],
    console: Console,
) -> int:
    """Flies the kept policies of a cell in `reality` and shows their rewards there.

    Raises:
        UsageError: No policy of that cell is kept, or the reality is not understood.
    """
    tables, world = Tables.load(tables_dir), parse_reality(reality or REALITY)
    task = build(registry.load("task", name), {}, f"Task '{name}'", n_drones=team_size)
    path = path_of(tables_dir, name, team_size)
    kept = load_kept(path)
    chosen = {*methods}
    rows = [r for r in records(tables.runs) if r["run"] in kept]
    rows = [r for r in rows if not chosen or r["method"] in chosen]
    for row in [r for r in rows if kept[r["run"]].committed not in ("", r["committed"])]:
        say(console, f"Left out: the row of {row['run']} was made after its policy was kept.")
        rows.remove(row)
    if not rows:
        raise UsageError(
            f"{path} holds no policy of these methods. `bench keep {tables_dir}` adds policies of "
            "rows with default settings whose runs are still there."
        )
    found: dict[str, list[tuple[float, float, float]]] = {}
    for row in rows:
        policy = kept_policy(tables_dir, task, name, row["run"])
        flown = evaluate(task, world, PolicyController(task, policy), int(row["seed"]))
        numbers = (flown.settled_reward, flown.reward, flown.crashes)
        found.setdefault(entry_of(row).label, []).append(numbers)
        say(console, f"{row['run']}: settled reward {number(numbers[0], 2)}")
    table = Table(box=SIMPLE_HEAD, padding=(0, 1, 0, 0), show_edge=False)
    for heading in ("method", "seeds", "settled reward", "reward", "crashes per episode"):
        table.add_column(heading, justify="left" if heading == "method" else "right")
    means = {
        label: [estimate(column).mean for column in zip(*own, strict=True)]
        for label, own in found.items()
    }
    for label in sorted(found, key=lambda label: -means[label][0]):
        texts = (number(x, d) for x, d in zip(means[label], (2, 1, 2), strict=True))
        table.add_row(Text(label), str(len(found[label])), *texts)
    console.print(table)
    return 0
