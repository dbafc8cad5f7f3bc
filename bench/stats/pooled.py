"""Pools scores over many cells, world by world, and ranks entries with their ties.

The order is by the mean score, cells weighing alike. Who is above whom is decided by the difference
of mean scores over the cells that both flew (`bench/stats/verdicts.py`), the number that `bench
compare` gives, with Holm's correction over all pairs of the pool. The interquartile mean stands
beside as the number that a few bad runs do not move.

One cell has its t-intervals and is no pool. Only entries that flew the same cells can be pooled
together, with default settings. In each world the cells and entries are those that make the largest
full table, each place in it with two seeds or more; what is not in it is named with the reason. How
many runs failed or diverged in any cell of the world, pooled or not, stands beside; the diverged
ones count.
"""

import itertools
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from bench.stats.bootstrap import (
    Interval,
    Sample,
    iqm_interval,
    probability_of_improvement,
    profile,
)
from bench.stats.ranking import Above, intervals, letters
from bench.stats.scores import UPPER, fallen_references, scored, steadied_references
from bench.stats.statistics import (
    FEWEST_SEEDS,
    Cell,
    Entry,
    Estimate,
    Values,
    default_of,
    endings,
    estimate,
    lost,
    matched,
    seed_values,
)
from bench.stats.verdicts import Verdict, by_cell, over_cells
from bench.store.tables import Tables

MOST_SETS = 10_000
"""Sets of cells that are compared; more arise only among many entries with gaps of their own."""
GRID = 61
"""Scores at which profiles are drawn."""


class PooledRow(NamedTuple):
    """An entry over the cells of a pool."""

    entry: Entry
    mean: float
    """Mean score, cells weighing alike."""
    iqm: Interval
    """Interquartile mean of its scores."""
    rank: tuple[int, int]
    """First and last rank that the differences of all pairs leave open."""
    groups: str
    """Letters of its tie groups; entries that share one are not separated."""
    behind: Estimate | None
    """Mean score of the first row less its own, over the cells of both; None for the first."""
    shares: list[Interval]
    """Share of its runs with a score above each of the pool's thresholds."""
    profile: list[Interval]
    """The same above each score of the pool's grid."""
    seeds: tuple[int, int]
    """Fewest and most seeds in a cell."""
    n: int
    """Runs in its numbers."""
    lost: int
    """Runs that failed or diverged in any cell of the world."""


class Pool(NamedTuple):
    """Entries that flew the same cells in one world."""

    cells: list[Cell]
    rows: list[PooledRow]
    """Higher mean score first."""
    thresholds: list[float]
    """Scores: quartiles of all runs of the pool."""
    grid: list[float]
    """Scores from the lowest to the highest, evenly spaced, for a picture."""
    improvement: list[list[Interval | None]]
    """Probability that a run of the row's entry beats one of the column's; None on the diagonal."""
    left_out: list[tuple[Entry, str]]
    """Other entries of this world, and why they are not pooled."""
    without: list[tuple[Cell, str]]
    """Other cells of this world, and why they are not pooled."""
    steadied: list[Cell]
    """Cells in which a steady variant of the upper reference says what a score of 1 is."""


def pools(tables: Tables) -> list[Pool]:
    """A pool for each world in which there is something to pool, the undisturbed one first."""
    scores, rewards = (
        {
            cell: {e: v for e, v in own.items() if e.method != UPPER and default_of(e) == e}
            for cell, own in seed_values(rows, name).items()
        }
        for rows, name in ((scored(tables), "score"), (tables.results, "reward"))
    )
    scores = {cell: own for cell, own in scores.items() if own}
    gone = Counter[tuple[tuple[str, str], Entry]]()
    for cell, own in endings(tables).items():
        for entry, ended in own.items():
            gone[_world(cell), entry] += lost(ended)
    worlds = {_world(cell) for cell in rewards}
    fallen, steadied, found = fallen_references(tables), steadied_references(tables), []
    for world in sorted(worlds, key=lambda w: (w != ("crazyflow", ""), w)):
        own = {cell: values for cell, values in scores.items() if _world(cell) == world}
        flown = {cell: values for cell, values in rewards.items() if _world(cell) == world}
        cells, entries = _largest(own)
        if len(entries) >= 2 and len(cells) >= 2:
            without = _without(cells, entries, own, flown, fallen)
            steady = sorted(steadied.intersection(cells))
            found.append(_pool(world, cells, entries, own, flown, gone, without, steady))
    return found


def _world(cell: Cell) -> tuple[str, str]:
    """Where a cell is deployed: simulator and effects."""
    return cell.simulator, cell.deployed_effects


def _largest(values: Values) -> tuple[list[Cell], list[Entry]]:
    """Cells and entries of the largest full table; of equals the one with more cells."""
    covered: dict[Entry, frozenset[Cell]] = {}
    for cell, own in values.items():
        for entry, seeds in own.items():
            if len(seeds) >= FEWEST_SEEDS:
                covered[entry] = covered.get(entry, frozenset()) | {cell}
    sets: set[frozenset[Cell]] = set()
    for own in sorted(set(covered.values()), key=sorted):
        sets |= {own} | {own & other for other in sets}  # every intersection of any number
        sets = set(sorted(sets, key=lambda s: (-len(s), sorted(s)))[:MOST_SETS])

    def size(cells: frozenset[Cell]) -> tuple:
        n_entries = sum(cells <= own for own in covered.values())
        return (
            n_entries >= 2 and len(cells) >= 2,
            n_entries * len(cells),
            len(cells),
            sorted(cells),
        )

    best = max(sets, key=size, default=frozenset())
    return sorted(best), sorted(entry for entry, own in covered.items() if best and best <= own)


