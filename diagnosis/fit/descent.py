r"""One candidate set taken through the simulator to its most likely parameters.

Steps are Gauss-Newton's, within the bounds. A `goal` is a log evidence [nats]: where a fit will
stay below it, its steps end early.
"""

import dataclasses

import numpy as np
from jaxtyping import Float

from diagnosis.fit.evidence import Evidence
from diagnosis.fit.fit import Fit, Set
from diagnosis.logs.segments import REPLAY_WINDOW_S

PARTS = (1.0, 0.5, 0.2, 0.05)
"""Parts of a Gauss-Newton step that are tried until one is better."""
DAMPINGS = (0.0, 1e-4, 1e-3, 1e-2, 0.1, 1.0)
"""Shares of its own curvature by which a step of all parameters at once is damped, in turn.
With 0.01 as the least, the fit of one set of reference flights crept along a valley to its side."""
REFIT_STEPS = 8
"""Most Gauss-Newton steps of a refit."""
SETTLED = 0.05
"""Fall of the objective, over the dispersion, below which a fit does not move any more."""
ACROSS = 0.1
"""How near an onset must be to the edge of a window for the window beside to be tried [s]."""


def fitted(evidence: Evidence, effects: Set, near: Fit, goal: float) -> Fit:
    """The set at its most likely parameters, started from what `near` promises."""
    starts = [] if near.effects == effects else _starts(evidence, effects, near)
    # A linear step may end where nothing is better; what it started from is never worse.
    fits = [
        evidence.made(effects, start, near.shared, whole=i == 0 and evidence.precision is not None)
        for i, start in enumerate((*starts, near.vector))
    ]
    best = min(fits, key=lambda fit: fit.objective)
    best = descended(evidence, best, goal)
    for name in sorted(effects & evidence.library.onsets.keys()):
        best = min(best, _across(evidence, best, name, goal), key=lambda fit: fit.objective)
    return whole(evidence, best, goal)


def descended(evidence: Evidence, fit: Fit, goal: float) -> Fit:
    """`fit` after as many steps as make it better."""
    for left in reversed(range(REFIT_STEPS)):
        better = _step(evidence, fit)
        gain = fit.objective - better.objective if better else 0.0
        fit = better or fit
        if _ends(evidence, fit, gain, left, goal):
            return fit
    return fit


def whole(evidence: Evidence, fit: Fit, goal: float) -> Fit:
    """`fit` along all parameters, taken further if that changes what it is worth."""
    found = evidence.made(fit.effects, fit.vector, fit.shared)
    if abs(found.objective - fit.objective) < evidence.phi:
        return found
    further = descended(evidence, found, goal)
    return evidence.made(fit.effects, further.vector, further.shared)


def polished(evidence: Evidence, fit: Fit, goal: float, steps: int = 2 * REFIT_STEPS) -> Fit:
    """`fit` with its whole shared shift flown, not taken to first order."""
    fit = evidence.as_flown(fit)
    for left in reversed(range(steps if evidence.precision is not None else 0)):
        further = _jointly(evidence, fit)
        gain, fit = fit.objective - further.objective, further
        if _ends(evidence, fit, gain, left, goal):
            break
    return fit


def _ends(evidence: Evidence, fit: Fit, gain: float, left: int, goal: float) -> bool:
    """Whether a fit that gained so much is settled, or will not reach `goal` in `left` steps."""
    reached = -0.5 * (fit.objective - left * gain) / evidence.phi
    return gain < SETTLED * evidence.phi or reached < goal


def _jointly(evidence: Evidence, fit: Fit) -> Fit:
    """A fit that flies better, by a step of the shared shift and the free parameters at once.

    Where flights hardly tell two of them apart (the arms of the rotors and the inertia, say),
    first order promises much that is not there: the step is damped until it is better.
    """
    for damping in DAMPINGS if np.isfinite(fit.normal.H).all() else ():
        vector, shared, promise = evidence.joint_step(fit, damping)
        if promise < SETTLED * evidence.phi:
            return fit  # a damped step promises less
        tried = evidence.as_flown(evidence.made(fit.effects, vector, shared, whole=False))
        if tried.objective < fit.objective:
            # What flights draw for themselves goes by slopes, which are anew here.
            tried = evidence.as_flown(evidence.made(fit.effects, vector, shared))
            if tried.objective < fit.objective:
                return tried
    return fit


def _step(evidence: Evidence, fit: Fit) -> Fit | None:
    """A fit that is better, along the Gauss-Newton step or a part of it."""
    free = evidence.free(fit.effects)
    step, promise = evidence.bounded(fit.normal, fit, free)
    if promise < 0.02 * evidence.phi:
        return None
    follows = evidence.following(fit, free, step)
    for part in PARTS:
        vector = fit.vector.copy()
        vector[free] += part * step
        shift = evidence.inwards(vector, part * follows)
        tried = evidence.made(fit.effects, vector + shift, fit.shared + shift, whole=False)
        if tried.objective < fit.objective:
            return tried
    return None


def _across(evidence: Evidence, fit: Fit, name: str, goal: float) -> Fit:
    """The fit whose effect `name` sets in on the other side of the nearest edge of a window.

    An onset shortly before an edge leaves a second minimum shortly behind it: to the window
    after, a start that is off and a push that sets in late look much the same.
    """
    at = evidence.library.onsets[name]
    edge = REPLAY_WINDOW_S * round(fit.vector[at] / REPLAY_WINDOW_S)
    if abs(fit.vector[at] - edge) > ACROSS:
        return fit
    vector = fit.vector.copy()
    vector[at] = edge + 0.597 * (-ACROSS if vector[at] >= edge else ACROSS)
    vector = evidence.within(vector, evidence.free(fit.effects))
    made = evidence.made(fit.effects, vector, fit.shared, whole=False)
    return descended(evidence, made, goal)


def _starts(evidence: Evidence, effects: Set, near: Fit) -> list[Float[np.ndarray, " params"]]:
    """Where to start: one vector, but two where an onset may lie in either of two windows.

    An onset has a slope only while it lies within its window and between two steps.
    """
    starts, silent = [_start(evidence, effects, near)], evidence.silent(effects, near)
    for at in silent.values():
        either = [(start, shift) for start in starts for shift in (-0.4987, 0.5013)]
        starts = [start.copy() for start, _ in either]
        for start, (_, shift) in zip(starts, either, strict=True):
            start[at] += shift * REPLAY_WINDOW_S
    return starts


def _start(evidence: Evidence, effects: Set, near: Fit) -> Float[np.ndarray, " params"]:
    """Inside the bounds: the linear solution at `near`, or the start that is declared."""
    library, fresh = evidence.library, near.vector.copy()
    for name in effects - near.effects:
        for parameter, value in library.card(name).start.items():
            fresh[evidence.place(name, parameter)] = value
    normal, times = evidence.set_in(effects, near)
    for name, time in times.items():
        fresh[library.onsets[name]] = time
    fresh, free = evidence.within(fresh, evidence.free(effects)), evidence.felt(effects, near)
    fresh[free] += evidence.bounded(normal, dataclasses.replace(near, vector=fresh), free)[0]
    return fresh
