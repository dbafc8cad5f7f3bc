"""Policies kept beside their tables, one file a cell, and runs restored from them.

    policies/TASK-nN.npz    RUN/000, RUN/001, ...   arrays of the policy, in its pytree's order
                            RUN/structure           how it is made, unless it is the shared one
                            RUN/residual/000, ...   those of its residual, if other runs need it
                            RUN/committed           when the run of the row was committed

Only runs whose row is in the tables are kept. Files from before runs could be restored hold
policies alone.
"""

import dataclasses
import io
import json
import tokenize
import zipfile
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import jax
import numpy as np

from bench.plan.expansion import PACKAGES
from bench.plan.planned_run import Run
from bench.plan.realities import NOMINAL
from bench.store.record import Outcome, UnreadableRunError, policy_of, with_arrays
from bench.store.tables import UNITS, Tables
from bench.text.errors import UsageError
from methods.contract import Ledger, Trained
from methods.residuals.contract import blank
from methods.training.policy import make_policy
from simulators import registry

FOLDER = "policies"
"""Where they are, beside the tables."""
COMMITTED = "committed"
"""Name of the array that says to which row a policy belongs."""
DAMAGE = (
    OSError,
    ValueError,
    IndexError,
    EOFError,
    NotImplementedError,  # a compression that zipfile does not know
    zipfile.BadZipFile,
    zlib.error,
    SyntaxError,  # this one and the next: the header of an array
    tokenize.TokenError,
)
"""What reading a damaged file of policies raises."""
RESIDUAL = "residual"
"""Folder of a residual's arrays."""


class KeptRun(NamedTuple):
    """What is kept of a run."""

    policy: dict[str, np.ndarray]
    """What its policy was stored as, by name (`record.policy_bytes`)."""
    residual: list[np.ndarray]
    """Arrays of the residual; empty if it is not kept."""
    committed: str
    """When the run of the row was committed; empty in older files."""


def path_of(tables_dir: Path, task: str, team_size: int) -> Path:
    """The file of a cell."""
    return Path(tables_dir) / FOLDER / f"{task}-n{team_size}.npz"


def load_kept(path: Path, only: str = "") -> dict[str, KeptRun]:
    """The kept runs of a file, by name of the run; none without the file.

    Args:
        path: The file.
        only: Name of the one run that is wanted; empty: all.

    Raises:
        UsageError: It cannot be read.
    """
    if not path.is_file():
        return {}
    found: dict[str, KeptRun] = {}
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as stored:
            for name in sorted(stored.files):
                run, *rest = name.split("/")
                if only not in ("", run):
                    continue
                kept = found.setdefault(run, KeptRun({}, [], ""))
                if rest == [COMMITTED]:
                    found[run] = kept._replace(committed=str(stored[name]))
                elif rest[0] == RESIDUAL:
                    kept.residual.append(stored[name])
                else:
                    kept.policy["/".join(rest)] = stored[name]
    except DAMAGE as error:
        raise UsageError(f"{path} cannot be read: {error}") from error
    return found


def save_kept(path: Path, kept: Mapping[str, KeptRun]) -> None:
    """Writes a file whole or not at all; the same bytes for the same content."""
    path.parent.mkdir(parents=True, exist_ok=True)
    named: dict[str, Any] = {}
    for run, own in sorted(kept.items()):
        named |= {f"{run}/{name}": x for name, x in sorted(own.policy.items())}
        named |= {f"{run}/{RESIDUAL}/{i:03d}": x for i, x in enumerate(own.residual)}
        if own.committed:
            named[f"{run}/{COMMITTED}"] = np.asarray(own.committed)
    content = io.BytesIO()
    np.savez_compressed(content, allow_pickle=False, **named)
    part = path.with_name(f".{path.name}.part")
    part.write_bytes(content.getvalue())
    part.replace(path)


