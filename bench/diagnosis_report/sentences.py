"""What a diagnosis says, in plain sentences; the same on the page, in the text and on a terminal.

A diagnosis is read as the JSON object of schema 1; whatever `details` lacks is left out.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

from bench.diagnosis_report.effect_words import effect_words, parameter_words
from bench.diagnosis_report.numbers import (
    clean,
    estimate,
    is_number,
    number,
    percent,
    probability,
    quantity,
    with_unit,
)
from diagnosis.decide.verdict import DOUBTED

Json = Mapping[str, Any]

NOTEWORTHY = 0.05
"""Unexplained share of the gap from which the verdict mentions it."""
MOSTLY = 0.2
"""Unexplained share below which most of the gap counts as explained."""
DOUBTFUL = 0.9
"""Probability of an effect over its set's among the candidates from which nothing is doubted."""


@dataclasses.dataclass(frozen=True)
class Request:
    """What the user asked to be diagnosed."""

    flights: str
    """Name of the flights."""
    reference: str | None = None
    """Name of the reference flights, where there are some."""
    excluded: tuple[str, ...] = ()
    """Registered names of withheld effects."""

    @property
    def base(self) -> str:
        """What a change is measured against."""
        return "before" if self.reference is not None else "believed"


def verdict(diagnosis: Json, request: Request) -> str:
    """The answer, as one sentence."""
    kind = diagnosis["verdict"]
    against = "the reference flights" if request.reference is not None else "the simulator"
    if kind == "none":
        return f"Nothing separates these flights from {against} beyond noise: {_extent(diagnosis)}."
    if kind == "unexplained":
        return _unexplained(diagnosis, against)
    found = ", together with ".join(effect_phrase(e, request.base) for e in diagnosis["effects"])
    start = (
        "What changed since the reference flights:"
        if request.reference is not None
        else "These flights are explained by"
    )
    sure = f"probability {probability(set_probability(diagnosis))}"
    but = join(_alias_clause(e) for e in diagnosis["effects"] if e.get("aliases"))
    drift = drift_clause(diagnosis)
    clauses = [f"{start} {found}, {sure}{but and f', but {but}'}", drift]
    return "; ".join(clause for clause in clauses if clause) + "."


def _unexplained(diagnosis: Json, against: str) -> str:
    share, where = diagnosis.get("unexplained_share"), _where_left(diagnosis)
    if sure := _mostly(diagnosis):
        at = f", mostly in {where}," if where else ""
        return (
            f"Most of what separates these flights from {against} is explained with {sure}, which "
            f"flights that were left out confirm; {percent(share)} of the gap, far above noise{at} "
            "fits no known effect."
        )
    part = f"; {percent(share)} of the gap stays unexplained" if is_number(share) else ""
    tail = part + (f"; what is left lies mostly in {where}" if where else "")
    return f"These flights differ from {against}, and no known effect explains how{tail}."


def remarks(diagnosis: Json, request: Request) -> list[str]:
    """What must be said beside the verdict, each as a sentence."""
    said = []
    share = diagnosis.get("unexplained_share")
    if diagnosis["verdict"] == "effect" and is_number(share) and share >= NOTEWORTHY:
        where = _where_left(diagnosis)
        tail = f", mostly in {where}" if where else ""
        said.append(f"{percent(share)} of the gap stays unexplained{tail}.")
    said += [*_doubt(diagnosis), *_support(diagnosis)]
    reason = (diagnosis.get("shrink") or {}).get("reason")
    if reason and diagnosis["verdict"] == "effect":
        said.append(f"How far the gap shrinks is not known: {clean(reason).rstrip('.')}.")
    aside = (diagnosis.get("details") or {}).get("set_aside") or []
    for soon, why in ((False, "alone"), (True, "soon after a gap in the log or its start")):
        lines = [line for line in aside if line["after_gap"] is soon]
        if lines:
            at = join(f"{clean(line['flight'])} at {number(line['t'], 2)} s" for line in lines)
            said.append(f"Left out, half a second each, for standing out {why}: {at}.")
    if request.excluded:
        names = join(effect_words(clean(name)).label for name in request.excluded)
        said.append(f"Withheld from the candidates, with what always looks alike: {names}.")
    left_out = diagnosis["flights"].get("left_out") or []
    if left_out:
        first = clean(left_out[0]["reason"]).rstrip(".")
        others = f", and {len(left_out) - 1} more, see below" if len(left_out) > 1 else ""
        said.append(f"{_count(len(left_out), 'flight')} left out: {first}{others}.")
    return said


