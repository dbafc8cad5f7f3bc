"""Estimates, intervals and ties with the training seed as the unit of replication.

    interval of a mean          mean +- t(0.975, n - 1) s / sqrt(n)
    interval of a difference    the same on the differences of the seeds that both have; where both
                                have two seeds or more but share less, Welch's, with Satterthwaite's
                                degrees of freedom

An evaluation of many episodes is one number here. A run that diverged counts with the policy that
it left (intention to treat); one that failed left none. How many did either stands beside every
mean. Intervals are not corrected for the number of comparisons; verdicts are
(`bench/stats/verdicts.py`).

Sources: Student (1908); Welch (1947). With five seeds the t-interval covers 0.95 where the
percentile bootstrap covers 0.88 (measured by simulation).
"""

import dataclasses
import math
import re
from collections.abc import Collection, Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd
from scipy import stats

from bench.plan.planned_run import REALITY
from bench.plan.realities import joined, shortened
from bench.store.tables import Tables
from bench.text.errors import UsageError

COUNTED = ("ok", "budget", "diverged")
"""Statuses of runs that left a policy, which counts; a failed run left none."""
FAILURES = ("failed", "diverged")
"""Statuses of runs that did not go well; their share is shown beside every mean."""

LEVEL = 0.95
"""Coverage of every interval."""
FEWEST_SEEDS = 2
"""Seeds that an entry needs in a cell, where cells are compared or pooled."""
_EFFECT = r"\w+\((?:[^()]|\([^()]*\))*\)"
_WORLD = re.compile(rf"(?:reality|deployed_in)=(\w+)(?:\+({_EFFECT}(?:; {_EFFECT})*))?")


class Entry(NamedTuple):
    """What competes in a cell."""

    method: str
    residual: str = ""
    variant: str = ""

    @property
    def label(self) -> str:
        """The name to show, e.g. `hybrid (mlp)`."""
        name = f"{self.method} ({self.residual})" if self.residual else self.method
        return ", ".join(filter(None, [name, shortened(self.variant)]))


def on_top(entries: Iterable[Entry]) -> set[Entry]:
    """Entries with a residual on top of a method that does without: a setting, not a method."""
    found = {*entries}
    without = {entry.method for entry in found if not entry.residual}
    return {entry for entry in found if entry.residual and entry.method in without}


class Cell(NamedTuple):
    """Where entries compete: same task, team size and world, so the same initial states."""

    task: str
    team_size: int
    simulator: str = REALITY
    deployed_effects: str = ""

    @property
    def world(self) -> str:
        """Where it is flown: by the name that the world has, else simulator and effects."""
        effects = f" with {self.deployed_effects}" if self.deployed_effects else ""
        return self._named or f"{self.simulator or REALITY}{effects}"

    @property
    def label(self) -> str:
        """The name to show, e.g. `circle, N = 3`."""
        name = f"{self.task}, N = {self.team_size}"
        if self._named:
            return f"{name}, flown in {self._named}"
        extras = [
            self.simulator != REALITY and f"flown in {self.simulator}",
            self.deployed_effects and f"flown with {self.deployed_effects}",
        ]
        return ", ".join([name, *filter(None, extras)])

    @property
    def _named(self) -> str:
        """The name of its world; empty where it has none."""
        world = joined(self.simulator, self.deployed_effects)
        named = shortened(world)
        return named if named != world else ""


