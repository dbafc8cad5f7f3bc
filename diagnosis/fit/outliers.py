"""Windows that are left out because what happened in them says nothing of the rest."""

import numpy as np
from jaxtyping import Bool

from diagnosis.decision import Decision
from diagnosis.fit.windows import Normal, Spoiled


def beyond(limit: float, decision: Decision = Decision()) -> Spoiled:
    """Windows `after_gaps`, with that limit, and `upsets` among the others."""

    def spoiled(normal: Normal) -> Bool[np.ndarray, " windows"]:
        bad = after_gaps(normal, limit, decision)
        return bad | upsets(normal, ~bad, decision)

    return spoiled


def after_gaps(
    normal: Normal, limit: float, decision: Decision = Decision()
) -> Bool[np.ndarray, " windows"]:
    """Windows soon after an unknown command that fit worse than `limit` sigmas.

    All that there are, if they are one or `doubtful_share` of them; else a bad fit is a finding.
    """
    z = (normal.c - normal.dof) / np.sqrt(2.0 * normal.dof)
    bad = normal.doubtful & (z > limit)
    return bad & (bad.sum() <= max(1.0, decision.doubtful_share * normal.doubtful.sum()))


def standing_out(
    aside: Normal | None, typical: float, decision: Decision = Decision()
) -> Normal | None:
    """Of the windows left out, those that stand out by `alone_misfit`; None without any."""
    if aside is None:
        return None
    alone = aside.of(aside.misfit > decision.alone_misfit * typical)
    return alone if len(alone.c) else None


def upsets(
    normal: Normal, among: Bool[np.ndarray, " windows"], decision: Decision = Decision()
) -> Bool[np.ndarray, " windows"]:
    """The few windows of one flight that stand out `among` others."""
    misfit = normal.misfit
    limit = decision.alone_misfit * np.median(misfit[among]) if among.any() else np.inf
    bad = among & (misfit > limit)
    few = bad.sum() <= max(1.0, decision.alone_share * among.sum())
    several = len(np.unique(normal.flight)) >= decision.alone_flights
    return bad & (few and several and len(np.unique(normal.flight[bad])) == 1)
