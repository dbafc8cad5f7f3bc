"""The flight to fly next: what would separate effects that these flights cannot tell apart.

The cards of the effects name the manoeuvres (`EffectCard.flight`, `EffectCard.separated_from`).
"""

from collections.abc import Mapping, Sequence

from diagnosis.decision import Decision
from diagnosis.replay.library import Slot
from simulators.effects.card import load_card, manoeuvre


def next_flight(
    kind: str, aliases: Mapping[str, Sequence[str]], where: str | None, blind_to: Sequence[str]
) -> str:
    """One sentence: what to fly next, and what for.

    `where` names the regime of the largest remaining gap, `blind_to` effects that these flights
    would hardly have shown.
    """
    if pair := pair_to_separate(aliases):
        text = manoeuvre(*pair) or _both(*pair)
        one, other = (load_card(name).label for name in pair)
        return f"To separate {one} from {other}: {text}."
    if kind == "unexplained":
        place = f" where the gap is largest ({where})" if where else ""
        return f"Fly again{place} and change one thing at a time; no candidate has this shape."
    for name in blind_to:
        if flight := load_card(name).flight:
            return f"To be able to see {load_card(name).label} as well: {flight}."
    return "Nothing: these flights separate all candidates that they can show."


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
