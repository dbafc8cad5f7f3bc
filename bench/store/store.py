"""Keeps finished runs: one immutable folder each, written whole or not at all.

    runs/<run>/run.json            what it is, how it ended, its ledger, checksums of the rest
               metrics.json        metric -> value
               curves.parquet      training history
               trajectory.parquet  first evaluation episode
               policy.npz          arrays of the policy, in the order of its pytree, and its
                                   structure where it is not the shared one
               residual.npz        the same of the residual, where there is one

A folder is written beside its place, flushed to disk and renamed; from then on nobody changes it. A
failed attempt is a folder too, which a later attempt replaces. One that cannot be read, or whose
files do not match their checksums, is moved to `runs/.quarantine`, with the reason beside it.
Nothing is pickled.

    runs/.lock                     held by the sweep that works here
    runs/.claims/<run>.lock        held by the process that does a run
    runs/.checkpoints/<run>/       trainings in progress (`bench/store/checkpoints.py`)
    runs/.part-*                   commits in progress, or what a killed one left
"""

import contextlib
import json
import uuid
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping
from pathlib import Path

import filelock
import numpy as np
import pandas as pd

from bench.plan.expansion import packages
from bench.plan.planned_run import Run
from bench.store.checkpoints import Checkpoints
from bench.store.disk import Disk
from bench.store.record import (
    FILES,
    TRACEBACK,
    Outcome,
    UnreadableRunError,
    checksum,
    describe_run,
    load_arrays,
    load_policy,
    number,
    run_files,
    to_json,
)
from bench.store.tables import IDENTITY, STATUSES, Tables, results_rows, runs_row, stack, table
from methods.contract import Ledger, Trained
from methods.residuals.contract import blank
from methods.training.policy import AbstractPolicy
from simulators import registry

LONGEST_CLAIM = 600.0
"""Longest wait for another process that trains the same run [s]."""


class ClaimedError(RuntimeError):
    """Another process is training this run."""