def _doubt(diagnosis: Json) -> list[str]:
    """Why effects are less probable than their set is among the candidates."""
    posterior, left = _posterior(diagnosis), (diagnosis.get("details") or {}).get("structure") or {}
    known = [effect.get("probability") for effect in diagnosis["effects"]]
    if not known or not posterior:
        return []
    if not all(map(is_number, (*posterior, *known, left.get("after")))):
        return []
    if min(known) > DOUBTFUL * posterior[0]:
        return []
    return [
        f"More than noise is left ({number(left['after'], 2)} times it); where that was so, "
        f"{percent(DOUBTED)} of the effects named in cases with known answers were true."
    ]


def _support(diagnosis: Json) -> list[str]:
    """What flights that were left out say where evidence is not to be relied on."""
    lines = (diagnosis.get("details") or {}).get("support") or []
    sure = _confirmed(diagnosis)
    idle = join(_label(x) for x in lines if not x["clear"] and is_number(x["percent"]))
    said = []
    if sure and diagnosis["verdict"] == "unexplained":
        drift = drift_clause(diagnosis)
        if _mostly(diagnosis):
            text, mark = "What is left may shift every size, so that none is stated", ";"
        else:
            text, mark = f"All the same, flights that were left out confirm {sure}", ":"
        said.append(f"{text}{mark} with the likeliest set {drift}." if drift else f"{text}.")
    if idle:
        said.append(f"Flights that were left out do not confirm {idle}.")
    return said


def _mostly(diagnosis: Json) -> str:
    """What explains most of a gap that is not explained in full; empty if nothing sure does."""
    share = diagnosis.get("unexplained_share")
    return _confirmed(diagnosis) if is_number(share) and share < MOSTLY else ""


def _confirmed(diagnosis: Json) -> str:
    """Effects that flights which were left out confirm."""
    lines = (diagnosis.get("details") or {}).get("support") or []
    return join(_label(line) for line in lines if line["clear"])


def _label(line: Json) -> str:
    return effect_words(clean(line["effect"])).label


def helped(diagnosis: Json) -> bool:
    """Whether something was found that flights which were left out confirm."""
    lines = (diagnosis.get("details") or {}).get("support") or []
    return bool(diagnosis["effects"]) or any(line["clear"] for line in lines)


def drift_clause(diagnosis: Json) -> str:
    """How the drift changes on held-out flights; empty where that is not known."""
    shrink = diagnosis.get("shrink") or {}
    before, after = shrink.get("before"), shrink.get("after")
    if not (is_number(before) and is_number(after)):
        return ""
    verb = "falls" if after <= before else "grows"
    unit = shrink.get("unit", "m")
    span = f"{quantity(before, unit, 2)} to {quantity(after, unit, 2)}"
    return f"the drift over {shrink['horizon_s']:g} s on held-out flights {verb} from {span}"


def shrink_sentence(diagnosis: Json) -> str:
    """How far the gap shrinks, with its interval; or why that is not known."""
    shrink = diagnosis.get("shrink") or {}
    if not is_number(shrink.get("percent")):
        reason = clean(shrink.get("reason") or "no effect was found").rstrip(".")
        return f"How far the gap shrinks is not known: {reason}."
    sign, word = (1.0, "less") if shrink["percent"] >= 0.0 else (-1.0, "more")
    low, high = _scaled(shrink, sign)
    value, interval = estimate(sign * shrink["percent"], low, high)
    within = f" (95 %: {interval} %)" if interval else ""
    what = "what was found" if diagnosis["effects"] else "the likeliest set of effects"
    over = f", over {_count(shrink['n'], 'flight')}" if is_number(shrink.get("n")) else ""
    windows = (diagnosis.get("details") or {}).get("windows") or {}
    aside = (
        f" Half seconds that fitted badly soon after a gap in the log, or alone, are in neither: "
        f"{windows['aside']} of {windows['n']}."
        if windows.get("aside")
        else ""
    )
    return (
        f"With {what} in the simulator, {drift_clause(diagnosis)}: "
        f"{value} % {word}{within}{over}. Measurement noise is in both numbers.{aside}"
    )


def where_sentence(diagnosis: Json) -> str:
    """In which channels the gap lies and when it sets in."""
    where = _largest_channels(diagnosis["where"])
    if diagnosis["verdict"] == "none" or not where:
        return "No channel stands out of its noise."
    onsets = [
        f"{clean(c['channel'])} at {number(c['onset_s'], 2)} s"
        for c in diagnosis["where"]
        if is_number(c.get("onset_s"))
    ]
    start = f" It sets in during the flights: {join(onsets)} after the start." if onsets else ""
    return f"The gap lies mostly in {where}.{start}"


