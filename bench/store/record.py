"""Turns a run into the files of its folder, and these into a run."""

import dataclasses
import hashlib
import io
import json
import zipfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import equinox as eqx
import jax
import numpy as np
import pandas as pd

from bench.plan.expansion import packages
from bench.plan.planned_run import Run
from bench.plan.provenance import provenance
from bench.plan.realities import parse_reality
from bench.plan.settings import describe_fields
from bench.store.structure import describe, rebuild
from bench.store.tables import IDENTITY, table
from methods.contract import Trained
from methods.training.policy import AbstractPolicy, is_shared
from simulators.effects.chain import canonical

FILES = ("metrics.json", "curves.parquet", "trajectory.parquet", "policy.npz")
"""What the folder of a trained run holds beside run.json."""
TRACEBACK = "traceback.txt"
"""What the folder of a failed run holds beside run.json."""
STRUCTURE = "structure"
"""Name of the entry in `policy.npz` that says how a policy of another architecture is made."""


class UnreadableRunError(ValueError):
    """A run's folder that is damaged or is not what its name says."""


T = TypeVar("T", bound=eqx.Module)


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What a run left; a failed one has only its status and cause."""

    status: str
    """`ok`, `failed`, `diverged` or `budget`."""
    cause: str = ""
    """One line that says why it failed."""
    details: str = ""
    """Traceback of a failure."""
    interrupted: bool = False
    """Whether it failed from outside, e.g. its process was killed: it may go well next time."""
    trained: Trained | None = None
    """Policy, ledger, residual, notes."""
    trained_effects: str = ""
    """Effects of the simulator that it was trained in, a residual not among them."""
    metrics: Mapping[str, float] = dataclasses.field(default_factory=dict)
    """Metric -> value."""
    curves: pd.DataFrame | None = None
    """Rows of the table `curves`."""
    trajectory: pd.DataFrame | None = None
    """Rows of the table `trajectories`."""
    origin: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    """Entries of run.json that say where a restored run comes from; empty: it was trained now."""


def run_files(outcome: Outcome) -> dict[str, bytes]:
    """Content of all files of a run but run.json, by name."""
    files = {}
    if outcome.trained is not None:
        files["metrics.json"] = to_json({k: _finite(v) for k, v in outcome.metrics.items()})
        files["curves.parquet"] = _parquet("curves", outcome.curves)
        files["trajectory.parquet"] = _parquet("trajectories", outcome.trajectory)
        files["policy.npz"] = policy_bytes(outcome.trained.policy)
        if outcome.trained.residual is not None:
            files["residual.npz"] = _arrays(outcome.trained.residual)
    if outcome.details:
        files[TRACEBACK] = outcome.details.encode("utf-8", "backslashreplace")
    return files


def describe_run(run: Run, outcome: Outcome, files: Mapping[str, bytes]) -> dict:
    """Content of run.json."""
    reality = parse_reality(run.reality)
    content = {
        "run": run.name,
        "key": run.key,
        **dict(zip(IDENTITY, run.identity, strict=True)),
        "status": outcome.status,
        "cause": outcome.cause,
        "interrupted": outcome.interrupted,
        "trained_effects": outcome.trained_effects,
        "deployed_in": reality.name,
        "deployed_effects": canonical(reality.effects),
        "parents": dict(run.parents),
        "resolved": run.resolved,
        "sources": dict(run.sources),
        "packages": packages(),
        "provenance": provenance(),
        "program": run.program,
        "committed": pd.Timestamp.now(tz="UTC").isoformat(),
        "files": {name: checksum(content) for name, content in sorted(files.items())},
    }
    if outcome.trained is not None:
        content["ledger"] = describe_fields(outcome.trained.ledger, "ledger")
        content["notes"] = {k: _finite(v) for k, v in outcome.trained.notes.items()}
    return content | dict(outcome.origin)


def _parquet(name: str, frame: pd.DataFrame | None) -> bytes:
    """Rows of a table as a Parquet file; None: no rows."""
    return (table(name, []) if frame is None else frame).to_parquet(index=False)


def _arrays(tree: eqx.Module, others: Mapping[str, np.ndarray] = MappingProxyType({})) -> bytes:
    """The arrays of a pytree as an npz file, in its order, and `others`, by name."""
    leaves = jax.tree.leaves(eqx.filter(tree, eqx.is_array))
    file = io.BytesIO()
    arrays = {f"{index:03d}": np.asarray(leaf) for index, leaf in enumerate(leaves)}
    np.savez(file, allow_pickle=False, **arrays, **others)
    return file.getvalue()


def policy_bytes(policy: AbstractPolicy) -> bytes:
    """The arrays of a policy as an npz file, and its structure unless it is the shared one.

    Raises:
        TypeError: Its structure cannot be described, e.g. because it holds a lambda.
    """
    if is_shared(policy):
        return _arrays(policy)
    return _arrays(policy, {STRUCTURE: np.asarray(describe(policy))})


def load_arrays(path: Path, template: T) -> T:
    """`template` with the arrays of a file.

    Raises:
        UnreadableRunError: The file is damaged, or holds arrays of other shapes.
    """
    return with_arrays(template, list(_load(path).values()), _where(path))


def load_policy(path: Path, template: AbstractPolicy) -> AbstractPolicy:
    """The policy of a file: in the structure that it names, else in that of `template`.

    Raises:
        UnreadableRunError: The file is damaged, or its policy cannot be made again.
    """
    return policy_of(_load(path), template, _where(path))


def policy_of(
    stored: Mapping[str, np.ndarray], template: AbstractPolicy, where: str
) -> AbstractPolicy:
    """The policy that was stored as these arrays, by name, as in `load_policy`."""
    found = [stored[name] for name in sorted(stored) if name != STRUCTURE]
    if STRUCTURE not in stored:
        return with_arrays(template, found, where)
    try:
        policy = rebuild(str(stored[STRUCTURE]), found)
    except (ValueError, ImportError) as error:
        raise UnreadableRunError(f"{where} cannot be loaded: {error}") from error
    if not isinstance(policy, AbstractPolicy):
        raise UnreadableRunError(f"{where} must hold a policy, got a {type(policy).__name__}")
    return policy


def _load(path: Path) -> dict[str, np.ndarray]:
    """The arrays of a file, by name, sorted."""
    try:
        with np.load(path, allow_pickle=False) as stored:
            return {name: stored[name] for name in sorted(stored.files)}
    except (OSError, ValueError, zipfile.BadZipFile) as error:
        raise UnreadableRunError(f"{_where(path)}: {error}") from error


def _where(path: Path) -> str:
    return f"{path.name} of {path.parent.name}"


def with_arrays(template: T, found: Sequence[np.ndarray], where: str) -> T:
    """`template` with the arrays of `found`, in its order.

    Raises:
        UnreadableRunError: They have other shapes.
    """
    arrays, rest = eqx.partition(template, eqx.is_array)
    leaves, structure = jax.tree.flatten(arrays)
    if [leaf.shape for leaf in found] != [leaf.shape for leaf in leaves]:
        raise UnreadableRunError(
            f"{where} does not fit its run: its arrays have the shapes "
            f"{[leaf.shape for leaf in found]}, expected {[leaf.shape for leaf in leaves]}."
        )
    loaded = [jax.numpy.asarray(new, old.dtype) for new, old in zip(found, leaves, strict=True)]
    return eqx.combine(jax.tree.unflatten(structure, loaded), rest)


def _finite(value: float) -> float | None:
    """`value`, or None, since JSON has no NaN."""
    return float(value) if np.isfinite(value) else None


def number(value: float | None) -> float:
    """The number that JSON holds; NaN for None."""
    return float("nan") if value is None else value


def to_json(content: Mapping) -> bytes:
    """Text of a JSON file."""
    return (json.dumps(content, indent=1, allow_nan=False) + "\n").encode()


def checksum(content: bytes) -> str:
    """SHA-256 of a file's content."""
    return hashlib.sha256(content).hexdigest()
