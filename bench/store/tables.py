"""The four tables that a sweep leaves behind, validated; documents are functions of them alone.

| table | one row per |
|---|---|
| `results` | evaluated run and metric |
| `curves` | run and epoch |
| `trajectories` | run, drone and sample of the first evaluation episode (10 Hz) |
| `runs` | run, failed ones too |

Each is a Parquet file. `results` and `runs` are the record; the other two may be missing, as those
of all committed suites are. `flights.parquet` then stands for `trajectories`: the few that a figure
shows (`python -m bench.paper.pictures`).
"""

import dataclasses
import functools
import json
from collections.abc import Collection, Mapping
from pathlib import Path
from typing import Any

import pandas as pd
import pandera.pandas as pa

from bench.text.errors import UsageError

STATUSES = ("ok", "failed", "diverged", "budget")
"""How a run can end."""
UNITS = {
    "settled_reward": "1",
    "reward": "1",
    "takeoff_reward": "1",
    "worst_decile_reward": "1",
    "settling_time": "s",
    "crashes": "1/episode",
    "crash_step_rate": "1",
    "position_error": "m",
    "fleet_minutes": "min",
    "calibration_crashes": "1",
    "training_crashes": "1",
    "training_crash_step_rate": "1",
    "lf_collisions": "1",
    "epochs": "1",
    "skipped_updates": "1",
    "train_seconds": "s",
    "training_reward": "1",
    "lf_reward": "1",
    "lf_settled_reward": "1",
    "lf_position_error": "m",
    "spawn_reward": "1",
    "spawn_settled_reward": "1",
}
"""The metrics of every run and their units; a method's notes are further metrics, unit ""."""


IDENTITY = ("method", "residual", "variant", "task", "team_size", "seed")
"""Columns that say what a run is; no two runs of the tables agree in all of them."""


INTERRUPTED = "interrupted: "
"""First words of the cause of an interrupted run, which is tried again."""
LARGE = ("curves", "trajectories")
"""Tables that a repository may leave out."""
FEW_TRAJECTORIES = "flights.parquet"
"""Part of the table `trajectories` that a repository keeps; it is read where that is missing."""
_ORIGIN = ("key", "committed", "commit", "dirty", "program", "machine", "device")


class TableError(UsageError):
    """A directory that does not hold the tables of a sweep."""


def _schema(**columns: pa.Column) -> pa.DataFrameSchema:
    return pa.DataFrameSchema(columns, strict=True, ordered=True, coerce=True)


_TEXT = pa.Column(str)
_COUNT = pa.Column(int, pa.Check.ge(0))
_STATUS = pa.Column(str, pa.Check.isin(STATUSES))
_NUMBER = pa.Column(float, nullable=True)
_IDENTITY = dict.fromkeys(IDENTITY, _TEXT)
_IDENTITY |= {"team_size": pa.Column(int, pa.Check.ge(2)), "seed": _COUNT}

SCHEMAS = {
    "results": _schema(
        run=_TEXT,
        **_IDENTITY,
        simulator=_TEXT,
        trained_effects=_TEXT,
        deployed_effects=_TEXT,
        calibration_flights=_COUNT,
        metric=_TEXT,
        value=_NUMBER,
        unit=_TEXT,
        status=_STATUS,
    ),
    "curves": _schema(
        run=_TEXT,
        epoch=_COUNT,
        reward=_NUMBER,
        smooth_reward=_NUMBER,
        crashes=_NUMBER,
        grad_norm=_NUMBER,
    ),
    "trajectories": _schema(
        run=_TEXT,
        drone=_COUNT,
        t=pa.Column(float),
        pos_x=_NUMBER,
        pos_y=_NUMBER,
        pos_z=_NUMBER,
    ),
    "runs": _schema(
        run=pa.Column(str, unique=True),
        **_IDENTITY,
        status=_STATUS,
        cause=_TEXT,
        settings=_TEXT,
        versions=_TEXT,
        **(dict.fromkeys(_ORIGIN, _TEXT) | {"dirty": pa.Column(bool)}),
    ),
}
"""Columns of each table, in order; nothing else is allowed in it."""


