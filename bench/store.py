"""Keeps finished runs: one immutable folder each, written whole or not at all.

    runs/<run>/run.json            what it is, how it ended, its ledger, checksums of the rest
               metrics.json        metric -> value
               curves.parquet      training history
               trajectory.parquet  first evaluation episode
               policy.npz          arrays of the policy, in the order of its pytree
               residual.npz        the same of the residual, where there is one

A folder is written beside its place, flushed to disk and renamed. One that cannot be read, or whose
files do not match their checksums, is moved to `runs/.quarantine`. Nothing is pickled.
"""

import dataclasses
import hashlib
import json
import os
import shutil
import uuid
import zipfile
from collections.abc import Callable, Collection, Mapping
from pathlib import Path

import equinox as eqx
import filelock
import jax
import numpy as np
import pandas as pd

from bench.plan import REALITY, Run, packages
from bench.settings import describe_fields
from bench.tables import IDENTITY, STATUSES, Tables, results_rows, runs_row, stack, table
from methods.contract import Ledger, Trained
from methods.policy import Policy

FILES = ("metrics.json", "curves.parquet", "trajectory.parquet", "policy.npz")
"""What the folder of a trained run holds beside run.json."""


class UnreadableRunError(ValueError):
    """A run's folder that is damaged or is not what its name says."""


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What a run left; a failed one has only its status and cause."""

    status: str
    """`ok`, `failed`, `diverged` or `budget`."""
    cause: str = ""
    """One line that says why it failed."""
    details: str = ""
    """Traceback of a failure."""
    trained: Trained | None = None
    """Policy, ledger, residual, notes."""
    metrics: Mapping[str, float] = dataclasses.field(default_factory=dict)
    """Metric -> value."""
    curves: pd.DataFrame | None = None
    """Rows of the table `curves`."""
    trajectory: pd.DataFrame | None = None
    """Rows of the table `trajectories`."""


class Store:
    """The runs under one directory of results."""

    def __init__(self, directory: Path) -> None:
        """Nothing is written before the first commit or lock."""
        self.directory = Path(directory).absolute()
        self.runs = self.directory / "runs"

    def lock(self, waiting: Callable[[], None]) -> filelock.FileLock:
        """The acquired lock of this directory; calls `waiting` once if another process has it."""
        self.runs.mkdir(parents=True, exist_ok=True)
        lock = filelock.FileLock(self.runs / ".lock")
        try:
            lock.acquire(timeout=0)
        except filelock.Timeout:
            waiting()
            lock.acquire()
        return lock

    def commit(self, run: Run, outcome: Outcome) -> None:
        """Puts a run's folder in place, instead of a failed attempt's if there is one."""
        part = self.runs / f".part-{run.name}-{uuid.uuid4().hex[:8]}"
        part.mkdir(parents=True)
        try:
            _write(part, run, outcome)
            place = self.runs / run.name
            if place.exists():
                old = self.runs / f".part-{uuid.uuid4().hex[:8]}"
                place.rename(old)
                part.rename(place)
                shutil.rmtree(old)
            else:
                part.rename(place)
            _flush(self.runs)
        finally:
            shutil.rmtree(part, ignore_errors=True)

    def tidy(self) -> None:
        """Removes what interrupted commits left; only for the holder of the lock."""
        for left in self.runs.glob(".part-*"):
            shutil.rmtree(left)

    def names(self) -> list[str]:
        """Names of all runs in place."""
        if not self.runs.is_dir():
            return []
        return sorted(p.name for p in self.runs.iterdir() if not p.name.startswith("."))

    def read(self, name: str) -> dict:
        """Content of run.json, after a check of everything in the folder.

        Raises:
            UnreadableRunError: Something in the folder is missing or damaged.
        """
        folder = self.runs / name
        try:
            content = json.loads((folder / "run.json").read_text(encoding="utf-8"))
            if content["run"] != name or not name.endswith(content["key"][:10]):
                raise UnreadableRunError(f"run.json is that of '{content['run']}'")
            if content["status"] not in STATUSES:
                raise UnreadableRunError(f"run.json has the status '{content['status']}'")
            needed = () if content["status"] == "failed" else FILES
            for file in {*needed, *content["files"]}:
                if content["files"].get(file) != _checksum(folder / file):
                    raise UnreadableRunError(f"{file} is not as it was written")
        except OSError as error:
            reason = f"{Path(error.filename or '').name}: {error.strerror}"
            raise UnreadableRunError(reason) from error
        except (KeyError, TypeError, AttributeError, json.JSONDecodeError) as error:
            raise UnreadableRunError(f"run.json is not that of a run ({error})") from error
        except UnicodeDecodeError as error:
            raise UnreadableRunError("run.json is not text") from error
        return content

    def sound(self, warn: Callable[[str], None]) -> dict[str, dict]:
        """Content of run.json of every sound run, by name; others are put in quarantine."""
        found = {}
        for name in self.names():
            try:
                found[name] = self.read(name)
            except UnreadableRunError as error:
                self.quarantine(name)
                warn(f"Run {name} cannot be used: {error}. It is now in runs/.quarantine.")
        return found

    def quarantine(self, name: str) -> None:
        """Moves a run out of the way, never over an earlier one."""
        place = self.runs / ".quarantine" / f"{name}-{uuid.uuid4().hex[:8]}"
        place.parent.mkdir(exist_ok=True)
        (self.runs / name).rename(place)

    def metrics(self, name: str) -> dict[str, float]:
        """Metric -> value; NaN where a number was not finite."""
        content = json.loads((self.runs / name / "metrics.json").read_text(encoding="utf-8"))
        return {metric: _number(value) for metric, value in content.items()}

    def frame(self, name: str, file: str) -> pd.DataFrame:
        """A run's `curves` or `trajectory`."""
        return pd.read_parquet(self.runs / name / f"{file}.parquet")

    def tables(self, sound: Mapping[str, dict], current: Collection[str]) -> Tables:
        """The tables of all runs in `sound`.

        Where several runs are of the same method, variant, task, team size and seed (because a
        version or default has changed), the one among `current` counts, else the latest.
        """
        chosen = {}
        for content in sorted(
            sound.values(), key=lambda c: (c["run"] in current, c["committed"], c["run"])
        ):
            chosen[tuple(content[column] for column in IDENTITY)] = content
        contents = sorted(chosen.values(), key=lambda c: c["run"])
        trained = [c for c in contents if c["status"] != "failed"]
        results = [row for c in trained for row in results_rows(c, self.metrics(c["run"]))]
        return Tables(
            results=table("results", results),
            curves=stack("curves", [self.frame(c["run"], "curves") for c in trained]),
            trajectories=stack(
                "trajectories", [self.frame(c["run"], "trajectory") for c in trained]
            ),
            runs=table("runs", [runs_row(c) for c in contents]),
        )

    def trained(self, name: str, template: Policy) -> Trained:
        """What a run trained, its policy in the structure of `template`; without the residual.

        Raises:
            UnreadableRunError: The run is damaged, has failed, or has another kind of policy.
        """
        content = self.read(name)
        if content["status"] == "failed":
            raise UnreadableRunError(f"{name} failed: {content['cause']}")
        curves = self.frame(name, "curves").drop(columns=["run", "epoch"])
        return Trained(
            policy=_load_arrays(self.runs / name / "policy.npz", template),
            ledger=Ledger(**content["ledger"]),
            curves={column: curves[column].to_numpy() for column in curves},
            status=content["status"],
            notes={name: _number(value) for name, value in content["notes"].items()},
        )


