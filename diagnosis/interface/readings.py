"""Which reading of a column agrees with what is known otherwise, tested against the one asked for.

A reading predicts something of every window. Under the reading that the format asks for, the sum of
its squared errors is no larger than another's but by chance. The ratio of two such sums of n
numbers each follows, at its widest, the F distribution with (n, n) degrees of freedom: both sums
share their errors, which draws the ratio nearer to 1. A reading replaces the one that is asked for
only if the ratio exceeds that distribution's quantile at `ALPHA` over the number of readings, and
if it explains at least `EXPLAINED` of what is predicted.
"""

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float
from scipy import stats

ALPHA = 1e-3
"""Probability of a false alarm of one test, at most; a choice: a dozen tests raise 1 % together."""
EXPLAINED = 0.5
"""Smallest share of the variance that the right reading of a column explains; a choice between the
0.95 to 0.99 of real and simulated flights, and the 0 of a column that holds something else."""
FEWEST_NUMBERS = 8
"""Fewest numbers; with fewer, the quantile is above 30."""

TURNED = "turned in yaw by any angle"
"""The reading of a frame that is turned. It is no order or sign of axes, and is meant only where
none of these fits as well; its angle is a size (`scales.py`)."""
RIGHT = math.radians(45.0)
"""Turn up to which each axis still has its own sign: half of a right angle."""
AXES = ("x", "y", "z")


@dataclasses.dataclass(frozen=True)
class Reading:
    """One way to read a column."""

    name: str
    """What the column would hold, in words; empty for what the format asks for."""
    error: float
    """Sum of squared errors of what it predicts."""
    simplicity: int = 0
    """Among readings that fit equally well, the smallest is meant."""


@dataclasses.dataclass(frozen=True)
class Chosen:
    """The reading that fits, of a column that can be tested."""

    names: tuple[str, ...]
    """The simplest reading that fits and others that fit as well; none if nothing is wrong."""
    explained: float
    """Share of the variance that it explains [-]."""
    asked: float
    """Share that the reading asked for explains [-]; below 0 where it is worse than nothing."""
    untold: tuple[str, ...] = ()
    """Axes that move too little to tell their sign."""


def choose(readings: Sequence[Reading], total: float, n: int) -> Chosen | None:
    """The reading that fits; None if the numbers do not tell.

    Args:
        readings: All of them, the one asked for first.
        total: Sum of squares of what is predicted, about its mean.
        n: How many independent numbers are predicted.
    """
    errors = np.asarray([reading.error for reading in readings])
    least = float(errors.min())
    if n < FEWEST_NUMBERS or total <= 0.0 or least > (1.0 - EXPLAINED) * total:
        return None
    most = _limit(least, total, len(readings), n)
    asked = 1.0 - float(errors[0]) / total
    if errors[0] <= most:
        return Chosen((), asked, asked)
    # Of readings that differ where nothing moves, the one with the fewest changes is meant.
    fits = [i for i, error in enumerate(errors) if error <= most]
    simplest = min(readings[i].simplicity for i in fits)
    alike = sorted((i for i in fits if readings[i].simplicity == simplest), key=errors.__getitem__)
    names = tuple(dict.fromkeys(readings[i].name for i in alike))
    return Chosen(names, 1.0 - float(errors[alike[0]]) / total, asked)


def choose_signs(
    chosen: Chosen | None, axes: Mapping[str, tuple[Sequence[Reading], float, int]]
) -> Chosen | None:
    """The choice of all axes together, with the sign of each axis tested by itself.

    An axis that moves much hides the sign of another that moves little. `axes` has the readings of
    each axis, its sum of squares and how many numbers it has, as `choose` takes them. Only a choice
    that finds nothing wrong is looked at again.
    """
    if chosen is None or chosen.names:
        return chosen
    untold = []
    for axis, (readings, total, n) in axes.items():
        one = choose(readings, total, n)
        if one is not None and one.names:
            return one
        errors = [reading.error for reading in readings]
        if one is None or max(errors) <= _limit(min(errors), total, len(errors), n):
            untold.append(axis)
    return dataclasses.replace(chosen, untold=tuple(untold))


def remainder(
    y: Float[np.ndarray, " rows"],
    free: Float[np.ndarray, "rows free"],
    along: Float[np.ndarray, " rows"] | None = None,
) -> float:
    """Squared error of `y` where `free` has any factors, and `along` one that is not negative."""
    if along is not None:
        columns = np.column_stack([along, free])
        fit, *_ = np.linalg.lstsq(columns, y, rcond=None)
        if fit[0] > 0.0:
            return float(np.sum((y - columns @ fit) ** 2))
    fit, *_ = np.linalg.lstsq(free, y, rcond=None)
    return float(np.sum((y - free @ fit) ** 2))


def lowest_at(x: Float[np.ndarray, " n"], y: Float[np.ndarray, " n"]) -> float:
    """Where `y` is lowest, by a parabola between values at equal distances."""
    i = int(np.argmin(y))
    if i in (0, len(x) - 1):
        return float(x[i])
    a, b, c = y[i - 1 : i + 2]
    bend = a - 2.0 * b + c
    return float(x[i] + (0.5 * (x[1] - x[0]) * (a - c) / bend if bend > 0.0 else 0.0))


def _limit(least: float, total: float, choices: int, n: int) -> float:
    """Largest error that is beyond the least one by chance."""
    # Sums of exact columns, as tests make them, are rounded.
    return float(stats.f.isf(ALPHA / choices, n, n)) * max(least, 1e-12 * total)


def signed_orders(n: int) -> list[tuple[str, int, Float[np.ndarray, "n n"]]]:
    """Every order and sign of `n` axes: in words, how many are not as asked, and as a matrix."""
    found = []
    for order in itertools.permutations(range(n)):
        for signs in itertools.product((1.0, -1.0), repeat=n):
            matrix = np.zeros((n, n))
            matrix[range(n), order] = signs
            moved = [i for i in range(n) if order[i] != i]
            flipped = [i for i in range(n) if signs[i] < 0]
            found.append((_words(order, flipped), len(set(moved) | set(flipped)), matrix))
    return sorted(found, key=lambda entry: entry[1])


def _words(order: Sequence[int], flipped: Sequence[int]) -> str:
    parts = []
    moved = [AXES[i] for i in range(len(order)) if order[i] != i]
    if len(moved) == 2:
        parts.append(" and ".join(moved) + " exchanged")
    elif moved:
        parts.append("axes in the order " + ", ".join(AXES[i] for i in order))
    if flipped:
        parts.append(" and ".join(AXES[i] for i in flipped) + " with the opposite sign")
    return ", ".join(parts)
