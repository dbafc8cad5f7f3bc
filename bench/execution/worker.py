"""Trains and evaluates runs: the work of a worker process, on any machine.

Every policy is deployed twice from the initial states of its task and team size: in the high-
fidelity simulator with the effects that the row asks for, which gives the row of the leaderboard,
and in the nominal point mass, which shows how much of the return was lost between the two.

A run is billed for its own flights; the flights of its parents stand in the parents' rows. So a
run that only deploys its parent's policy costs nothing, and the flights of the Hybrid from which
`recalibrated` starts stand in the Hybrid's row. Only `hybrid_once` and `online` inherit their
parent's flights.
"""

import contextlib
import dataclasses
import platform
import time
import traceback
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any, cast

import jax
import numpy as np
import pandas as pd

from bench.execution.executor import Report, one_line
from bench.plan.planned_run import REALITY, Run
from bench.plan.provenance import provenance
from bench.plan.realities import nominal_simulator, parse_reality
from bench.plan.settings import build
from bench.store.record import Outcome
from bench.store.resume import resumed_methods
from bench.store.store import Store
from bench.store.structure import describe
from bench.store.tables import SCHEMAS, STATUSES, UNITS, table
from methods.calibration.reference_paths import Followers
from methods.contract import Ledger, Setup, Trained
from methods.running.metered import train_metered
from methods.training.context import Context, Progress
from methods.training.evaluate import Evaluation, evaluate, standing_rewards, takeoff_steps
from methods.training.policy import PolicyController, make_policy
from methods.training.together import Team
from simulators import registry
from simulators.contract import AbstractSimulator
from simulators.effects.chain import canonical
from tasks.contract import AbstractTask

REPORT_EVERY = 0.2
"""Shortest time between two progress reports of a worker [s]."""
SMOOTHING = 10
"""Last epochs over which training returns are averaged if a method does not say its own."""
SAMPLE_EVERY = 5
"""Control steps between two stored positions: 10 Hz."""


def do_run(run: Run, directory: Path, report: Report, team: Team | None = None) -> tuple[str, str]:
    """Status and cause of a run, once it is in the store; a stored run is not repeated.

    Its epochs are flown with those of `team`, of which the calling thread is a member.

    Raises:
        OSError: It cannot be stored, e.g. because the disk is full.
        RuntimeError: It was planned for another kind of device.
        ClaimedError: Another process is training this run and does not finish.
    """
    provenance()  # that of the code which this process has loaded: the checkout may move
    store, numerics = Store(directory), cast("dict[str, str]", run.resolved["numerics"])
    planned = numerics["backend"]
    if planned != (found := jax.default_backend()):
        raise RuntimeError(
            f"The run was planned for JAX on {planned}, but on {platform.node()} JAX uses {found}, "
            f"and results of the two must not be mixed. Use machines on which JAX uses {planned}."
        )
    if not (store.runs / ".lock").exists():
        raise FileNotFoundError(
            f"{store.runs} does not exist on {platform.node()}. Put the folder of results where "
            "every machine finds it under the same path."
        )
    with store.claim(run.name):
        if (status := store.status(run.name)) not in ("", "failed"):
            return status, ""
        context = Context(_progress(report), team, store.checkpoints(run))
        outcome = attempt(run, store, context)
        store.commit(run, outcome)
    return outcome.status, outcome.cause


@dataclasses.dataclass(frozen=True)
class Done:
    """How one of several runs ended."""

    status: str
    """Its status in the store; empty if it could not be stored."""
    cause: str
    """Why the run failed; empty if it did not."""
    error: str = ""
    """Why the run could not be stored, in one line; empty if it was stored."""


def do_runs(runs: Sequence[Run], directory: Path, report: Report) -> list[Done]:
    """How each ended; several train at once, each in a thread, in one program (`Team`).

    Reports are those of the first that has not ended.
    """
    team, going = Team(len(runs)) if len(runs) > 1 else None, set(range(len(runs)))

    def one(place: int) -> Done:
        def notify(*content: Any) -> None:
            if place == min(going):
                report(*content)

        try:
            with team.member() if team else contextlib.nullcontext():
                return Done(*do_run(runs[place], directory, notify, team))
        except Exception as error:
            return Done("", "", one_line(error))
        finally:
            going.discard(place)

    with ThreadPoolExecutor(len(runs)) as pool:
        return list(pool.map(one, range(len(runs))))


def attempt(run: Run, store: Store, context: Context) -> Outcome:
    """The outcome of a run; whatever it raises becomes a failure with its cause."""
    try:
        return train_and_evaluate(run, store, context)
    except (Exception, SystemExit) as error:
        return Outcome("failed", cause=one_line(error), details=traceback.format_exc())


