"""How far named effects shrink the drift of the changed flights, beside the twin alone."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from diagnosis.decision import Decision
from diagnosis.fit.shrinkage import shrink_of
from diagnosis.logs.segments import NODE_DT, REPLAY_WINDOW_S
from diagnosis.result_parts import ChannelShrink, Shrink
from diagnosis.twin.channels import ANGLES, Channels, N
from diagnosis.twin.hypothesis import Hypothesis
from diagnosis.twin.memory import LENGTH, rms
from diagnosis.twin.twin import Twin
from diagnosis.twin.units import Group, make_group


@dataclasses.dataclass(frozen=True)
class Scored:
    """One changed flight under the twin, and under the twin with the named effects.

    The effects have the sizes that the other changed flights show.
    """

    name: str
    """The flight's name."""
    valid: Bool[np.ndarray, " time"]
    """Samples that count."""
    before: Float[np.ndarray, "time 6"]
    """Measured minus twin, in the units of `channels.py`."""
    after: Float[np.ndarray, "time 6"]
    """The same with the named effects."""
    usual: Float[np.ndarray, "time 6"]
    """The same with these effects in the sizes that the reference flights show, which nobody
    changed: the misfit with the effects is judged beside this."""
    beyond: Float[np.ndarray, " 6"]
    """By how much each channel's error may be larger than in the reference (`Twin.beyond`)."""

    def drift(self, errors: Float[np.ndarray, "time 6"]) -> Float[np.ndarray, " windows"]:
        """Length of the position error after each whole window of valid samples [m].

        It is not a number for the others.
        """
        n = round(REPLAY_WINDOW_S / NODE_DT)
        whole = len(errors) // n * n
        acc = errors[:whole, ANGLES:].reshape(-1, n, 3)
        good = self.valid[:whole].reshape(-1, n).all(axis=1)
        to_go = (n - np.arange(n) - 0.5) * NODE_DT**2
        moved = np.linalg.norm(np.einsum("wni,n->wi", acc, to_go), axis=1)
        return np.where(good, moved, np.nan)


def score_flights(
    twin: Twin,
    unchanged: tuple[Channels, ...],
    fitting: tuple[Channels, ...],
    at: Hypothesis,
) -> tuple[Scored, ...]:
    """Every changed flight, without and with some effects.

    Args:
        twin: The reference's.
        unchanged: The flights, simulated without any change.
        fitting: The same, simulated where the effects fit.
        at: The effects.
    """
    shown = at.comparison.level(at.comparison.reference, at.columns)
    made = []
    for i, (plain, flight) in enumerate(zip(unchanged, fitting, strict=True)):
        before = after = usual = twin.errors(plain)
        if at.columns and len(fitting) > 1:
            after = _after(twin, flight, at, at.comparison.target.without(i))
        elif at.columns and len(parts := flight.parts(LENGTH)) > 1:
            after = _after_in_parts(twin, at, parts)
        if after is not before:
            usual = _errors_with(twin, plain, at, shown)
        made.append(Scored(plain.name, plain.valid, before, after, usual, twin.beyond(plain)))
    return tuple(made)


def _after(
    twin: Twin, flight: Channels, at: Hypothesis, others: Group
) -> Float[np.ndarray, "time 6"]:
    """Measured minus the twin with the effects in the sizes that other flights show."""
    shown = at.comparison.level(others, at.columns)
    return _errors_with(twin, flight, at, shown - at.change[list(at.columns)])


def _errors_with(
    twin: Twin, flight: Channels, at: Hypothesis, further: Float[np.ndarray, " k"]
) -> Float[np.ndarray, "time 6"]:
    """Measured minus the twin, with the effects larger by so much than where the flight is.

    `further` is in units of the ranges.
    """
    columns, width = list(at.columns), twin.library.high - twin.library.low
    slopes = twin.memory.respond(flight)[columns]
    return twin.errors(flight) - np.tensordot(further * width[columns], slopes, axes=1)


def _after_in_parts(
    twin: Twin, at: Hypothesis, parts: Sequence[Channels]
) -> Float[np.ndarray, "time 6"]:
    """The same of a single flight, each part in the sizes that its other parts show."""
    width = twin.library.high - twin.library.low
    group = make_group([twin.score(part) for part in parts], width)
    continued = group.continued(at.change)
    out = np.empty((0, N))
    for i, part in enumerate(parts):
        after = _after(twin, part, at, continued.without(i))
        out = np.concatenate([out, after[min(len(out), LENGTH) :]])
    return out


def misfit(twin: Twin, scored: Sequence[Scored]) -> tuple[float, float]:
    """Chi-square per number of the changed flights, without and with the named effects."""

    def chi2(when: str) -> float:
        return float(np.mean(np.concatenate([_squares(twin, one, when) for one in scored])))

    return chi2("before"), chi2("after")


def misfit_ratios(twin: Twin, scored: Sequence[Scored]) -> Float[np.ndarray, " flights"]:
    """Logarithm of each flight's misfit with the named effects over that in their usual sizes."""
    chi2 = [[_squares(twin, one, when).mean() for when in ("usual", "after")] for one in scored]
    before, after = np.log(chi2).T
    return after - before


def _squares(twin: Twin, one: Scored, when: str) -> Float[np.ndarray, " numbers"]:
    """Squared whitened errors of a flight: `before`, `after` or with the `usual` sizes."""
    return twin.colour.whiten(getattr(one, when) / one.beyond, one.valid).ravel() ** 2


def allowed(twin: Twin, scored: Sequence[Scored]) -> Float[np.ndarray, " 6"]:
    """Root mean square of each channel that the twin's own errors may have in these flights."""
    return twin.error * np.sqrt(np.mean([one.beyond**2 for one in scored], axis=0))


def excess_of(
    twin: Twin, scored: Sequence[Scored], errors: Sequence[Float[np.ndarray, "_ 6"]]
) -> Float[np.ndarray, " 6"]:
    """Squared error of each channel beyond what the twin allows, over the latter."""
    each = [rms([e], [one.valid]) for one, e in zip(scored, errors, strict=True)]
    floor = allowed(twin, scored) ** 2
    excess = np.maximum(np.mean(np.square(each), axis=0) - floor, 0.0) / np.maximum(floor, 1e-300)
    unseen = [c for c in range(len(excess)) if c not in twin.colour.seen]
    excess[unseen] = 0.0
    return excess


def left_share(twin: Twin, scored: Sequence[Scored]) -> float:
    """Share of the gap that the named effects leave; 0 without a gap beyond the twin's own."""
    before = float(excess_of(twin, scored, [one.before for one in scored]).sum())
    after = float(excess_of(twin, scored, [one.after for one in scored]).sum())
    return min(after / before, 1.0) if before > 0.0 else 0.0


def drift_shrink(
    scored: Sequence[Scored], by_channel: tuple[ChannelShrink, ...], decision: Decision
) -> Shrink:
    """How far the drift of the flights shrinks."""
    before = [one.drift(one.before) for one in scored]
    after = [one.drift(one.after) for one in scored]
    flown = np.repeat(np.arange(len(scored)), [len(x) for x in before])
    joined = np.concatenate(before), np.concatenate(after)
    return shrink_of(*joined, flown, by_channel, lofo=True, decision=decision)