Values = dict[Cell, dict[Entry, dict[int, float]]]
"""Values of a metric by cell, entry and seed."""


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A mean over seeds, or a difference of two, in one cell or over many."""

    mean: float
    """Mean, or difference of means; NaN without values."""
    std: float
    """Sample standard deviation (n - 1); NaN below two seeds, for Welch differences, over cells."""
    n: int
    """Number of seeds; in a Welch difference, of the smaller sample; over cells, of all."""
    low: float
    """Lower end of the 95 % t-interval; NaN below two seeds."""
    high: float
    """Upper end."""
    freedom: float = math.nan
    """Degrees of freedom of the interval; NaN without one."""

    @property
    def has_interval(self) -> bool:
        """Whether there are seeds enough for an interval."""
        return self.n >= 2

    @property
    def excludes_zero(self) -> bool:
        """Whether the interval exists and does not contain 0."""
        return self.has_interval and not self.low <= 0.0 <= self.high

    @property
    def p(self) -> float:
        """Two-sided p-value of "it is 0"; NaN without an interval."""
        if math.isnan(self.low):
            return math.nan
        half = 0.5 * (self.high - self.low)
        if half == 0.0:
            return float(self.mean == 0.0)
        error = half / _quantile(self.freedom)
        return float(2.0 * stats.t.sf(abs(self.mean) / error, self.freedom))


def estimate(values: Iterable[float]) -> Estimate:
    """Mean, standard deviation and t-interval of one value per seed."""
    x = np.asarray(list(values), dtype=float)
    if x.size == 0:
        return Estimate(math.nan, math.nan, 0, math.nan, math.nan)
    if x.size == 1:
        return Estimate(float(x[0]), math.nan, 1, math.nan, math.nan)
    mean, std = float(x.mean()), float(x.std(ddof=1))
    half = _quantile(x.size - 1) * std / math.sqrt(x.size)
    return Estimate(mean, std, x.size, mean - half, mean + half, x.size - 1)


def difference(a: Mapping[int, float], b: Mapping[int, float]) -> Estimate:
    """Mean of `a` minus mean of `b`, values by seed: paired over common seeds, else Welch."""
    first, second = matched(a, b)
    if set(first) == set(second):
        return estimate(first[seed] - second[seed] for seed in first)
    first, second = estimate(a.values()), estimate(b.values())
    mean, n = first.mean - second.mean, min(first.n, second.n)
    if n < 2:
        return Estimate(mean, math.nan, n, math.nan, math.nan)
    u, v = first.std**2 / first.n, second.std**2 / second.n
    if u + v == 0.0:
        return Estimate(mean, math.nan, n, mean, mean)
    freedom = (u + v) ** 2 / (u**2 / (first.n - 1) + v**2 / (second.n - 1))
    half = _quantile(freedom) * math.sqrt(u + v)
    return Estimate(mean, math.nan, n, mean - half, mean + half, freedom)


def matched(
    a: Mapping[int, float], b: Mapping[int, float]
) -> tuple[dict[int, float], dict[int, float]]:
    """The values of two samples, by seed, that are compared: the common seeds, or all.

    Everything is where less than two seeds are common, although both have two or more.
    """
    common = [seed for seed in a if seed in b]
    if len(common) < min(2, len(a), len(b)):
        return dict(a), dict(b)
    return {seed: a[seed] for seed in common}, {seed: b[seed] for seed in common}


def seed_values(results: pd.DataFrame, metric: str) -> Values:
    """Values of one metric by cell, entry and seed, of runs that count, cells in order.

    Raises:
        UsageError: Two runs claim the same cell, entry and seed.
    """
    values = np.asarray(results["value"], dtype=float)
    kept = results["metric"].eq(metric) & results["status"].isin(COUNTED) & np.isfinite(values)
    found: Values = {}
    owner: dict[tuple[Cell, Entry, int], str] = {}
    for row in records(results.loc[kept]):
        cell, entry, seed = cell_of(row), entry_of(row), int(row["seed"])
        first = owner.setdefault((cell, entry, seed), row["run"])
        if first != row["run"]:
            raise UsageError(
                f"Runs {first!r} and {row['run']!r} both report {entry.label} on {cell.label}, "
                f"seed {seed}; the tables must hold one run for each. Remove one of them."
            )
        found.setdefault(cell, {}).setdefault(entry, {})[seed] = float(row["value"])
    return dict(sorted(found.items()))


def records(frame: pd.DataFrame) -> list[dict[str, Any]]:
    """The rows of a table, one dictionary each.

    As pandas' `to_dict("records")`, but column by column: 0.1 for 0.75 s for `results/paper`.
    """
    names = [str(name) for name in frame.columns]
    columns = (frame.iloc[:, i].tolist() for i in range(len(names)))
    return [dict(zip(names, row, strict=True)) for row in zip(*columns, strict=True)]


def entry_of(row: Mapping[str, Any]) -> Entry:
    """The entry that a row of `results` or `runs` belongs to."""
    return Entry(*(str(row.get(name, "")) for name in Entry._fields))


def cell_of(row: Mapping[str, Any]) -> Cell:
    """The cell that a row of `results` belongs to."""
    return Cell(*(row[name] for name in Cell._fields))


def without_world(variant: str) -> tuple[str, bool]:
    """A variant without the world that it names, and whether it was only deployed there."""
    named = _WORLD.search(variant)
    if named is None:
        return variant, False
    parts = (variant[: named.start()].strip(", "), variant[named.end() :].strip(", "))
    return ", ".join(filter(None, parts)), named[0].startswith("deployed_in=")


def default_of(entry: Entry) -> Entry:
    """`entry` with default settings, in the same world; itself if it has them."""
    world = _WORLD.search(entry.variant)
    return entry._replace(variant=world[0] if world else "")


def cells_meant(
    task: str, team_size: int, variant: str, known: Collection[Cell], home: str = REALITY
) -> set[Cell]:
    """The cells in which a run was planned to fly, where it ended before its evaluation.

    Its variant may name their world; otherwise it is the `home` of the sweep without effects, if
    that is any of `known`, the cells of its task and team size.
    """
    if named := _WORLD.search(variant):
        return {Cell(task, team_size, named[1], named[2] or "")}
    plain = {c for c in known if not c.deployed_effects and c.simulator == home}
    return plain or set(known) or {Cell(task, team_size)}


def home_of(tables: Tables) -> str:
    """The high-fidelity simulator in which rows flew whose variant names no world."""
    named = pd.DataFrame(tables.results[["run", "simulator", "variant"]])
    found = {
        row["simulator"]
        for row in records(named.drop_duplicates("run"))
        if not _WORLD.search(row["variant"])
    }
    return REALITY if REALITY in found or not found else min(found)


Endings = Mapping[str, list[int]]
"""Status -> seeds of the runs that ended so."""


def flown_in(tables: Tables) -> dict[str, list[tuple[Cell, Entry]]]:
    """Where each run was evaluated, or was meant to be if it failed before its evaluation."""
    found: dict[str, list[tuple[Cell, Entry]]] = {}
    worlds: dict[tuple[str, int], set[Cell]] = {}
    home = home_of(tables)
    for row in records(tables.results.drop_duplicates(["run", "simulator", "deployed_effects"])):
        cell = cell_of(row)
        found.setdefault(row["run"], []).append((cell, entry_of(row)))
        worlds.setdefault((cell.task, cell.team_size), set()).add(cell)
    for row in records(_every_run(tables)):
        entry, size = entry_of(row), (str(row["task"]), int(row["team_size"]))
        meant = cells_meant(*size, entry.variant, worlds.get(size, set()), home)
        found.setdefault(row["run"], [(cell, entry) for cell in meant])
    return found


def endings(tables: Tables) -> dict[Cell, dict[Entry, dict[str, list[int]]]]:
    """Seeds by cell, entry and status, of every run."""
    flown = flown_in(tables)
    found: dict[Cell, dict[Entry, dict[str, list[int]]]] = {}
    for row in records(_every_run(tables)):
        for cell, entry in flown[row["run"]]:
            ended = found.setdefault(cell, {}).setdefault(entry, {})
            ended.setdefault(row["status"], []).append(int(row["seed"]))
    return found


def lost(ended: Endings) -> int:
    """Number of runs that failed or diverged."""
    return sum(len(seeds) for status, seeds in ended.items() if status in FAILURES)


def endings_text(ended: Endings, counted: Collection[int]) -> str:
    """Runs by status, with the seeds of those that are not `ok`.

    Args:
        ended: How the runs of an entry in a cell ended.
        counted: Seeds that are in the mean.
    """
    parts = []
    for status in sorted(ended, key=lambda s: (s != "ok", s)):
        seeds = sorted(ended[status])
        named = f" (seed {', '.join(map(str, seeds))})" if status != "ok" else ""
        parts.append(f"{len(seeds)} {status}{named}")
        if status in COUNTED and (silent := [seed for seed in seeds if seed not in counted]):
            parts.append(f"no reward from seed {', '.join(map(str, silent))}")
    return ", ".join(parts)


def _every_run(tables: Tables) -> pd.DataFrame:
    columns = ["run", "method", "residual", "variant", "task", "team_size", "seed", "status"]
    both = pd.concat([tables.runs, tables.results], ignore_index=True)
    return both.drop_duplicates("run").filter(columns)


def _quantile(freedom: float) -> float:
    return float(stats.t.ppf(0.5 + LEVEL / 2.0, freedom))