def _write(folder: Path, run: Run, outcome: Outcome) -> None:
    """All files of a run into `folder`, flushed to disk."""
    if outcome.trained is not None:
        metrics = {name: _finite(value) for name, value in outcome.metrics.items()}
        _write_json(folder / "metrics.json", metrics)
        for name, frame in (("curves", outcome.curves), ("trajectories", outcome.trajectory)):
            frame = table(name, []) if frame is None else frame
            file = "trajectory" if name == "trajectories" else name
            frame.to_parquet(folder / f"{file}.parquet", index=False)
        _save_arrays(folder / "policy.npz", outcome.trained.policy)
        if outcome.trained.residual is not None:
            _save_arrays(folder / "residual.npz", outcome.trained.residual)
    if outcome.details:
        (folder / "traceback.txt").write_text(outcome.details, encoding="utf-8")
    content = {
        "run": run.name,
        "key": run.key,
        "method": run.method,
        "residual": run.residual,
        "variant": run.variant,
        "task": run.task,
        "team_size": run.team_size,
        "seed": run.seed,
        "status": outcome.status,
        "cause": outcome.cause,
        "deployed_in": REALITY,
        "parents": dict(run.parents),
        "resolved": run.resolved,
        "sources": dict(run.sources),
        "packages": packages(),
        "committed": pd.Timestamp.now(tz="UTC").isoformat(),
        "files": {path.name: _checksum(path) for path in sorted(folder.iterdir())},
    }
    if outcome.trained is not None:
        content["ledger"] = describe_fields(outcome.trained.ledger, "ledger")
        content["notes"] = {k: _finite(v) for k, v in outcome.trained.notes.items()}
    _write_json(folder / "run.json", content)
    for path in (*folder.iterdir(), folder):
        _flush(path)


def _save_arrays(path: Path, tree: eqx.Module) -> None:
    leaves = jax.tree.leaves(eqx.filter(tree, eqx.is_array))
    arrays = {f"{index:03d}": np.asarray(leaf) for index, leaf in enumerate(leaves)}
    np.savez(path, allow_pickle=False, **arrays)


def _load_arrays(path: Path, template: Policy) -> Policy:
    """`template` with the arrays of a file."""
    arrays, rest = eqx.partition(template, eqx.is_array)
    leaves, structure = jax.tree.flatten(arrays)
    try:
        with np.load(path, allow_pickle=False) as stored:
            found = [stored[name] for name in sorted(stored.files)]
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise UnreadableRunError(f"{path.name} of {path.parent.name}: {error}") from error
    if [leaf.shape for leaf in found] != [leaf.shape for leaf in leaves]:
        raise UnreadableRunError(
            f"{path.name} of {path.parent.name} is not the shared policy of its task: it has "
            f"arrays {[leaf.shape for leaf in found]}, not {[leaf.shape for leaf in leaves]}."
        )
    loaded = [jax.numpy.asarray(new, old.dtype) for new, old in zip(found, leaves, strict=True)]
    return eqx.combine(jax.tree.unflatten(structure, loaded), rest)


def _finite(value: float) -> float | None:
    """`value`, or None, since JSON has no NaN."""
    return float(value) if np.isfinite(value) else None


def _number(value: float | None) -> float:
    """What `_finite` was given, as far as JSON kept it."""
    return float("nan") if value is None else value


def _write_json(path: Path, content: Mapping) -> None:
    text = json.dumps(content, indent=1, allow_nan=False)
    path.write_text(text + "\n", encoding="utf-8")


def _checksum(path: Path) -> str:
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _flush(path: Path) -> None:
    """Waits until a file or folder is on disk."""
    handle = os.open(path, os.O_RDONLY)
    try:
        os.fsync(handle)
    finally:
        os.close(handle)
