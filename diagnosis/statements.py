"""What an answer may say, from numbers alone: the rules that turn judged fits into statements.

| verdict | rule |
|---|---|
| `none` | no effect is in the likeliest set, and it leaves no structure beyond noise |
| `effect` | the likeliest set leaves no structure that would be worth a verdict |
| `partly` | it leaves some, at most `most_left`, and left-out flights confirm one of its effects |
| `unexplained` | it leaves more, or they confirm none |
| `too_few` | nothing is seen beside a twin, and there are fewer flights than `few_flights` |

Beside a twin of the reference, "beyond noise" is beyond what undisturbed flights show with a
probability of `alarm_chance`; an effect is named if undisturbed flights show it more rarely, and
it is `partly` if so much is left.

Under `partly`, the confirmed effects are blamed; whatever else acts may bias their sizes.
"""

from collections.abc import Iterable, Sequence
from typing import Literal

from diagnosis.decision import Decision

Judged = Literal["effect", "none", "unexplained"]
"""What the likeliest set is judged to be by the structure that it leaves."""


def verdict_of(
    judged: Judged, confirmed: bool
) -> Literal["effect", "partly", "none", "unexplained"]:
    """The verdict, where left-out flights have `confirmed` an effect of the likeliest set."""
    return "partly" if judged == "unexplained" and confirmed else judged


def judged_of(verdict: str) -> str:
    """The verdict of scores, which know neither `partly` nor `too_few`.

    With too few flights nothing was found. Under `partly`, something acts that no candidate
    describes, so that an answer which says so abstains. Every score of `blind` was derived with
    that meaning.
    """
    return {"partly": "unexplained", "too_few": "none"}.get(verdict, verdict)


def use_of(verdict: str, at_bound: str, bounded: bool) -> Literal["measured", "descriptive"]:
    """What a size may be used for.

    It is measured only if its interval is known (`bounded`), it does not lie at an end of the
    allowed range, and nothing unexplained is left that could bias it.
    """
    measured = verdict == "effect" and bounded and at_bound == "no"
    return "measured" if measured else "descriptive"


def answer_probability(posterior: float | None, effects: Iterable[float | None]) -> float | None:
    """Probability of a named set: neither above its posterior nor above that of any effect.

    The posterior is only among the sets that were looked at.
    """
    known = [p for p in (posterior, *effects) if p is not None]
    return min(known, default=None)


def noteworthy(share: float | None, decision: Decision = Decision()) -> bool:
    """Whether the unexplained share of the gap is said beside an effect."""
    return share is not None and share >= decision.noteworthy_share


def mostly_explained(share: float | None, decision: Decision = Decision()) -> bool:
    """Whether most of the gap is explained where that share is left."""
    return share is not None and share < decision.mostly_share


def main_channels(shares: Sequence[float], decision: Decision = Decision()) -> list[bool]:
    """Which channels hold most of the gap between them: the largest, until they hold enough."""
    order = sorted(range(len(shares)), key=lambda i: -shares[i])[: int(decision.main_channels)]
    chosen, total = set(), 0.0
    for i in order:
        if total > decision.main_share or shares[i] <= 0.0:
            break
        chosen.add(i)
        total += shares[i]
    return [i in chosen for i in range(len(shares))]


def beyond_noise(gap: float, low: float | None, floor: float) -> bool:
    """Whether a channel's gap, or the lower end of its interval, exceeds its noise floor."""
    return (gap if low is None else low) > floor
