"""Who does how well, cell by cell and pooled over cells, as Markdown.

`bench/stats/leaderboard_rows.py` computes the numbers of each cell, and `bench/stats/pooled.py` the
scores over cells.
"""

import math
from collections.abc import Callable, Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

from bench.report.pooled_text import (
    EXCLUDES_HALF,
    HOW_TO_READ_POOLED,
    improvement_headings,
    improvement_lines,
    pool_headings,
    pool_lines,
    pool_remarks,
    pool_title,
)
from bench.stats.leaderboard_rows import AXES, Row, leaderboard_rows
from bench.stats.pooled import Pool, pools
from bench.stats.statistics import Estimate
from bench.store.tables import Tables
from bench.text import markdown
from bench.text.markdown import text_table
from bench.text.numbers import (
    MISSING,
    mean_std,
    measured,
    places,
    seconds,
    significant,
    span,
)
from bench.text.pages import write_text

HOW_TO_READ = (
    "The settled reward is the return in the high-fidelity simulator from 2 s on, after take-off;"
    " the reward is that of the whole episode. Higher is better: mean ± standard deviation over "
    "the training seeds (n of them), then the 95 % t-interval of the settled reward's mean.",
    "A rank is an interval and follows the means: whoever is shown to be better than one method, "
    "by the 95 % t-interval of the difference in settled reward (paired by seed where the seeds "
    "match, else Welch's; not corrected for the number of comparisons), is ranked before all of "
    "lower mean. Methods that share a letter are not separated, which does not make them as good:"
    " *behind the best* says how far the mean lies below the best one, and how far it may. `bench"
    " compare` gives the same number. With one seed there is no interval and no order is claimed."
    " `upper_reference` says what a score of 1 means and has no rank; nor have settings other "
    "than the default, which have a table of their own.",
    "A run that diverged counts with the policy that it left; a failed one left none. The last "
    "column counts and names both. `budget`: a run that its epochs ended where patience was meant"
    " to.",
    "Numbers have as many digits as their intervals allow. `#` is the first rank on an axis other "
    "than the reward, by the same rule; the lowest value is the best. A row counts the "
    "crashes, fleet-minutes and time of its own training, not those of the run that it starts "
    "from. Only `hybrid_once` and `online` also count the fleet-minutes of the Hybrid that they "
    "start from. A row that only deploys another run's policy trains nothing, and has no rank on "
    "what a training costs. Training times have no ranks: they were taken on shared machines, "
    "and show the load as much as the method.",
    "A crash is the onset of a contact, per agent: another drone closer than 0.30 m, or the "
    "floor. Contacts are flags: drones push each other only in worlds with `collision`.",
)
"""What a reader must know, in Markdown."""

TRAINING_TIME = "training time"
"""Heading of its column."""


class Column(NamedTuple):
    """How a row is shown."""

    heading: str
    text: Callable[[Row], str]
    order: Callable[[Row], float | str]
    """Value to sort by; NaN where there is none."""
    left: bool = False
    """Whether it is text, aligned left."""


def write_leaderboard(tables: Tables, path: Path) -> None:
    """Writes the leaderboard as Markdown to `path`."""
    rows = leaderboard_rows(tables)
    parts = ["# Leaderboard", *filter(None, [markdown.escape(made_by_text(tables))])]
    parts.append(_bullets(HOW_TO_READ))
    if not rows:
        parts.append("There are no runs in these tables.")
    else:
        for pool in pools(tables):
            parts += _pool_parts(pool)
    for columns, own in split(rows):
        for cell in dict.fromkeys(row["cell"] for row in own):
            here = [row for row in own if row["cell"] == cell]
            shown = filled(columns, here)
            headings = [column.heading for column in shown]
            left = [i for i, column in enumerate(shown) if column.left]
            body = [[column.text(row) for column in shown] for row in here]
            title = cell.label + (", other settings" if columns is VARIANT_COLUMNS else "")
            parts += [f"## {markdown.escape(title)}", text_table(headings, body, left)]
    write_text(Path(path), "\n\n".join(parts) + "\n")


def made_by(tables: Tables) -> list[tuple[str, str, int]]:
    """Commit, machine and number of the rows that were made there; without rows that do not say."""
    runs = tables.runs.loc[tables.runs["commit"].ne("")]
    return [
        (f"{commit[:10]}{' with changes' if dirty else ''}", machine, len(own))
        for (commit, dirty, machine), own in runs.groupby(["commit", "dirty", "machine"])
    ]


def made_by_text(tables: Tables) -> str:
    """Which programs made how many rows, and where, in one sentence; empty if no row says so."""
    made, total = made_by(tables), len(tables.runs)
    parts = [f"{n} of {total} at {commit} on {machine}" for commit, machine, n in made]
    return f"Rows made: {'; '.join(parts)}." if parts else ""


