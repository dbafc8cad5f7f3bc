"""A database of MLflow: an experiment, with a run of it for every run."""

import importlib
import logging
import warnings
from collections.abc import Iterator, Sequence
from itertools import zip_longest
from pathlib import Path
from typing import Any, TypeVar

from bench.sharing.export.run_views import RunView, run_views
from bench.store.tables import Tables

MOST_PARAMS = 100
"""Parameters that the client takes in one call; MLflow's own limit."""
MOST_METRICS = 800
"""Metrics that go into one call; MLflow takes 1000 entries, parameters and tags among them."""
LOUD = ("mlflow", "alembic")
"""Loggers that report how the database is made."""

T = TypeVar("T")


def write(tables: Tables, title: str, folder: Path, place: Path) -> list[str]:
    """Fills `folder` with mlflow.db; what is known of a run are its parameters."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # what MLflow's own dependencies deprecate
        mlflow: Any = importlib.import_module("mlflow")
        for name in LOUD:
            logging.getLogger(name).setLevel(logging.WARNING)
        client = mlflow.MlflowClient(f"sqlite:///{folder.absolute() / 'mlflow.db'}")
        # Else the experiment would name the folder that is moved when all is written.
        artifacts = (place / "artifacts").as_uri()
        experiment = client.create_experiment(title, artifact_location=artifacts)
        for run in run_views(tables):
            _add(mlflow.entities, client, experiment, run)
    return []


def _add(entities: Any, client: Any, experiment: str, run: RunView) -> None:
    """One run; the time of every value is 0, because the tables keep none."""
    made = client.create_run(experiment, start_time=0, run_name=run.name).info.run_id
    params = [entities.Param(name, str(x)) for name, x in run.about.items() if x != ""]
    metrics = [entities.Metric(f"final/{name}", x, 0, 0) for name, x in run.metrics.items()]
    metrics += [
        entities.Metric(name, x, 0, epoch) for epoch, own in run.points() for name, x in own.items()
    ]
    batches = zip_longest(_batches(params, MOST_PARAMS), _batches(metrics, MOST_METRICS))
    for some_params, some_metrics in batches:
        client.log_batch(made, params=some_params or [], metrics=some_metrics or [])
    client.set_terminated(made, status="FAILED" if run.failed else "FINISHED", end_time=0)


def _batches(items: Sequence[T], most: int) -> Iterator[Sequence[T]]:
    return (items[start : start + most] for start in range(0, len(items), most))
