"""Trained policies kept beside their tables, one file a cell, and flown again from there.

`policies/TASK-nN.npz` holds the arrays of every kept run of a cell as RUN/INDEX, in the order of
the policy's pytree, and RUN/structure where it is not the shared policy. Only runs whose row is in
the tables are kept, and a run that is kept stays as it is. Rows of default settings in the
undisturbed simulator are kept: others can be trained from them.
"""

import io
from collections.abc import Iterable
from pathlib import Path

import jax
import numpy as np
from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from bench.plan.expansion import NOMINAL, REALITY
from bench.plan.realities import parse_reality
from bench.stats.statistics import cell_of, entry_of, estimate, records
from bench.store.record import UnreadableRunError, policy_of
from bench.store.store import Store
from bench.store.tables import Tables
from bench.text.errors import UsageError
from bench.text.numbers import number
from bench.text.say import say
from methods.policy import AbstractPolicy, PolicyController, make_policy
from methods.training.evaluate import evaluate
from simulators import registry
from tasks.contract import AbstractTask

FOLDER = "policies"
"""Where they are, beside the tables."""
Kept = dict[str, dict[str, np.ndarray]]
"""By run, what its policy was stored as, by name."""


def path_of(tables_dir: Path, task: str, team_size: int) -> Path:
    """The file of a cell."""
    return Path(tables_dir) / FOLDER / f"{task}-n{team_size}.npz"


def load_kept(path: Path) -> Kept:
    """What a file holds, nothing where there is none.

    Raises:
        UsageError: It cannot be read.
    """
    if not path.is_file():
        return {}
    found: Kept = {}
    try:
        with np.load(path, allow_pickle=False) as stored:
            for name in sorted(stored.files):
                run, _, entry = name.rpartition("/")
                found.setdefault(run, {})[entry] = stored[name]
    except (OSError, ValueError) as error:
        raise UsageError(f"{path} cannot be read: {error}") from error
    return found


def keep(tables_dir: Path, tasks: Iterable[str], team_sizes: Iterable[int]) -> dict[Path, int]:
    """Adds policies whose run's folder is there to the files; how many each file holds now.

    Args:
        tables_dir: Folder of the tables and of `runs/`.
        tasks: Tasks whose cells are kept; none: all.
        team_sizes: Team sizes, likewise.

    Raises:
        TableError: There are no tables.
    """
    tables, store = Tables.load(tables_dir), Store(tables_dir)
    chosen, sizes = {*tasks}, {*team_sizes}
    kept: dict[Path, Kept] = {}
    for row in records(tables.results.drop_duplicates("run")):
        cell = cell_of(row)
        meant = cell.task in (chosen or {cell.task}) and cell.team_size in (
            sizes or {cell.team_size}
        )
        if row["variant"] or cell.deployed_effects or not meant:
            continue
        path = path_of(tables_dir, cell.task, cell.team_size)
        own = kept.setdefault(path, load_kept(path))
        if row["run"] not in own and store.status(row["run"]) not in ("", "failed"):
            with np.load(store.runs / row["run"] / "policy.npz", allow_pickle=False) as stored:
                own[row["run"]] = {name: stored[name] for name in sorted(stored.files)}
    for path, own in kept.items():
        if own:
            _write(path, own)
    return {path: len(own) for path, own in kept.items() if own}


def kept_policy(tables_dir: Path, task: AbstractTask, name: str, run: str) -> AbstractPolicy:
    """The policy of a run; `name` is that of the task.

    Raises:
        UsageError: It is not kept, or is of another shape.
    """
    path = path_of(tables_dir, name, task.n_drones)
    found = load_kept(path)
    if run not in found:
        raise UsageError(f"{path} holds no policy of {run}. `bench keep {tables_dir}` adds them.")
    nominal = registry.load("simulator", NOMINAL)()
    template = make_policy(task, nominal.spec, nominal.action_space, jax.random.key(0))
    try:
        return policy_of(found[run], template, f"{run} in {path.name}")
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
    """Flies the kept policies of a cell in `reality` and shows what they are worth there.

    Raises:
        UsageError: Nothing of that cell is kept, or the reality is not understood.
    """
    tables, world = Tables.load(tables_dir), parse_reality(reality or REALITY)
    task = registry.load("task", name)(n_drones=team_size)
    path = path_of(tables_dir, name, team_size)
    kept = load_kept(path)
    rows = [r for r in records(tables.runs) if r["run"] in kept]
    rows = [r for r in rows if not (chosen := {*methods}) or r["method"] in chosen]
    if not rows:
        raise UsageError(f"{path} holds no such policy; `bench keep {tables_dir}` adds them.")
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


def _write(path: Path, kept: Kept) -> None:
    """A file whole or not at all; the same bytes for the same content."""
    path.parent.mkdir(parents=True, exist_ok=True)
    named = {f"{run}/{name}": kept[run][name] for run in sorted(kept) for name in sorted(kept[run])}
    content = io.BytesIO()
    np.savez_compressed(content, allow_pickle=False, **named)
    part = path.with_name(f".{path.name}.part")
    part.write_bytes(content.getvalue())
    part.replace(path)