@dataclasses.dataclass(frozen=True)
class Tables:
    """What a sweep found. Built empty, each table has its columns and no rows."""

    results: pd.DataFrame
    """One row per evaluated run and metric."""
    curves: pd.DataFrame
    """One row per run and epoch: training returns, crashes, gradient norm."""
    trajectories: pd.DataFrame
    """Positions in the first evaluation episode, world frame [m], `t` [s]."""
    runs: pd.DataFrame
    """One row per run; `cause` says why a failed one failed."""

    def __post_init__(self) -> None:
        for name, schema in SCHEMAS.items():
            object.__setattr__(self, name, schema.validate(getattr(self, name)))

    @classmethod
    def load(cls, directory: Path) -> "Tables":
        """The tables in `directory`; those of `LARGE` are empty where they are not there.

        Raises:
            TableError: A table is missing, cannot be read, or has other columns or values.
        """
        directory = Path(directory)
        found = {}
        for name, schema in SCHEMAS.items():
            path = directory / f"{name}.parquet"
            if name == "trajectories" and not path.is_file():
                path = directory / FEW_TRAJECTORIES
            if name in LARGE and not path.is_file():
                found[name] = table(name, [])
                continue
            if not path.is_file():
                raise TableError(
                    f"{directory} holds no {path.name}. Give a directory that `bench run` wrote "
                    "its tables to, e.g. results/quick."
                )
            try:
                found[name] = schema.validate(pd.read_parquet(path))
            except pa.errors.SchemaErrors as error:
                wrong = error.failure_cases.iloc[0]
                reason = f"{wrong['check']} fails, found {wrong['failure_case']}"
                raise TableError(f"{path} cannot be used: {reason}") from error
            except (OSError, ValueError, pa.errors.SchemaError) as error:
                reason = str(error).splitlines()[0]
                raise TableError(f"{path} cannot be used: {reason}") from error
        return cls._checked(found)

    @classmethod
    def empty(cls) -> "Tables":
        """Tables without rows."""
        return cls._checked({name: table(name, []) for name in SCHEMAS})

    @classmethod
    def _checked(cls, frames: Mapping[str, pd.DataFrame]) -> "Tables":
        """Tables of frames that were validated already; they are not validated again."""
        made = object.__new__(cls)
        for name, frame in frames.items():
            object.__setattr__(made, name, frame)
        return made

    def to_pandas(self) -> pd.DataFrame:
        """One row per run, failed ones too: what it is, how it ended, and a column per metric.

        A metric that a run does not have is NaN; `UNITS` says the unit of each.
        """
        metrics = self.results.pivot(index="run", columns="metric", values="value")
        metrics.columns.name = None
        deployed = ["simulator", "trained_effects", "deployed_effects", "calibration_flights"]
        flown = self.results.drop_duplicates("run").set_index("run")[deployed]
        runs = self.runs[["run", *IDENTITY, "status", "cause"]]
        return runs.join(flown, on="run").join(metrics, on="run")

    def column(self, name: str) -> dict[str, Any]:
        """A column of `runs`, by name of the run."""
        return dict(zip(self.runs["run"], self.runs[name], strict=True))

    def by_run(self, metric: str) -> dict[str, float]:
        """Values of a metric, by name of the run."""
        rows = self.results.loc[self.results["metric"].eq(metric)]
        return dict(zip(rows["run"], rows["value"], strict=True))

    def of_runs(self, runs: Collection[str]) -> "Tables":
        """The rows of some runs."""
        frames = {name: getattr(self, name) for name in SCHEMAS}
        own = {name: frame.loc[frame["run"].isin(runs)] for name, frame in frames.items()}
        return self._checked({n: frame.reset_index(drop=True) for n, frame in own.items()})

    def identities(self) -> dict[tuple, str]:
        """Name of the run of each identity (`IDENTITY`)."""
        rows = self.runs[["run", *IDENTITY]].itertuples(index=False, name=None)
        return {tuple(identity): run for run, *identity in rows}

    def metrics(self, run: str) -> dict[str, float]:
        """Metric -> value of one run."""
        rows = self.results.loc[self.results["run"].eq(run)]
        return dict(zip(rows["metric"], rows["value"], strict=True))

    def merged(self, new: "Tables", replaced: Collection[str] = ()) -> "Tables":
        """These rows and those of `new`, sorted by run; a row that is here stays as it is.

        Of `new` come the runs that are not here, neither under their name nor, from another
        program, under another one. A failed run gives way to its later attempt, whatever program
        made it. Rows of a run that `runs` does not list, because a save was cut off, give way too.

        Args:
            new: What was found now.
            replaced: Names of runs that leave, whose identity may then come from `new`.
        """
        here, there, statuses = self.identities(), new.identities(), self.column("status")
        failed = {run for i, run in here.items() if statuses[run] == "failed" and i in there}
        gone = failed | {*replaced}
        taken = {identity for identity, run in here.items() if run not in gone}
        coming = {run for identity, run in there.items() if identity not in taken}
        joined = {}
        for name in SCHEMAS:
            mine, theirs = getattr(self, name), getattr(new, name)
            kept = mine.loc[~mine["run"].isin(gone | coming)]
            parts = [kept, theirs.loc[theirs["run"].isin(coming)]]
            frame = pd.concat([part for part in parts if len(part)] or parts[:1])
            joined[name] = frame.sort_values("run", kind="stable", ignore_index=True)
        return Tables(**joined)

    def save(self, directory: Path) -> None:
        """Writes the tables into `directory`; readers never see a half-written file.

        The table `runs` comes last: a run counts as recorded only when all else is written.
        """
        directory = Path(directory)
        directory.mkdir(parents=True, exist_ok=True)
        for name in SCHEMAS:
            table = getattr(self, name)
            part = directory / f".{name}.part"
            table.to_parquet(part, index=False)
            part.replace(directory / f"{name}.parquet")


