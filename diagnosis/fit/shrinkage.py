"""How far the gap shrinks: drift over half a second on flights that the fit never saw.

With ten flights or more, a third of them is kept out of everything. With fewer, every flight is
scored under parameters fitted to the others: leave one flight out, by one step from the fit to all,
or the part of it with which the others fit no worse. Which effects were chosen, and which windows
count nowhere, all flights have said. The drift is measured from the smoothed measured state, noise
not subtracted. Flights weigh as they have windows, in the percentage and in its interval, which is
a t-interval of the log ratio by the jackknife over flights (in a mean of the flights' own log
ratios, one of a second would weigh like one of a minute):

    r = ln(RMS after / RMS before),     r_f the same without flight f,     n flights
    r +- t(0.975, n - 1) sqrt((n - 1) / n sum_f (r_f - mean r_f)^2)

Source of the jackknife: Efron (1982).
"""

import dataclasses

import numpy as np
from jaxtyping import Float, Int

from diagnosis.decision import Decision
from diagnosis.fit.descent import PARTS
from diagnosis.fit.evidence import Evidence
from diagnosis.fit.fit import Fit
from diagnosis.fit.gap import channels, drifts, half_width, rms
from diagnosis.fit.likelihood import Likelihood
from diagnosis.fit.search import Fits
from diagnosis.fit.windows import Tracks
from diagnosis.logs.segments import REPLAY_WINDOW_S
from diagnosis.result_parts import ChannelShrink, Shrink


def split(n_flights: int, decision: Decision = Decision()) -> tuple[list[int], list[int]]:
    """Flights to fit and flights to hold out; the same ones twice where there are too few."""
    every = list(range(n_flights))
    if n_flights < decision.held_out_flights:
        return every, every
    held = every[1::3]
    return [i for i in every if i not in held], held


@dataclasses.dataclass(frozen=True)
class Drift:
    """Position drift of scored windows, nominal and corrected."""

    before: Tracks
    """Under the nominal simulator (with a reference: under what fits the reference)."""
    after: Tracks
    """With the chosen effects; parameters from other flights."""


def left_out(evidence: Evidence, fit: Fit, flight: int) -> Float[np.ndarray, " params"]:
    """The fit's parameters without one flight, by the normal equations at the fit.

    What the flights share with a reference is estimated from those that are left, too.
    """
    return _step_without(evidence, evidence.as_flown(fit), flight)[0]


def flown_without(evidence: Evidence, fit: Fit, flight: int) -> Float[np.ndarray, " params"]:
    """`left_out`, but only as far as the other flights fit no worse there than at the fit.

    Far from its flights a simulator is not linear, and the step to the others' best may lead to
    where they fly worse.
    """
    start = evidence.as_flown(fit)
    vector, shared = _step_without(evidence, start, flight)
    most = _objective_without(start, flight)
    for part in PARTS:
        there = start.vector + part * (vector - start.vector)
        own = start.shared + part * (shared - start.shared)
        tried = evidence.as_flown(evidence.made(fit.effects, there, own, whole=False))
        if _objective_without(tried, flight) <= most:
            return there
    return start.vector


def _step_without(
    evidence: Evidence, flown: Fit, flight: int
) -> tuple[Float[np.ndarray, " params"], Float[np.ndarray, " params"]]:
    """Vector and shared shift one step from a fit, as the other flights ask."""
    others = flown.normal.of(flown.normal.flight != flight)
    if evidence.precision is not None:
        return evidence.joint_step(flown, others=others)[:2]
    free = evidence.free(flown.effects)
    step, _ = evidence.solve(others, flown, free)
    vector = flown.total.copy()
    vector[free] = np.clip(vector[free] + step, evidence.low[free], evidence.high[free])
    return vector, flown.shared


def _objective_without(fit: Fit, flight: int) -> float:
    """Chi-square of the other flights, and of the shift."""
    return fit.normal.of(fit.normal.flight != flight).chi2 + fit.penalty


def score(evidence: Evidence, fit: Fit, scored: Likelihood, n_flights: int, lofo: bool) -> Drift:
    """Tracks of the flights in `scored`; leaving one out in turn where `lofo`."""
    before = scored.tracks(evidence.base)
    if not lofo:
        return Drift(before, scored.tracks(fit.total))
    vectors = np.stack([flown_without(evidence, fit, flight) for flight in range(n_flights)])
    return Drift(before, scored.tracks(vectors))