def _pool(
    world: tuple[str, str],
    cells: list[Cell],
    entries: list[Entry],
    scores: Values,
    rewards: Values,
    gone: Mapping[tuple[tuple[str, str], Entry], int],
    without: list[tuple[Cell, str]],
    steadied: list[Cell],
) -> Pool:
    samples = _matched(cells, entries, scores)
    means = {
        entry: estimate(estimate(own.values()).mean for own in sample.values()).mean
        for entry, sample in samples.items()
    }
    entries = sorted(entries, key=lambda entry: (-means[entry], entry))
    above = _above(entries, scores)
    values = [x for entry in entries for own in samples[entry].values() for x in own.values()]
    thresholds = [float(x) for x in np.quantile(values, [0.25, 0.5, 0.75])]
    grid = [float(x) for x in np.linspace(min(values), max(values), GRID)]
    rows = []
    for entry, rank, groups in zip(entries, intervals(above), letters(above), strict=True):
        seeds = [len(samples[entry][cell]) for cell in cells]
        beyond = profile(samples[entry], [*thresholds, *grid])
        rows.append(
            PooledRow(
                entry=entry,
                mean=means[entry],
                iqm=iqm_interval(samples[entry]),
                rank=rank,
                groups=groups,
                behind=None if entry == entries[0] else behind(entries[0], entry, scores),
                shares=beyond[: len(thresholds)],
                profile=beyond[len(thresholds) :],
                seeds=(min(seeds), max(seeds)),
                n=sum(seeds),
                lost=gone[world, entry],
            )
        )
    return Pool(
        cells=cells,
        rows=rows,
        thresholds=thresholds,
        grid=grid,
        improvement=_improvements(
            [{c: v[e] for c, v in scores.items() if e in v} for e in entries]
        ),
        left_out=_left_out(cells, set(entries), scores, rewards),
        without=without,
        steadied=steadied,
    )


def _matched(
    cells: list[Cell], entries: list[Entry], scores: Values
) -> dict[Entry, dict[Cell, dict[int, float]]]:
    """What is pooled of each entry: in each cell the seeds that all have, if two or more are."""
    found: dict[Entry, dict[Cell, dict[int, float]]] = {entry: {} for entry in entries}
    for cell in cells:
        own = {entry: scores[cell][entry] for entry in entries}
        common = set.intersection(*(set(values) for values in own.values()))
        for entry, values in own.items():
            kept = {seed: x for seed, x in values.items() if seed in common}
            found[entry][cell] = kept if len(common) >= FEWEST_SEEDS else dict(values)
    return found


def behind(best: Entry, entry: Entry, scores: Values) -> Estimate:
    """How far `entry` scores below `best`: mean over the cells of both, as in `bench compare`."""
    return over_cells(
        (own[best], own[entry]) for own in scores.values() if best in own and entry in own
    )


def _above(entries: Sequence[Entry], scores: Values) -> Above:
    """Whether each entry is shown to score higher than each that follows."""
    pairs = list(itertools.combinations(range(len(entries)), 2))
    verdicts = by_cell([behind(entries[i], entries[j], scores) for i, j in pairs])
    above = np.zeros((len(entries), len(entries)), dtype=bool)
    for pair, verdict in zip(pairs, verdicts, strict=True):
        above[pair] = verdict is Verdict.SUPPORTED
    return above


def improvement(a: Sample, b: Sample) -> Interval:
    """Probability that a run of `a` beats one of `b`.

    Over the cells in which both have two seeds or more, and there over the seeds that both have.

    Raises:
        ValueError: There is no such cell.
    """
    cells = [c for c in a if c in b and min(len(a[c]), len(b[c])) >= FEWEST_SEEDS]
    pairs = {cell: matched(a[cell], b[cell]) for cell in cells}
    return probability_of_improvement(
        {cell: pair[0] for cell, pair in pairs.items()},
        {cell: pair[1] for cell, pair in pairs.items()},
    )


def _improvements(samples: Sequence[Sample]) -> list[list[Interval | None]]:
    table: list[list[Interval | None]] = [[None] * len(samples) for _ in samples]
    for i, j in itertools.combinations(range(len(samples)), 2):
        found = improvement(samples[i], samples[j])
        table[i][j] = found
        table[j][i] = Interval(1.0 - found.value, 1.0 - found.high, 1.0 - found.low)
    return table


def _left_out(
    cells: list[Cell], pooled: set[Entry], scores: Values, rewards: Values
) -> list[tuple[Entry, str]]:
    found = []
    for entry in sorted({entry for own in rewards.values() for entry in own} - pooled):
        few = [c for c in cells if len(scores[c].get(entry, {})) < FEWEST_SEEDS]
        if not any(entry in own for own in scores.values()):
            reason = "it has no score"
        else:
            reason = f"fewer than {FEWEST_SEEDS} seeds in {len(few)} of {len(cells)} cells"
        found.append((entry, reason))
    return found


def _without(
    cells: list[Cell],
    entries: list[Entry],
    scores: Values,
    rewards: Values,
    fallen: set[Cell],
) -> list[tuple[Cell, str]]:
    found = []
    for cell in sorted(set(rewards) - set(cells)):
        own = scores.get(cell)
        few = [e.label for e in entries if own and len(own.get(e, {})) < FEWEST_SEEDS]
        reason = f"fewer than {FEWEST_SEEDS} seeds of {', '.join(few)}"
        bare = "its upper reference diverged" if cell in fallen else "no upper reference"
        found.append((cell, reason if own else bare))
    return found