def table(name: str, rows: list[dict] | pd.DataFrame) -> pd.DataFrame:
    """The table `name` of `SCHEMAS` from its rows, which are checked where `Tables` are made."""
    return (
        pd.DataFrame(rows, columns=list(SCHEMAS[name].columns))
        if len(rows)
        else _empty(name).copy()
    )


def stack(name: str, pieces: list[pd.DataFrame]) -> pd.DataFrame:
    """The table `name` of `SCHEMAS`, from pieces of it, one below the other."""
    return pd.concat([table(name, []), *pieces], ignore_index=True)


@functools.cache
def _empty(name: str) -> pd.DataFrame:
    """The table `name` without rows, with the types of its columns."""
    return SCHEMAS[name].validate(pd.DataFrame(columns=list(SCHEMAS[name].columns)))


def results_rows(content: Mapping, metrics: Mapping[str, float]) -> list[dict]:
    """Rows of the table `results` from a run's run.json and metrics."""
    shared = {column: content[column] for column in ("run", *IDENTITY, "status")}
    shared |= {
        "simulator": content["deployed_in"],
        "trained_effects": content.get("trained_effects", ""),
        "deployed_effects": content.get("deployed_effects", ""),
        "calibration_flights": content["ledger"]["calibration_flights"],
    }
    return [
        shared | {"metric": metric, "value": value, "unit": UNITS.get(metric, "")}
        for metric, value in metrics.items()
    ]


def runs_row(content: Mapping) -> dict:
    """The row of the table `runs` from a run's run.json."""
    resolved = content["resolved"]
    settings = {"method": resolved["settings"], "task": resolved["task_settings"]}
    cut_off = content["status"] == "failed" and content["interrupted"]
    own = ("run", *IDENTITY, "status", "key", "committed", "program")
    return {column: content[column] for column in own} | {
        "cause": f"{INTERRUPTED}{content['cause']}" if cut_off else content["cause"],
        "settings": json.dumps(settings, sort_keys=True),
        "versions": json.dumps(resolved["versions"] | content["packages"], sort_keys=True),
        **content["provenance"],
    }
