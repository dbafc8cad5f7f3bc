"""Whether a value that was measured again agrees with those of other seeds.

Trainings are chaotic: another processor rounds differently, and after some hundred epochs the same
seed is as far from itself as from another seed. So a value that is not reproduced to the digit is
held against the prediction interval of one more seed,

    mean +- t(0.975, n - 1) s sqrt(1 + 1/n)

of the n values that were submitted. It says little where the seeds are few, or so far apart that
the interval holds a team that does nothing; then nothing can be told. By construction 1 of 20
honest submissions is found to differ. Source: Hahn and Meeker (1991), Statistical Intervals.
"""

import dataclasses
import math
from collections.abc import Sequence
from typing import Literal

from bench.stats.statistics import estimate
from bench.store.resume import REPRODUCED
from bench.text.numbers import number, places, span

Outcome = Literal["match", "differs", "cannot tell"]
"""What a comparison says, from the best to the worst to know."""
FEWEST_SEEDS = 3
"""Seeds below which the scatter is not known; the interval of two would hold almost anything."""


@dataclasses.dataclass(frozen=True)
class Agreement:
    """How a value compares."""

    outcome: Outcome
    """Whether it agrees."""
    reason: str
    """Why, as a clause."""


def agreement(
    again: float, submitted: float, seeds: Sequence[float], idle: float = math.nan
) -> Agreement:
    """How a value that was measured again compares with the submitted ones.

    Args:
        again: What was measured now.
        submitted: What the row of the same seed says.
        seeds: The values of all submitted seeds, that one too.
        idle: The value of a team that does nothing; NaN where there is none.
    """
    if math.isclose(again, submitted, rel_tol=REPRODUCED):
        return Agreement("match", "reproduced to the digit")
    found = estimate(seeds)
    if found.n < FEWEST_SEEDS:
        few = f"{found.n} seed{'s' * (found.n > 1)} in the folder, at least {FEWEST_SEEDS} needed"
        return Agreement("cannot tell", f"the scatter of the seeds is not known ({few})")
    half = (found.high - found.mean) * math.sqrt(found.n + 1)
    low, high = found.mean - half, found.mean + half
    between = span(low, high, places(half))
    if low <= idle <= high:
        return Agreement(
            "cannot tell",
            f"the seeds scatter so much ({between} for one more) that a team which stays at its "
            f"spawn ({number(idle, 1)}) would pass",
        )
    if low <= again <= high:
        return Agreement("match", f"within what one more seed would give ({between})")
    return Agreement("differs", f"outside of what one more seed would give ({between})")


def worst(found: Sequence[Agreement]) -> Outcome:
    """The outcome of several comparisons: one that differs decides, else one that cannot tell."""
    outcomes = {one.outcome for one in found}
    order: tuple[Outcome, ...] = ("differs", "cannot tell", "match")
    return next(outcome for outcome in order if outcome in outcomes)
