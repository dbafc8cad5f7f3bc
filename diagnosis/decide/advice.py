"""The flight to fly next: what would separate effects that these flights cannot tell apart.

The cards of the effects name the manoeuvres (`EffectCard.flight`, `EffectCard.separated_from`).
"""

import math
from collections.abc import Mapping, Sequence

from diagnosis.decision import Decision
from diagnosis.replay.library import Slot
from diagnosis.result_parts import ChannelGap, RegimeGap
from diagnosis.statements import judged_of
from simulators.effects.card import load_card, manoeuvre

LENGTH = "of 5 to 10 s"
"""How long flights should be."""
INTERVAL = 2.0 * 1.96
"""Width of a 95 % interval in standard deviations."""


def next_flight(
    verdict: str,
    aliases: Mapping[str, Sequence[str]],
    where: str | None,
    blind_to: Sequence[str],
    n_flights: int,
    n_reference: int | None = None,
    decision: Decision = Decision(),
) -> str:
    """One sentence: what to fly next, and what for.

    Args:
        verdict: The verdict.
        aliases: Of each named effect, what these flights cannot tell from it.
        where: The regime of the largest remaining gap, if one stands out.
        blind_to: Effects that these flights would hardly have shown.
        n_flights: Flights that counted.
        n_reference: Reference flights that counted.
        decision: Thresholds.
    """
    if verdict == "too_few":
        return _more_flights(n_flights, n_reference, decision)
    if pair := pair_to_separate(aliases):
        text = manoeuvre(*pair) or _both(*pair)
        one, other = (load_card(name).label for name in pair)
        return f"To separate {one} from {other}: {text}."
    if judged_of(verdict) == "unexplained":
        if n_flights < decision.fewest_flights:
            return (
                f"Fly at least {decision.few_flights} flights {LENGTH} and change one thing at a "
                "time; so few flights confirm nothing."
            )
        place = f" where the gap is largest ({where})" if where else ""
        return f"Fly again{place} and change one thing at a time; no candidate has this shape."
    for name in blind_to:
        if flight := load_card(name).flight:
            return f"To be able to see {load_card(name).label} as well: {flight}."
    return "Nothing: these flights separate all candidates that they can show."


def _more_flights(n_flights: int, n_reference: int | None, decision: Decision) -> str:
    """How many flights of which set make silence an answer."""
    least = decision.few_flights
    first = f"Fly at least {least} flights {LENGTH} like the reference"
    if n_reference is None or n_reference >= least:
        return f"{first}, and diagnose again."
    if n_flights >= least:
        return f"Fly at least {least} reference flights {LENGTH}, and diagnose again."
    return f"{first}, and at least {least} reference flights, and diagnose again."


def largest_regime(
    where: Sequence[ChannelGap],
    noise: Mapping[str, float | None],
    decision: Decision = Decision(),
) -> str | None:
    """The bin in which the gap of the channel with the largest share stands out.

    A bin is named if its gap is `regime_contrast` times the RMS gap of the other bins, and if the
    bin is wider than the 95 % interval of one measurement of its condition. Of several such bins
    the one with the largest contrast is named.

    `noise` holds the standard deviations of measured conditions, None for one that is not known.
    """
    if not where:
        return None
    best, text = decision.regime_contrast, None
    for regime in max(where, key=lambda c: c.share).regimes:
        contrast, low, high = _largest_bin(regime)
        sigma = noise.get(regime.variable, 0.0)
        if sigma is not None and high - low > INTERVAL * sigma and contrast > best:
            best = contrast
            # Two significant digits, or as many as it takes to tell the ends apart.
            digits = max(0, 1 - _power(max(abs(low), abs(high))), -_power(high - low))
            text = f"{regime.variable} {low:.{digits}f} to {high:.{digits}f} {regime.unit}"
    return text


def _largest_bin(regime: RegimeGap) -> tuple[float, float, float]:
    """The largest gap of a bin over the RMS of the others, and the bin's ends.

    Where no other bin has a gap that is known, there is nothing to compare, and it is 0.
    """
    known = [(gap, i) for i, gap in enumerate(regime.gap) if gap is not None]
    largest, i = max(known, default=(0.0, 0))
    others = [gap**2 for gap, k in known if k != i]
    contrast = largest / max(math.sqrt(sum(others) / len(others)), 1e-12) if others else 0.0
    return contrast, regime.edges[i], regime.edges[i + 1]


def _power(value: float) -> int:
    """The power of ten of the first digit of a positive value."""
    return math.floor(math.log10(value))


def pair_to_separate(aliases: Mapping[str, Sequence[str]]) -> tuple[str, str] | None:
    """Which two effects the next flight tells apart, by aliases of each; None without aliases.

    A pair whose manoeuvre was tried comes first.
    """
    pairs = [(name, other) for name, others in aliases.items() for other in others]
    return min(pairs, key=lambda pair: manoeuvre(*pair) is None, default=None)


def blind_to(
    slots: Sequence[Slot], seen: Sequence[tuple[int, float]], decision: Decision
) -> list[str]:
    """Effects whose smallest visible size is `blind_share` of the allowed range or more.

    `seen` holds that size for some of the parameters in `slots`.
    """
    share = decision.blind_share
    return [slots[i].effect for i, size in seen if size > share * (slots[i].high - slots[i].low)]


def _both(*pair: str) -> str:
    """The flights that show each of two effects best; nobody has tried them on this pair."""
    cards = [load_card(name) for name in pair]
    one, other = (card.flight or f"flights in which {card.label} matters" for card in cards)
    if one == other:
        return f"fly {one}, where both are largest"
    return f"fly {one}, then {other}, each in flights of their own"