class Store:
    """The runs under one directory of results."""

    def __init__(self, directory: Path, disk: Disk | None = None) -> None:
        """Nothing is written before the first commit or lock."""
        self.directory = Path(directory).absolute()
        self.runs = self.directory / "runs"
        self._disk = disk or Disk()

    @contextlib.contextmanager
    def lock(self, waiting: Callable[[], None]) -> Iterator[None]:
        """A context that owns this directory; calls `waiting` once if another process owns it."""
        self._disk.make_folder(self.runs)
        lock = filelock.FileLock(self.runs / ".lock")
        try:
            lock.acquire(timeout=0)
        except filelock.Timeout:
            waiting()
            lock.acquire()
        try:
            yield
        finally:
            lock.release()

    @contextlib.contextmanager
    def claim(self, name: str, longest: float = LONGEST_CLAIM) -> Iterator[None]:
        """A context in which only this process trains the run; waits while another one trains it.

        A process that dies loses its claim.

        Raises:
            ClaimedError: Another process still trains the run after `longest` seconds.
        """
        path = self.runs / ".claims" / f"{name}.lock"
        self._disk.make_folder(path.parent)
        lock = filelock.FileLock(path, is_singleton=False)
        try:
            lock.acquire(timeout=longest)
        except filelock.Timeout:
            raise ClaimedError(
                f"another process has been training this run for {longest:.0f} s"
            ) from None
        try:
            yield
        finally:
            with contextlib.suppress(OSError):
                self._disk.remove(path)  # who waits for it gets it nevertheless
            lock.release()

    def checkpoints(self, run: Run) -> Checkpoints:
        """Keeps the trainings of a run while they are in progress."""
        return Checkpoints(
            self.runs / ".checkpoints" / run.name,
            json.dumps({**run.sources, **packages()}, sort_keys=True),
            self._disk,
        )

    def commit(self, run: Run, outcome: Outcome) -> bool:
        """Puts a run's folder in place, instead of a failed attempt's or a damaged one.

        Returns:
            Whether it is there now; False: a sound one was there already, and still is.
        """
        place, part = self.runs / run.name, self._part(run.name)
        try:
            if self.read(run.name)["status"] != "failed":
                return False
        except UnreadableRunError as error:
            if place.exists():
                self.quarantine(run.name, str(error))
        try:
            self._write(part, run, outcome)
            if place.exists():
                old = self._part(run.name)
                self._disk.move(place, old)
                self._disk.move(part, place)
                self._disk.flush_folder(self.runs)
                self._disk.remove(old)
            else:
                self._disk.move(part, place)
                self._disk.flush_folder(self.runs)
        except OSError:
            with contextlib.suppress(OSError):
                self._disk.remove(part)
            raise
        if outcome.status != "failed":
            with contextlib.suppress(OSError):  # `tidy` removes it as well
                self._disk.remove(self.runs / ".checkpoints" / run.name)
        return True

    def _part(self, name: str) -> Path:
        """A new name for a folder that is still being written."""
        return self.runs / f".part-{name}-{uuid.uuid4().hex[:8]}"

    def _write(self, folder: Path, run: Run, outcome: Outcome) -> None:
        """All files of a run into a new folder, on disk when this returns."""
        self._disk.make_folder(folder)
        files = run_files(outcome)
        for name, content in files.items():
            self._disk.write(folder / name, content)
        self._disk.write(folder / "run.json", to_json(describe_run(run, outcome, files)))
        self._disk.flush_folder(folder)

    def tidy(self) -> None:
        """Removes what interrupted processes left; only for the holder of the lock."""
        for left in self.runs.glob(".part-*"):
            self._disk.remove(left)
        for folder in self.runs.glob(".checkpoints/*"):
            if self.status(folder.name) not in ("", "failed"):
                self._disk.remove(folder)

    def status(self, name: str) -> str:
        """How a run ended, empty if it is not there or damaged."""
        return (self.content(name) or {"status": ""})["status"]

    def content(self, name: str) -> dict | None:
        """Content of a run's run.json; None if the run is not there or damaged."""
        try:
            return self.read(name)
        except UnreadableRunError:
            return None

    def traceback(self, name: str) -> Path | None:
        """The file with a failed run's traceback; None if none was written."""
        path = self.runs / name / TRACEBACK
        return path if path.is_file() else None

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
                raise UnreadableRunError(f"run.json belongs to the run '{content['run']}'")
            if content["status"] not in STATUSES:
                raise UnreadableRunError(f"run.json has the unknown status '{content['status']}'")
            needed = () if content["status"] == "failed" else FILES
            for file in sorted({*needed, *content["files"]}):
                if content["files"].get(file) != checksum((folder / file).read_bytes()):
                    raise UnreadableRunError(f"{file} has changed since it was written")
        except OSError as error:
            reason = f"{Path(error.filename or '').name}: {error.strerror}"
            raise UnreadableRunError(reason) from error
        except (KeyError, TypeError, AttributeError, json.JSONDecodeError) as error:
            raise UnreadableRunError(f"run.json does not describe a run ({error})") from error
        except UnicodeDecodeError as error:
            raise UnreadableRunError("run.json is not text") from error
        return content

    def sound(
        self, warn: Callable[[str], None], names: Iterable[str] | None = None
    ) -> dict[str, dict]:
        """Content of run.json of every sound run among `names`; others are put in quarantine.

        Args:
            warn: Called with a line on each run that cannot be used.
            names: Which runs to look at, as far as they are there; None: all.
        """
        found = {}
        there = self.names()
        for name in there if names is None else sorted({*names} & {*there}):
            try:
                found[name] = self.read(name)
            except UnreadableRunError as error:
                try:
                    place = self.quarantine(name, str(error)).relative_to(self.directory)
                    where = f"It is now {place}."
                except OSError as hindrance:
                    where = f"It stays where it is: {hindrance.strerror}."
                warn(f"Run {name} cannot be used: {error}. {where}")
        return found

    def quarantine(self, name: str, reason: str) -> Path:
        """Moves a run to quarantine, with the reason beside it; returns its new folder."""
        place = self.runs / ".quarantine" / f"{name}-{uuid.uuid4().hex[:8]}"
        self._disk.make_folder(place.parent)
        self._disk.write(place.with_name(f"{place.name}.reason.txt"), f"{reason}\n".encode())
        self._disk.move(self.runs / name, place)
        return place

    def metrics(self, name: str) -> dict[str, float]:
        """Metric -> value; NaN where a number was not finite."""
        content = json.loads((self.runs / name / "metrics.json").read_text(encoding="utf-8"))
        return {metric: number(value) for metric, value in content.items()}

    def frame(self, name: str, file: str) -> pd.DataFrame:
        """A run's `curves` or `trajectory`."""
        return pd.read_parquet(self.runs / name / f"{file}.parquet")

    def arrays(self, name: str, file: str) -> dict[str, np.ndarray]:
        """What a run's `policy` or `residual` is stored as, by name; empty without such a file."""
        path = self.runs / name / f"{file}.npz"
        if not path.is_file():
            return {}
        with np.load(path, allow_pickle=False) as stored:
            return {key: stored[key] for key in sorted(stored.files)}

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

    def trained(self, name: str, template: AbstractPolicy, residual: bool = False) -> Trained:
        """What a run trained; a policy whose structure was not stored has that of `template`.

        Its residual is left out unless `residual`.

        Raises:
            UnreadableRunError: The run is damaged, has failed, or has another kind of policy.
            UnknownPluginError: The class of its residual is not installed.
        """
        content = self.read(name)
        if content["status"] == "failed":
            raise UnreadableRunError(f"{name} failed: {content['cause']}")
        curves = self.frame(name, "curves").drop(columns=["run", "epoch"])
        model, file = None, self.runs / name / "residual.npz"
        if residual and file.name in content["files"] and content["residual"]:
            model = load_arrays(file, blank(registry.load("residual", content["residual"])()))
        return Trained(
            policy=load_policy(self.runs / name / "policy.npz", template),
            residual=model,
            ledger=Ledger(**content["ledger"]),
            curves={column: curves[column].to_numpy() for column in curves},
            status=content["status"],
            notes={name: number(value) for name, value in content["notes"].items()},
        )
