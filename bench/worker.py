"""Trains and evaluates one run; this is what a worker process does.

Every policy is deployed twice with the initial states of its seed: in the high-fidelity simulator
(the row of the leaderboard) and in the nominal point mass, which tells how much of a return was
lost between the two. A child's ledger holds its own costs only: those of its parents are theirs.
For the built-in methods no high-fidelity flight is hidden by this, because their one parent, the LF
baseline, flies none.
"""

import os
import signal
import sys
import time
import traceback
from multiprocessing.connection import Connection
from pathlib import Path

import jax
import numpy as np
import pandas as pd

from bench.plan import NOMINAL, REALITY, Run
from bench.settings import build
from bench.store import Outcome, Store
from bench.tables import SCHEMAS, STATUSES, UNITS, table
from methods.contract import Progress, Setup, Trained
from methods.evaluate import Evaluation, evaluate
from methods.policy import PolicyController, make_policy
from simulators import registry

REPORT_EVERY = 0.2
"""Shortest time between two progress reports of a worker [s]."""
SMOOTHING = 10
"""Epochs over which training returns are averaged if a method does not say its best."""
SAMPLE_EVERY = 5
"""Control steps between two stored positions: 10 Hz."""


def serve(connection: Connection, directory: Path, log: Path) -> None:
    """Does the runs that arrive on `connection` until it closes or None arrives.

    Reports ("progress", stage, epoch, epochs, return) and, once a run is committed, ("done",
    status, cause). What the run prints goes to `log`.
    """
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to handle
    with log.open("a", encoding="utf-8") as file:
        sys.stdout.flush()
        sys.stderr.flush()
        os.dup2(file.fileno(), sys.stdout.fileno())
        os.dup2(file.fileno(), sys.stderr.fileno())
    store = Store(directory)
    try:
        while (run := connection.recv()) is not None:
            outcome = attempt(run, store, _reporter(connection))
            store.commit(run, outcome)
            connection.send(("done", outcome.status, outcome.cause))
    except (EOFError, BrokenPipeError, ConnectionResetError):
        return  # the parent is gone, and nobody waits for the rest


def attempt(run: Run, store: Store, progress: Progress) -> Outcome:
    """The outcome of a run; whatever it raises becomes a failure with its cause."""
    try:
        return train_and_evaluate(run, store, progress)
    except Exception as error:
        words = " ".join(str(error).split())
        return Outcome(
            status="failed",
            cause=f"{type(error).__name__}: {words}" if words else type(error).__name__,
            details=traceback.format_exc(),
        )


def train_and_evaluate(run: Run, store: Store, progress: Progress) -> Outcome:
    """Trains a run's method and deploys the policy.

    Raises:
        UnreadableRunError: A parent's policy cannot be loaded.
        TypeError: The method did not return what it must.
    """
    task = build(
        registry.load("task", run.task), run.task_overrides, run.task, n_drones=run.team_size
    )
    given = {"residual": run.residual} if run.residual else {}
    method = build(registry.load("method", run.method), run.overrides, run.method, **given)
    nominal = registry.load("simulator", NOMINAL)()
    reality = registry.load("simulator", REALITY)()
    template = make_policy(task, nominal.spec, nominal.action_space, jax.random.key(0))
    parents = {name: store.trained(parent, template) for name, parent in run.parents.items()}
    setup = Setup(task, nominal, reality, parents, progress)
    trained = method.train(setup, jax.random.fold_in(jax.random.key(run.seed), 0))
    if not isinstance(trained, Trained):
        raise TypeError(f"`train` of '{run.method}' must return a Trained, got {trained!r:.80}.")
    if trained.status not in STATUSES or trained.status == "failed":
        raise ValueError(f"'{run.method}' returned the status '{trained.status}'; raise to fail.")
    progress("evaluation", 0, 2, float("nan"))
    controller = PolicyController(task, trained.policy)
    deployed = evaluate(task, reality, controller, run.seed)
    progress("evaluation", 1, 2, deployed.reward)
    in_nominal = evaluate(task, nominal, controller, run.seed)
    return Outcome(
        status=trained.status,
        trained=trained,
        metrics=metrics(trained, deployed, in_nominal),
        curves=_curves(run, trained),
        trajectory=_trajectory(run, deployed),
    )


def metrics(trained: Trained, deployed: Evaluation, in_nominal: Evaluation) -> dict[str, float]:
    """Metric -> value, for every metric of `bench.tables.UNITS` and each note of the method.

    Raises:
        ValueError: A note has the name of a metric.
    """
    ledger, notes = trained.ledger, dict(trained.notes)
    training_reward = notes.pop("training_reward", None)
    if training_reward is None:
        history = np.asarray(trained.curves.get("smooth_reward", [np.nan]), float)
        width = min(SMOOTHING, len(history))
        training_reward = np.convolve(history, np.full(width, 1.0 / width), "valid").max()
    if taken := sorted(set(notes) & set(UNITS)):
        raise ValueError(f"The notes of a method cannot be called {', '.join(taken)}.")
    return {
        "reward": deployed.reward,
        "crashes": deployed.crashes,
        "crash_step_rate": deployed.crash_step_rate,
        "position_error": deployed.position_error,
        "fleet_minutes": ledger.hf_fleet_seconds / 60.0,
        "calibration_crashes": ledger.calibration_crashes,
        "training_crashes": ledger.training_crashes,
        "training_crash_step_rate": ledger.training_crash_step_rate,
        "lf_collisions": ledger.lf_collisions,
        "epochs": ledger.epochs,
        "skipped_updates": ledger.skipped_updates,
        "train_seconds": ledger.train_seconds,
        "training_reward": training_reward,
        "lf_reward": in_nominal.reward,
        "lf_position_error": in_nominal.position_error,
        **notes,
    }


def _curves(run: Run, trained: Trained) -> pd.DataFrame:
    """Rows of the table `curves`; what a method does not record is empty."""
    frame = pd.DataFrame({name: np.asarray(v) for name, v in trained.curves.items()})
    frame = frame.assign(run=run.name, epoch=np.arange(len(frame)))
    return table("curves", frame.reindex(columns=list(SCHEMAS["curves"].columns)))


def _trajectory(run: Run, deployed: Evaluation) -> pd.DataFrame:
    """Rows of the table `trajectories`: the first episode at 10 Hz, from the first sample on."""
    t = np.asarray(deployed.trajectory["t"])[::SAMPLE_EVERY]
    pos = np.asarray(deployed.trajectory["pos"])[::SAMPLE_EVERY]
    n_times, n_drones, _ = pos.shape
    columns = {
        "run": run.name,
        "drone": np.tile(np.arange(n_drones), n_times),
        "t": np.repeat(t, n_drones),
    }
    columns |= {f"pos_{axis}": pos[..., i].reshape(-1) for i, axis in enumerate("xyz")}
    return table("trajectories", pd.DataFrame(columns))


def _reporter(connection: Connection) -> Progress:
    """A `Progress` that reports to the parent, not too often."""
    last, stage_before = 0.0, ""

    def report(stage: str, epoch: int, epochs: int, reward: float) -> None:
        nonlocal last, stage_before
        now = time.monotonic()
        if now - last < REPORT_EVERY and stage == stage_before:
            return
        last, stage_before = now, stage
        try:
            connection.send(("progress", stage, int(epoch), int(epochs), float(reward)))
        except OSError:
            raise SystemExit(1) from None  # the parent is gone: a run that nobody waits for

    return report