def _pool_parts(pool: Pool) -> list[str]:
    """Parts of the document on one pool."""
    parts = [f"## {markdown.escape(pool_title(pool))}", _bullets(HOW_TO_READ_POOLED)]
    parts += [text_table(pool_headings(pool), pool_lines(pool), left=(1, 2))]
    parts += [text_table(improvement_headings(pool), improvement_lines(pool))]
    return [*parts, _bullets(map(markdown.escape, [EXCLUDES_HALF, *pool_remarks(pool)]))]


def _bullets(lines: Iterable[str]) -> str:
    return "\n".join(f"- {line}" for line in lines)


def split(rows: Iterable[Row]) -> list[tuple[tuple[Column, ...], list[Row]]]:
    """The rows that are ranked, then those of other settings, each with their columns."""
    rows = list(rows)
    ranked = [row for row in rows if row["default"] is None]
    variants = [row for row in rows if row["default"] is not None]
    return [(COLUMNS, ranked)] * bool(ranked) + [(VARIANT_COLUMNS, variants)] * bool(variants)


def filled(columns: Iterable[Column], rows: Sequence[Row]) -> list[Column]:
    """The columns in which some row has something."""
    return [c for c in columns if any(c.text(row) != MISSING for row in rows)]


def _half(row: Row) -> float:
    """Half the interval of the settled reward."""
    return 0.5 * (row["reward"].high - row["reward"].low)


def _reward(row: Row) -> str:
    found = row["reward"]
    if not found.n:
        return MISSING
    if found.n == 1:
        return f"{significant(found.mean, 3)} (n = 1)"
    return f"{mean_std(found.mean, found.std, places(_half(row)))} (n = {found.n})"


def _apart(found: Estimate | None) -> str:
    return measured(found.mean, found.low, found.high) if found else MISSING


def _metric(heading: str, name: str, text: Callable[[float], str]) -> Column:
    """The mean of a metric, with its rank if it is an axis."""

    def cell(row: Row) -> str:
        rank = row["axis_ranks"].get(name)
        return text(row["metrics"][name]) + (f" (#{rank.first})" if rank is not None else "")

    return Column(heading, cell, lambda row: row["metrics"][name])


_METHOD = Column("method", lambda row: row["method"], lambda row: row["method"], left=True)
_REWARD = Column("settled reward (n)", _reward, lambda row: row["reward"].mean)
_INTERVAL = Column(
    "95 % t-interval",
    lambda row: span(row["reward"].low, row["reward"].high, places(_half(row))),
    lambda row: row["reward"].low,
)
_COSTS = (
    _metric("reward", "reward", lambda value: significant(value, 3)),
    _metric("settling time [s]", "settling_time", significant),
    _metric("position error [m]", "position_error", significant),
    _metric(AXES["crashes"], "crashes", significant),
    _metric(AXES["fleet_minutes"], "fleet_minutes", significant),
    _metric(AXES["training_crashes"], "training_crashes", significant),
    _metric("LF training collisions", "lf_collisions", significant),
    _metric("epochs", "epochs", significant),
    _metric(TRAINING_TIME, "train_seconds", seconds),
    Column("runs", lambda row: row["runs"], lambda row: row["runs"], left=True),
)
COLUMNS = (
    Column(
        "rank",
        lambda row: row["rank"].text if row["rank"] else MISSING,
        lambda row: row["rank"].place if row["rank"] else math.nan,
    ),
    Column(
        "ties",
        lambda row: row["rank"].ties if row["rank"] else MISSING,
        lambda row: row["rank"].ties if row["rank"] else math.nan,
        left=True,
    ),
    _METHOD,
    _REWARD,
    _INTERVAL,
    Column(
        "behind the best",
        lambda row: _apart(row["rank"].behind if row["rank"] else None),
        lambda row: row["rank"].behind.mean if row["rank"] and row["rank"].behind else math.nan,
    ),
    *_COSTS,
)
"""Columns of a leaderboard, in order."""
VARIANT_COLUMNS = (
    _METHOD,
    _REWARD,
    _INTERVAL,
    Column(
        "above its default",
        lambda row: _apart(row["beside_default"]),
        lambda row: row["beside_default"].mean if row["beside_default"] else math.nan,
    ),
    *_COSTS,
)
"""Columns of the table of other settings: compared with the default, by the same interval."""
MAIN = (
    "rank",
    "ties",
    "method",
    "settled reward (n)",
    "behind the best",
    "above its default",
    AXES["fleet_minutes"],
    AXES["crashes"],
    TRAINING_TIME,
)
"""Headings that a page shows before it is asked for all."""
