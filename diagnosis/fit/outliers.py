"""Windows that are left out because what happened in them says nothing of the rest."""

import numpy as np
from jaxtyping import Bool

from diagnosis.fit.likelihood import Normal, Spoiled

FEW = 0.25
"""Most windows that may be left out, of those soon after an unknown command. With two drones nearly
all are: 94 of 125 were left out with the gust in them, when it was excluded from the library."""
ALONE = 4.0
"""Misfit, in units of the median window's, of a window that stands out. Noise alone reaches 1.4. In
flights with a centre of mass 5 mm off, one upset of 53 degrees that RotorPy's attitude loop catches
otherwise had 80, 12 and 5 in a row; the offset came out at 0.4 of its size."""
RARE = 0.025
"""Most windows that may stand out alone, all in one flight; one at least."""
SEVERAL = 3
"""Flights below which no window is taken to stand out: that of a gust's onset would."""


def beyond(limit: float) -> Spoiled:
    """Windows `after_gaps`, with that limit, and `upsets` among the others."""

    def spoiled(normal: Normal) -> Bool[np.ndarray, " windows"]:
        bad = after_gaps(normal, limit)
        return bad | upsets(normal, ~bad)

    return spoiled


def after_gaps(normal: Normal, limit: float) -> Bool[np.ndarray, " windows"]:
    """Windows soon after an unknown command that fit worse than `limit` sigmas.

    All that there are, if they are one or `FEW` of them; else a bad fit is a finding.
    """
    z = (normal.c - normal.dof) / np.sqrt(2.0 * normal.dof)
    bad = normal.doubtful & (z > limit)
    return bad & (bad.sum() <= max(1.0, FEW * normal.doubtful.sum()))


def standing_out(aside: Normal | None, typical: float) -> Normal | None:
    """Of the windows left out, those with `ALONE` times the typical misfit; None without any."""
    if aside is None:
        return None
    alone = aside.of(aside.misfit > ALONE * typical)
    return alone if len(alone.c) else None


def upsets(normal: Normal, among: Bool[np.ndarray, " windows"]) -> Bool[np.ndarray, " windows"]:
    """The few windows of one flight that stand out `among` others (`ALONE`, `RARE`)."""
    misfit = normal.misfit
    bad = among & (misfit > ALONE * np.median(misfit[among])) if among.any() else among
    few = bad.sum() <= max(1.0, RARE * among.sum())
    several = len(np.unique(normal.flight)) >= SEVERAL
    return bad & (few and several and len(np.unique(normal.flight[bad])) == 1)
