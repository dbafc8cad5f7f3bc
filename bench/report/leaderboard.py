"""Who does how well, cell by cell and overall, as Markdown.

The numbers are those of `bench/stats/leaderboard_rows.py` (cells), `bench/stats/standings.py` (over
cells) and `bench/stats/pooled.py` (scores pooled).
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
from bench.stats.leaderboard_rows import AXES, TARGET_MINUTES, TARGET_SECONDS, Row, leaderboard_rows
from bench.stats.pooled import Pool, pools
from bench.stats.standings import AXIS_HEADINGS, STANDING_HEADINGS, axis_lines, standing_lines
from bench.stats.target import REFERENCE, TOLERANCE
from bench.store.tables import Tables
from bench.text import markdown
from bench.text.numbers import MISSING, mean_std, number, seconds, significant, span

HOW_TO_READ = (
    "The settled reward is the return in the high-fidelity simulator from 2 s on, after take-off; "
    "the reward is that of the whole episode. Higher is better: mean ± standard deviation over the "
    "training seeds (n of them), then the 95 % t-interval of the settled reward's mean.",
    "Methods share a rank where the 95 % t-interval of their difference in settled reward (paired "
    "by seed where the seeds match, else Welch's; not corrected for the number of comparisons) "
    "contains 0, so a method that varies much between seeds can share a rank with better means. "
    "With one seed there is no interval and no order is claimed. `upper_reference` says what a "
    "score of 1 means and has no rank.",
    "A run that diverged counts with the policy that it left; a failed one left none. The last "
    "column counts and names both. `budget`: a run that its epochs ended where patience was meant "
    "to.",
    "`#` is the rank on an axis beside the reward, by the same rule, lower is better. "
    "Fleet-minutes and training time are a run's own, without those of what it starts from. To "
    "target: what it costs until the return of an episode comes within "
    f"{100 * TOLERANCE:.0f} % (of the return at the spawn) of the mean of `{REFERENCE.label}`, the "
    "costs of all runs over the runs that get there. Methods are ranked on it only if all their "
    "runs get there.",
    "A crash is the onset of a contact, per agent: another drone closer than 0.30 m, or the floor. "
    "Contacts are flags in this simulator: drones never push each other.",
)
"""What a reader must know, in Markdown."""


class Column(NamedTuple):
    """How a row is shown."""

    heading: str
    text: Callable[[Row], str]
    order: Callable[[Row], float | str]
    """Value to sort by."""


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
        parts += ["## Overall", _table(STANDING_HEADINGS, standing_lines(rows))]
        parts += ["## In how many cells best or tied", _table(AXIS_HEADINGS, axis_lines(rows))]
    for cell in dict.fromkeys(row["cell"] for row in rows):
        body = [[column.text(row) for column in COLUMNS] for row in rows if row["cell"] == cell]
        headings = [column.heading for column in COLUMNS]
        left = (1, len(headings) - 1)
        parts += [f"## {markdown.escape(cell.label)}", _table(headings, body, left)]
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text("\n\n".join(parts) + "\n", encoding="utf-8")


def made_by_text(tables: Tables) -> str:
    """Which programs made how many rows, and where, in one sentence; empty if no row says so."""
    runs = tables.runs.loc[tables.runs["commit"].ne("")]
    parts = []
    for (commit, dirty, machine), own in runs.groupby(["commit", "dirty", "machine"]):
        changed = " with changes" if dirty else ""
        parts.append(f"{len(own)} of {len(tables.runs)} at {commit[:10]}{changed} on {machine}")
    return f"Rows made: {'; '.join(parts)}." if parts else ""


def _pool_parts(pool: Pool) -> list[str]:
    """Parts of the document on one pool."""
    parts = [f"## {markdown.escape(pool_title(pool))}", _bullets(HOW_TO_READ_POOLED)]
    parts += [_table(pool_headings(pool), pool_lines(pool), left=(1, 2))]
    parts += [_table(improvement_headings(pool), improvement_lines(pool))]
    return [*parts, _bullets(map(markdown.escape, [EXCLUDES_HALF, *pool_remarks(pool)]))]


def _bullets(lines: Iterable[str]) -> str:
    return "\n".join(f"- {line}" for line in lines)


def _table(
    headings: Sequence[str], lines: Iterable[Sequence[str]], left: Iterable[int] = (0,)
) -> str:
    """A Markdown table of any texts."""
    escaped = [[markdown.escape(text) for text in line] for line in lines]
    return markdown.table([markdown.escape(heading) for heading in headings], escaped, left)


def _interval(row: Row) -> str:
    return span(row["reward_low"], row["reward_high"], 1)


def _metric(heading: str, name: str, text: Callable[[float], str]) -> Column:
    """The mean of a metric, with its rank if it is an axis."""

    def cell(row: Row) -> str:
        rank = row["axis_ranks"].get(name)
        return text(row["metrics"][name]) + (f" (#{rank})" if rank is not None else "")

    def order(row: Row) -> float:
        value = row["metrics"][name]
        return value if math.isfinite(value) else math.nan

    return Column(heading, cell, order)


def _axis(name: str, text: Callable[[float], str]) -> Column:
    return _metric(AXES[name], name, text)


def _target(name: str, text: Callable[[float], str]) -> Column:
    """The expected cost to reach the target, with how many runs reach it."""
    axis = _axis(name, text)

    def cell(row: Row) -> str:
        if row["reached"] is None:
            return MISSING
        reached, n = row["reached"]
        return axis.text(row) if reached == n else f"{axis.text(row)} ({reached} of {n} runs)"

    return axis._replace(text=cell)


def _digits(digits: int) -> Callable[[float], str]:
    return lambda value: number(value, digits)


COLUMNS = (
    Column(
        "rank",
        lambda row: MISSING if row["rank"] is None else str(row["rank"]),
        lambda row: math.nan if row["rank"] is None else row["rank"],
    ),
    Column("method", lambda row: row["method"], lambda row: row["method"]),
    Column(
        "settled reward (n)",
        lambda row: (
            f"{mean_std(row['reward_mean'], row['reward_std'])} (n = {row['n']})"
            if row["n"]
            else MISSING
        ),
        lambda row: row["reward_mean"],
    ),
    Column("95 % t-interval", _interval, lambda row: row["reward_low"]),
    _metric("reward", "reward", _digits(1)),
    _metric("settling time [s]", "settling_time", _digits(1)),
    _metric("position error [m]", "position_error", _digits(3)),
    _axis("crashes", _digits(2)),
    _axis("fleet_minutes", significant),
    _axis("training_crashes", _digits(0)),
    _metric("LF training collisions", "lf_collisions", _digits(0)),
    _metric("epochs", "epochs", _digits(0)),
    _axis("train_seconds", seconds),
    _target(TARGET_MINUTES, significant),
    _target(TARGET_SECONDS, seconds),
    Column("runs", lambda row: row["runs"], lambda row: row["runs"]),
)
"""Columns of a leaderboard, in order."""
