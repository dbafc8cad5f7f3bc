r"""Pooled numbers over strata and their intervals; seeds are resampled, in all strata alike.

A sample holds, for each stratum (a cell), one value per seed.

    IQM                 mean of the middle half of all values, strata weighing alike
    profile(tau)        share of values above tau
    P(a > b)            mean over strata of the share of pairs with a above b, ties counting half
    interval            percentiles of the bootstrap. Seeds are drawn with replacement, the same
                        ones in all strata with the same seeds, since a seed's runs have much in
                        common (`bench/stats/verdicts.py`)

A percentile interval covers less than 0.95. With 24 strata of five seeds an IQM's covers 0.82 to
0.87, with eight of three 0.72 to 0.76 (simulated, for correlations of 0 and 0.35 between a seed's
runs); drawn for each stratum by itself, as rliable does it, 0.44 and 0.63 with 0.35. Nothing is
decided by these intervals; differences of mean scores decide (`bench/stats/verdicts.py`). P(a > b)
is of two runs drawn independently, whatever their seeds, as its source has it.

Source: Agarwal et al. (2021), "Deep RL at the edge of the statistical precipice" (IQM, stratified
bootstrap, profiles, probability of improvement; package rliable).
"""

import functools
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from jaxtyping import Float, Int

from bench.stats.statistics import LEVEL

REPS = 5000
"""Resamples of every bootstrap."""

Sample = Mapping[Any, Mapping[int, float]]
"""Stratum (a cell) -> seed -> value."""


class Interval(NamedTuple):
    """A number with its 95 % percentile-bootstrap interval."""

    value: float
    low: float
    """NaN where some stratum has fewer than two seeds."""
    high: float

    def excludes(self, value: float) -> bool:
        """Whether there is an interval and `value` lies outside."""
        return self.high < value or self.low > value


def iqm(
    values: Float[np.ndarray, "*#reps values"], weights: Float[np.ndarray, "*#reps values"]
) -> Float[np.ndarray, "..."]:
    """Interquartile mean along the last axis.

    With equal weights, a quarter of the values, rounded down, is left out at each end (as rliable
    does it); with others, exactly a quarter of the weight.
    """
    n = values.shape[-1]
    if np.ptp(weights) == 0.0:
        cut = n // 4
        return np.asarray(np.sort(values, axis=-1)[..., cut : n - cut].mean(axis=-1))
    values, weights = np.broadcast_arrays(values, weights / weights.sum(axis=-1, keepdims=True))
    order = np.argsort(values, axis=-1)
    share = np.take_along_axis(weights, order, axis=-1)
    upper = np.cumsum(share, axis=-1)
    kept = np.minimum(upper, 0.75) - np.maximum(upper - share, 0.25)
    kept = np.maximum(kept, 0.0)
    ordered = np.take_along_axis(values, order, axis=-1)
    return np.asarray((kept * ordered).sum(axis=-1) / kept.sum(axis=-1))


def iqm_interval(sample: Sample, reps: int = REPS) -> Interval:
    """IQM of a sample."""
    weights = _weights(sample)
    drawn = iqm(_resampled(sample, reps), weights)
    return _interval(iqm(_values(sample), weights), drawn, _resamplable(sample))


def profile(sample: Sample, thresholds: Sequence[float], reps: int = REPS) -> list[Interval]:
    """Share of values above each threshold; the intervals hold one by one."""
    weights = _weights(sample) / _weights(sample).sum()
    values, drawn, enough = _values(sample), _resampled(sample, reps), _resamplable(sample)
    return [_interval((values > t) @ weights, (drawn > t) @ weights, enough) for t in thresholds]


def probability_of_improvement(a: Sample, b: Sample, reps: int = REPS) -> Interval:
    """Probability that a run of `a` has the higher value, mean over the strata of both.

    Raises:
        ValueError: They have no stratum in common.
    """
    strata = [stratum for stratum in a if stratum in b]
    if not strata:
        raise ValueError("`a` and `b` must have a stratum in common.")
    points, drawn = [], np.zeros(reps)
    for stratum in strata:
        x, y = _column(a[stratum]), _column(b[stratum])
        wins = 0.5 * (np.sign(x[:, None] - y[None]) + 1.0)
        points.append(wins.mean())
        first = _counts(tuple(sorted(a[stratum])), reps, 0)
        second = _counts(tuple(sorted(b[stratum])), reps, 1)
        drawn += np.einsum("ri,ij,rj->r", first, wins, second, optimize=True)
    enough = _resamplable(a) and _resamplable(b)
    return _interval(float(np.mean(points)), drawn / len(strata), enough)


def _interval(
    value: float | np.ndarray | np.floating, drawn: Float[np.ndarray, " reps"], enough: bool
) -> Interval:
    if not enough:
        return Interval(float(value), math.nan, math.nan)
    low, high = np.quantile(drawn, [0.5 - LEVEL / 2.0, 0.5 + LEVEL / 2.0])
    return Interval(float(value), float(low), float(high))


def _resamplable(sample: Sample) -> bool:
    return all(len(values) >= 2 for values in sample.values())


def _column(values: Mapping[int, float]) -> Float[np.ndarray, " seeds"]:
    """Values in the order of their seeds."""
    return np.asarray([values[seed] for seed in sorted(values)], dtype=float)


def _values(sample: Sample) -> Float[np.ndarray, " values"]:
    return np.concatenate([_column(values) for values in sample.values()])


def _weights(sample: Sample) -> Float[np.ndarray, " values"]:
    """Weight of each value: strata weigh alike, however many seeds they have."""
    return np.concatenate([np.full(len(v), 1.0 / len(v)) for v in sample.values()])


def _resampled(sample: Sample, reps: int) -> Float[np.ndarray, "reps values"]:
    drawn = [_column(values)[_draw(tuple(sorted(values)), reps)] for values in sample.values()]
    return np.concatenate(drawn, axis=1)


@functools.lru_cache(maxsize=1024)
def _draw(seeds: tuple[int, ...], reps: int, salt: int = 0) -> Int[np.ndarray, "reps seeds"]:
    """Which seeds are drawn; the same in all strata that have these, whoever else is compared."""
    entropy = [salt, *(abs(seed) for seed in seeds)]
    return np.random.default_rng(entropy).integers(len(seeds), size=(reps, len(seeds)))


@functools.lru_cache(maxsize=1024)
def _counts(seeds: tuple[int, ...], reps: int, salt: int) -> Float[np.ndarray, "reps seeds"]:
    """How often each seed is drawn, as a share."""
    drawn = _draw(seeds, reps, salt)
    return (drawn[:, :, None] == np.arange(len(seeds))).mean(axis=1)