def restorer(
    folders: Sequence[Path], recorded: Tables, warn: Callable[[str], None]
) -> Callable[[Run], Outcome | None]:
    """What gives the outcome that a finished run left, as a store can commit; None for none.

    It comes from the row of the run and its kept policy. Its residual is missing where the file
    does not hold it.

    Args:
        folders: Folders of tables; the first that kept a run counts.
        recorded: The rows of the runs.
        warn: Called with a line on each kept run that cannot be used.
    """
    found: dict[str, Outcome | None] = {}

    def restored(run: Run) -> Outcome | None:
        if run.name not in found:
            try:
                found[run.name] = _restored(run, folders, recorded)
            except (UsageError, UnreadableRunError) as error:
                found[run.name] = None
                warn(f"{run.name} cannot be restored from its kept policy: {error}")
        return found[run.name]

    return restored


def _restored(run: Run, folders: Sequence[Path], recorded: Tables) -> Outcome | None:
    rows = recorded.runs.loc[recorded.runs["run"].eq(run.name)]
    if run.variant or len(rows) != 1:
        return None
    row: dict[str, Any] = rows.iloc[0].to_dict()
    if row["key"] != run.key or row["status"] == "failed":
        return None
    for folder in folders:
        path = path_of(folder, run.task, run.team_size)
        own = load_kept(path, run.name).get(run.name)
        # A policy with another time belongs to a row that has been replaced.
        if own is not None and own.committed in ("", row["committed"]):
            return _outcome(run, own, row, recorded, path)
    return None


def _outcome(
    run: Run, own: KeptRun, row: Mapping[str, Any], recorded: Tables, path: Path
) -> Outcome:
    """The outcome that a row, its curves, its trajectory and its kept arrays stand for."""
    task = registry.load("task", run.task)(n_drones=run.team_size)
    nominal = registry.load("simulator", NOMINAL)()
    template = make_policy(task, nominal.spec, nominal.action_space, jax.random.key(0))
    residual, where = None, f"{run.name} in {path.name}"
    if own.residual:
        residual = blank(registry.load("residual", run.residual)())
        residual = with_arrays(residual, own.residual, f"the residual of {where}")
    rows, metrics = recorded.of_runs([run.name]), recorded.metrics(run.name)
    trained = Trained(
        policy=policy_of(own.policy, template, where),
        ledger=_ledger(metrics, int(rows.results["calibration_flights"].iloc[0])),
        curves={},
        status=row["status"],
        residual=residual,
        notes={
            name: value
            for name, value in metrics.items()
            if name not in UNITS or name == "training_reward"
        },
    )
    return Outcome(
        status=row["status"],
        trained=trained,
        trained_effects=rows.results["trained_effects"].iloc[0],
        metrics=metrics,
        curves=rows.curves,
        trajectory=rows.trajectories,
        origin=_origin(row),
    )


def _ledger(metrics: Mapping[str, float], flights: int) -> Ledger:
    """The ledger of a run from its row; rounding to 1 us undoes the conversion to minutes."""
    fields = (field for field in dataclasses.fields(Ledger) if field.name in UNITS)
    kinds: dict[str, Any] = {field.name: type(field.default) for field in fields}
    return Ledger(
        hf_fleet_seconds=round(60.0 * metrics["fleet_minutes"], 6),
        calibration_flights=flights,
        **{name: kind(metrics.get(name, 0)) for name, kind in kinds.items()},
    )


def _origin(row: Mapping[str, Any]) -> dict[str, Any]:
    """What run.json says of where the run comes from: what its row says, not this process."""
    versions = json.loads(row["versions"])
    columns = ("commit", "dirty", "machine", "device")
    return {
        "provenance": {name: row[name] for name in columns} | {"dirty": bool(row["dirty"])},
        "program": row["program"],
        "committed": row["committed"],
        "sources": {},
        "packages": {name: versions[name] for name in PACKAGES if name in versions},
    }
