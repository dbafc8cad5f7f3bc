"""Ranks as intervals, and ties as letters, from who is shown to be better than whom.

Entries stand in the order of their means. One is shown to be better than another of lower mean if
the interval of their difference excludes 0.

    before(i, j)  i is ranked before j: some p and q, i <= p < q <= j, where p is shown to be
                  better than q
    first rank    1 + number of entries that are ranked before it
    last rank     number of entries - number of those that it is ranked before

Whoever is shown to be better than one entry is ranked before all of lower mean, so ranks follow the
means: seeds that scatter widely separate nobody, and the worst mean could else hold the first rank.
Letters are without that rule: entries that share one are not separated, whatever their ranks, and
how far apart they may lie is the interval of their difference.

Sources: Mogstad et al. (2024), "Inference for ranks" (intervals of ranks from differences); Tukey
(1949), "Comparing individual means in the analysis of variance" (ties are neighbours in the order
of means); Piepho (2004), "compact letter display".
"""

import itertools
from collections.abc import Mapping
from typing import NamedTuple

import networkx
import numpy as np
from jaxtyping import Bool

from bench.stats.statistics import FEWEST_SEEDS, Entry, Estimate, difference, estimate

Above = Bool[np.ndarray, "entries entries"]
"""Whether the row's entry is shown to be better than the column's."""


class Rank(NamedTuple):
    """The place of an entry."""

    place: int
    """By its mean alone, from 1."""
    first: int
    """Best rank that the differences leave open."""
    last: int
    """Worst one."""
    ties: str
    """Letters of its groups of entries that are not separated."""
    behind: Estimate | None
    """How far below the best mean; None for the best itself."""

    @property
    def text(self) -> str:
        """The interval, e.g. `1 to 3`."""
        return str(self.first) if self.first == self.last else f"{self.first} to {self.last}"


def ranks(samples: Mapping[Entry, Mapping[int, float]]) -> dict[Entry, Rank]:
    """Rank of each entry with two seeds or more, higher values first.

    With fewer seeds there is no interval, so that no order is claimed.
    """
    kept = {entry: values for entry, values in samples.items() if len(values) >= FEWEST_SEEDS}
    order = sorted(kept, key=lambda entry: (-estimate(kept[entry].values()).mean, entry))
    pairs = itertools.combinations(range(len(order)), 2)
    apart = {(i, j): difference(kept[order[i]], kept[order[j]]) for i, j in pairs}
    above = np.zeros((len(order), len(order)), dtype=bool)
    for pair, found in apart.items():
        above[pair] = found.low > 0.0
    places = zip(order, intervals(above), letters(above), strict=True)
    return {
        entry: Rank(i + 1, *ends, ties, apart.get((0, i)))
        for i, (entry, ends, ties) in enumerate(places)
    }


def intervals(above: Above) -> list[tuple[int, int]]:
    """First and last rank of entries in the order of their means."""
    before = np.maximum.accumulate(above, axis=1)
    before = np.maximum.accumulate(before[::-1], axis=0)[::-1]
    first, last = 1 + before.sum(axis=0), len(before) - before.sum(axis=1)
    return [(int(low), int(high)) for low, high in zip(first, last, strict=True)]


def letters(above: Above) -> list[str]:
    """Letters of each entry's tie groups, e.g. `a,b`."""
    found: list[list[str]] = [[] for _ in above]
    for i, group in enumerate(tie_groups(above)):
        for member in group:
            found[member].append(_letter(i))
    return [",".join(own) for own in found]


def tie_groups(above: Above) -> list[tuple[int, ...]]:
    """Largest groups of entries of which none is above another, in the order of their members.

    Groups overlap where ties are not transitive.
    """
    tied = ~(above | above.T)
    np.fill_diagonal(tied, False)
    groups = networkx.find_cliques(networkx.from_numpy_array(tied))
    return sorted(tuple(sorted(group)) for group in groups)


def _letter(index: int) -> str:
    """a, b, ..., z, a2, b2, ..."""
    turn, place = divmod(index, 26)
    return chr(ord("a") + place) + (str(turn + 1) if turn else "")