def shrink(
    drift: Drift,
    sigma: Float[np.ndarray, " 9"],
    lofo: bool,
    decision: Decision = Decision(),
) -> Shrink:
    """The diagnosis' `shrink`."""
    before, after = (np.linalg.norm(drifts(t)[:, :3], axis=1) for t in (drift.before, drift.after))
    by_channel = _by_channel(drift, sigma)
    return shrink_of(before, after, drift.before.flight, by_channel, lofo, decision)


def shrink_of(
    before: Float[np.ndarray, " windows"],
    after: Float[np.ndarray, " windows"],
    flown: Int[np.ndarray, " windows"],
    by_channel: tuple[ChannelShrink, ...],
    lofo: bool,
    decision: Decision = Decision(),
) -> Shrink:
    """The shrinkage of drifts [m] in windows of the flights `flown`; windows without one are NaN.

    With `lofo`, each flight was left out in turn.
    """
    seen = np.isfinite(before)
    before, after, flown = before[seen], after[seen], flown[seen]
    sizes = {f: (rms(before[flown == f]), rms(after[flown == f])) for f in np.unique(flown)}
    flights = [f for f, pair in sizes.items() if min(pair) > 0.0]
    n, lost = len(flights), int(np.sum(~np.isfinite(after)))
    fewest = decision.fewest_flights
    if lost or n < fewest:
        few = f"{n} flight{'s' if n != 1 else ''} with windows; at least {fewest} are needed"
        cannot = f"with the chosen effects the simulator cannot be flown in {lost} windows"
        return unknown_shrink(n, cannot if lost else few)

    def log_ratio(chosen: np.ndarray) -> float:
        return float(np.log(rms(after[chosen]) / rms(before[chosen])))

    kept = np.isin(flown, flights)
    ratio, without = log_ratio(kept), np.asarray([log_ratio(kept & (flown != f)) for f in flights])
    half = half_width(without)
    return Shrink(
        horizon_s=REPLAY_WINDOW_S,
        n=n,
        before=rms(before[kept]),
        after=rms(after[kept]),
        percent=100.0 * (1.0 - float(np.exp(ratio))),
        low=100.0 * (1.0 - float(np.exp(ratio + half))),
        high=100.0 * (1.0 - float(np.exp(ratio - half))),
        by_channel=by_channel,
        how="leave one flight out" if lofo else "flights held out",
        reason=None,
    )


def unknown_shrink(n: int, reason: str) -> Shrink:
    """A shrinkage that `n` flights do not tell, with the reason."""
    empty = dict.fromkeys(("before", "after", "percent", "low", "high", "how"))
    return Shrink(horizon_s=REPLAY_WINDOW_S, n=n, by_channel=(), reason=reason, **empty)


def _by_channel(drift: Drift, sigma: Float[np.ndarray, " 9"]) -> tuple[ChannelShrink, ...]:
    found = []
    pairs = zip(channels(drift.before, sigma), channels(drift.after, sigma), strict=True)
    for old, new in pairs:
        a, b = rms(old.value), rms(new.value)
        percent = 100.0 * (1.0 - b / a) if a > 0 else None
        found.append(
            ChannelShrink(channel=old.name, before=a, after=b, percent=percent, unit=old.unit)
        )
    return tuple(found)


def misfits(evidence: Evidence, fit: Fit) -> Float[np.ndarray, " flights"]:
    """Chi-square of every flight under parameters fitted to the others, to first order."""
    found = []
    for flight in np.unique(fit.normal.flight):
        mine = fit.normal.of(fit.normal.flight == flight)
        step = left_out(evidence, fit, int(flight)) - fit.total
        found.append(mine.c.sum() - 2 * mine.g.sum(0) @ step + step @ mine.H.sum(0) @ step)
    return np.asarray(found)


def left_out_gain(fits: Fits, fit: Fit) -> float:
    """Log-likelihood gain over no effect on flights left out in turn, in nats."""
    both = (misfits(fits.evidence, one).sum() for one in (fits.nominal, fit))
    return float(0.5 * np.subtract(*both) / fits.evidence.phi)