def effect_phrase(effect: Json, base: str) -> str:
    """A found effect with sizes and intervals, as part of a sentence."""
    name = clean(effect["name"])
    words = effect_words(name)
    parameters = effect.get("parameters") or {}
    if len(parameters) == 1 and words.more:
        ((key, parameter),) = parameters.items()
        negative = is_number(parameter["value"]) and parameter["value"] < 0 and bool(words.less)
        size, interval = parameter_texts(name, key, parameter, -1.0 if negative else 1.0)
        template = words.less if negative else words.more
        return template.format(size, base=base) + _within(interval)
    sizes = []
    for key, parameter in parameters.items():
        size, interval = parameter_texts(name, key, parameter)
        sizes.append(f"{clean(parameter_words(name, key).label)} = {size}{_within(interval)}")
    return words.noun + (f" with {join(sizes)}" if sizes else "")


def parameter_texts(effect: str, name: str, parameter: Json, sign: float = 1.0) -> tuple[str, str]:
    """Value and interval of a parameter, both with the unit that people use."""
    words = parameter_words(effect, name)
    factor, unit = sign * words.factor, words.unit or parameter["unit"]
    low, high = _scaled(parameter, factor)
    value = parameter["value"]
    value, interval = estimate(factor * value if is_number(value) else None, low, high)
    return with_unit(value, unit), with_unit(interval, unit) if interval else ""


def chosen_set(diagnosis: Json) -> set[str] | None:
    """The effects that were blamed, an empty set for noise alone; None if it stays unexplained."""
    if diagnosis["verdict"] == "unexplained":
        return None
    return {effect["name"] for effect in diagnosis["effects"]}


def set_probability(diagnosis: Json) -> Any:
    """Probability of the chosen set: no more than its posterior, nor than any of its effects has.

    The posterior of a candidate is only among those that were looked at.
    """
    known = [*_posterior(diagnosis), *(x.get("probability") for x in diagnosis["effects"])]
    return min((p for p in known if is_number(p)), default=None)


def _posterior(diagnosis: Json) -> list[Any]:
    """The chosen set's among the candidates, if it is one of them."""
    chosen, listed = chosen_set(diagnosis), diagnosis.get("candidates") or ()
    return [c.get("probability") for c in listed if set(c["effects"]) == chosen][:1]


def set_label(names: Sequence[str]) -> str:
    """A set of effects by their short names."""
    labels = [effect_words(clean(name)).label for name in names]
    return " + ".join(labels) if labels else "no effect"


def join(parts: Any) -> str:
    """Parts of a sentence as "a", "a and b" or "a, b and c"."""
    *most, last = [*parts] or [""]
    return f"{', '.join(most)} and {last}" if most else last


def _scaled(entry: Json, factor: float) -> tuple[float, float] | tuple[None, None]:
    """The ends of an interval times `factor`, in order; None where there is no interval."""
    ends = [factor * end for end in (entry.get("low"), entry.get("high")) if is_number(end)]
    return (min(ends), max(ends)) if len(ends) == 2 else (None, None)


def _within(interval: str) -> str:
    return f" (95 %: {interval})" if interval else ""


def _alias_clause(effect: Json) -> str:
    label = effect_words(clean(effect["name"])).label
    others = (set_label([a] if isinstance(a, str) else a) for a in effect["aliases"])
    return f"the data cannot tell {label} from {' or '.join(others)}"


def _where_left(diagnosis: Json) -> str:
    """The channels that hold most of what the best candidate leaves."""
    details = diagnosis.get("details") or {}
    return _largest_channels(details.get("where_left") or ())


def _largest_channels(where: Sequence[Json]) -> str:
    """The channels that hold more than half of the gap between them, or else the three largest."""
    shares = [(c["share"], clean(c["channel"])) for c in where if is_number(c["share"])]
    chosen, total = [], 0.0
    for share, channel in sorted(shares, reverse=True)[:3]:
        if total > 0.5 or share <= 0.0:
            break
        chosen.append(f"{channel} ({percent(share)})")
        total += share
    return join(chosen) if chosen else ""


def _extent(diagnosis: Json) -> str:
    flights = diagnosis["flights"]
    return f"{_count(flights['n'], 'flight')}, {number(flights['seconds'])} s in all"


def _count(n: Any, noun: str) -> str:
    return f"{n} {noun}{'' if n == 1 else 's'}"
