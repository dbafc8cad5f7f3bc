"""Forecasts what runs will cost from the costs of similar past runs.

The nearest past runs count: those of the same cell; else of the same method, residual and variant
at the nearest team size; else on other tasks; else of any variant. Between team sizes training time
goes with N + 2 and flight with N: guesses from measured runs. A run that may train fewer epochs
than a past one did costs so much less, but for calibration flights. Wall times are of whatever
machines the past runs had, training only.
"""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np

from bench.plan.planned_run import Run
from bench.stats.statistics import records
from bench.store.missing import State
from bench.store.tables import Tables


class Past(NamedTuple):
    """What a past run cost."""

    run: str
    method: str
    residual: str
    variant: str
    task: str
    team_size: int
    seconds: float
    """Training time [s]."""
    minutes: float
    """High-fidelity fleet-minutes."""
    epochs: float = np.nan
    """Epochs that it trained; NaN if that is not known."""
    calibrated: bool = False
    """Whether it flew for a calibration; the epochs do not change how much such a run flies."""


class Guess(NamedTuple):
    """What a run will cost."""

    seconds: float
    minutes: float
    basis: str
    """Which past runs it comes from, one of `BASES`, or "no training"."""


BASES = {
    "same cell": lambda run, past: _alike(run, past) and _where(run) == _where(past),
    "other team size": lambda run, past: _alike(run, past) and run.task == past.task,
    "other task": lambda run, past: _alike(run, past),
    "other variant": lambda run, past: (run.method, run.residual) == (past.method, past.residual),
}
"""Kinds of similarity between a run and a past one, best first."""


def past_of_tables(tables: Tables) -> list[Past]:
    """The costs of all runs that were trained."""
    costly = ["train_seconds", "fleet_minutes", "epochs"]
    kept = tables.results.loc[tables.results["metric"].isin(costly)]
    costs: dict[str, dict[str, Any]] = {}
    for row in records(kept):
        costs.setdefault(row["run"], dict(row))[row["metric"]] = float(row["value"])
    return [
        _past(row, row["train_seconds"], row["fleet_minutes"])._replace(
            epochs=row.get("epochs", np.nan), calibrated=row["calibration_flights"] > 0
        )
        for row in costs.values()
        if np.isfinite([row.get("train_seconds", np.nan), row.get("fleet_minutes", np.nan)]).all()
    ]


def past_of_states(states: Iterable[State]) -> list[Past]:
    """The costs of the finished runs of a plan, which no table may hold yet."""
    found = []
    for state in states:
        if state.content is not None and (ledger := state.content.get("ledger")):
            minutes = ledger["hf_fleet_seconds"] / 60.0
            past = _past(state.content, ledger["train_seconds"], minutes)
            flights = ledger["calibration_flights"] > 0
            found.append(past._replace(epochs=ledger["epochs"], calibrated=flights))
    return found


def guess(run: Run, past: Iterable[Past]) -> Guess | None:
    """Expected cost of `run`, zero if it trains nothing; None if no past run is similar."""
    if run.deploys:
        return Guess(0.0, 0.0, "no training")
    past = [p for p in past if p.seconds > 0.0]
    for basis, tells in BASES.items():
        if found := [p for p in past if tells(run, p)]:
            nearest = min(abs(p.team_size - run.team_size) for p in found)
            near = [p for p in found if abs(p.team_size - run.team_size) == nearest]
            share = {p: _share(run, p) for p in near}
            seconds = [p.seconds * share[p] * (2 + run.team_size) / (2 + p.team_size) for p in near]
            flown = [p.minutes * (1.0 if p.calibrated else share[p]) for p in near]
            minutes = [m * run.team_size / p.team_size for m, p in zip(flown, near, strict=True)]
            return Guess(float(np.mean(seconds)), float(np.mean(minutes)), basis)
    return None


def _share(run: Run, past: Past) -> float:
    """Share of the past run's epochs that the run may train; 1 if it may train all of them."""
    settings: Any = run.resolved.get("settings") or {}
    trainer = settings.get("trainer", settings)
    limit = trainer.get("epochs") if isinstance(trainer, Mapping) else None
    return limit / past.epochs if limit is not None and past.epochs > limit else 1.0


def longest_chain(runs: Iterable[Run], seconds: Mapping[str, float]) -> float:
    """Training time of the longest chain of runs and parents [s]; more jobs cannot shorten it."""
    chains: dict[str, float] = {}
    for run in runs:  # parents come before their children
        before = max((chains.get(parent, 0.0) for parent in run.parents.values()), default=0.0)
        chains[run.name] = before + seconds.get(run.name, 0.0)
    return max(chains.values(), default=0.0)


def _past(row: Mapping[str, Any], seconds: float, minutes: float) -> Past:
    return Past(
        run=str(row["run"]),
        method=str(row["method"]),
        residual=str(row["residual"]),
        variant=str(row["variant"]),
        task=str(row["task"]),
        team_size=int(row["team_size"]),
        seconds=float(seconds),
        minutes=float(minutes),
    )


def _alike(run: Run, past: Past) -> bool:
    return (run.method, run.residual, run.variant) == (past.method, past.residual, past.variant)


def _where(run: Run | Past) -> tuple[str, int]:
    return run.task, run.team_size