def train_and_evaluate(run: Run, store: Store, context: Context) -> Outcome:
    """Trains a run's method and deploys the policy.

    Raises:
        UnreadableRunError: A parent's policy cannot be loaded.
        TypeError: The method did not return what it must, or a policy that cannot be stored.
    """
    task = build(
        registry.load("task", run.task), run.task_overrides, run.task, n_drones=run.team_size
    )
    nominal = nominal_simulator(run.nominal_overrides)
    reality = parse_reality(run.reality)
    parents = _parents(run, store, task, nominal)
    setup = Setup(task, nominal, reality, parents, context)
    if run.deploys:  # what the parent trained, without its costs
        trained = dataclasses.replace(parents[run.method], ledger=Ledger(), curves={})
    else:
        trained = _trained(run, setup)
    if trained.status not in STATUSES or trained.status == "failed":
        raise ValueError(
            f"'{run.method}' returned the status '{trained.status}'; it must be ok, diverged "
            "or budget. Raise an exception if a training failed."
        )
    describe(trained.policy)  # what cannot be stored fails before it is flown
    context.progress("evaluation", 0, 2, float("nan"))
    controller = PolicyController(task, trained.policy)
    if run.tracked:
        controller = Followers(task, nominal, controller)
    deployed = evaluate(task, reality, controller, run.seed)
    context.progress("evaluation", 1, 2, deployed.reward)
    in_nominal = evaluate(task, nominal, controller, run.seed)
    standing = standing_rewards(task, run.seed)
    return Outcome(
        status=trained.status,
        trained=trained,
        trained_effects=_trained_in(run, store, trained, setup),
        metrics=metrics(trained, deployed, in_nominal)
        | {
            "spawn_reward": float(standing.sum(axis=1).mean()),
            "spawn_settled_reward": float(standing[:, takeoff_steps(task) :].sum(axis=1).mean()),
        },
        curves=_curves(run, trained),
        trajectory=_trajectory(run, deployed),
    )


def _parents(
    run: Run, store: Store, task: AbstractTask, nominal: AbstractSimulator
) -> dict[str, Trained]:
    """What the parents of a run trained, by method."""
    method, found = registry.load("method", run.method), {}
    for name, parent in run.parents.items():
        cell = None if run.deploys else method.parent_cells.get(name)
        flown = (
            build(registry.load("task", cell[0]), {}, cell[0], n_drones=cell[1]) if cell else task
        )
        template = make_policy(flown, nominal.spec, nominal.action_space, jax.random.key(0))
        found[name] = store.trained(parent, template, name in resumed_methods(run))
    return found


def _trained_in(run: Run, store: Store, trained: Trained, setup: Setup) -> str:
    """Effects of the simulator in which the policy was trained."""
    if run.deploys:
        return store.read(run.parents[run.method]).get("trained_effects", "")
    at_home = registry.load("method", run.method).simulator == REALITY
    low_fidelity = (*setup.nominal.effects, *trained.effects)
    return canonical(setup.reality.effects if at_home else low_fidelity)


def _trained(run: Run, setup: Setup) -> Trained:
    given = {"residual": run.residual} if run.residual else {}
    method = build(registry.load("method", run.method), run.overrides, run.method, **given)
    return train_metered(method, setup, jax.random.fold_in(jax.random.key(run.seed), 0))


def metrics(trained: Trained, deployed: Evaluation, in_nominal: Evaluation) -> dict[str, float]:
    """Metric -> value, for every metric of `bench.store.tables.UNITS` and each note of the method.

    Raises:
        ValueError: A note has the name of a metric.
    """
    ledger, notes = trained.ledger, dict(trained.notes)
    training_reward = notes.pop("training_reward", None)
    if training_reward is None:
        history = np.asarray(trained.curves.get("smooth_reward", [np.nan]), float)
        width = min(SMOOTHING, len(history))
        training_reward = history[-width:].mean()
    if taken := sorted(set(notes) & set(UNITS)):
        raise ValueError(
            f"`notes` must not have the names of metrics, got {', '.join(taken)}. Rename them."
        )
    return {
        "settled_reward": deployed.settled_reward,
        "reward": deployed.reward,
        "takeoff_reward": deployed.takeoff_reward,
        "worst_decile_reward": deployed.worst_decile,
        "settling_time": deployed.settling_time,
        "crashes": deployed.crashes,
        "crash_step_rate": deployed.crash_step_rate,
        "position_error": deployed.position_error,
        "fleet_minutes": ledger.hf_fleet_seconds / 60.0,
        **{name: value for name, value in dataclasses.asdict(ledger).items() if name in UNITS},
        "training_reward": training_reward,
        "lf_reward": in_nominal.reward,
        "lf_settled_reward": in_nominal.settled_reward,
        "lf_position_error": in_nominal.position_error,
        **notes,
    }


def _curves(run: Run, trained: Trained) -> pd.DataFrame:
    """Rows of the table `curves`; what a method does not record is empty."""
    frame = pd.DataFrame({name: np.asarray(v) for name, v in trained.curves.items()})
    frame = frame.assign(run=run.name, epoch=np.arange(len(frame)))
    return SCHEMAS["curves"].validate(table("curves", frame))


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
    return SCHEMAS["trajectories"].validate(table("trajectories", pd.DataFrame(columns)))


def _progress(report: Report) -> Progress:
    """A `Progress` that reports at most every `REPORT_EVERY` seconds."""
    last, stage_before = 0.0, ""

    def progress(stage: str, epoch: int, epochs: int, reward: float) -> None:
        nonlocal last, stage_before
        now = time.monotonic()
        if now - last >= REPORT_EVERY or stage != stage_before:
            last, stage_before = now, stage
            report(stage, int(epoch), int(epochs), float(reward))

    return progress
