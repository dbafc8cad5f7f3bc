"""What a diagnosis says, in plain sentences; the same on the page, in the text and on a terminal.

Words are chosen here; what they state was decided before and stands in the `Diagnosis`.
"""

from collections.abc import Sequence

from bench.diagnosis_report.effect_words import (
    effect_phrase,
    outside,
    parameter_texts,
    parameter_words,
)
from bench.diagnosis_report.gap_text import drift_clause, measured_attitude, not_given, outstanding
from bench.text.numbers import (
    is_number,
    percent,
    probability,
    quantity,
    rounded,
)
from bench.text.words import clean, count, join
from diagnosis.interface.fault import Untold
from diagnosis.result import Diagnosis, Effect
from simulators.effects.card import load_card

LIKENESS = (
    "Something acts that no candidate describes, and the likeness may be all there is: in the "
    "blind cases of this kind that were counted, every effect that was blamed was a wrong one."
)
"""What is said of an effect that explains a part of the gap, without a twin; `reports/blind.md`."""
ROUGH = (
    "The point mass lacks much of what a vehicle does, so that something is left beside any cause. "
    "How often what is blamed so is right was not counted."
)
"""The same against the point mass, which no flight follows to the noise."""
KINDS = {
    "effect": "Explained",
    "partly": "Partly explained",
    "none": "Nothing beyond noise",
    "too_few": "Too few flights to tell",
    "unexplained": "Unexplained",
}
"""What the verdicts are called."""


def verdict(diagnosis: Diagnosis) -> str:
    """The answer, as one sentence."""
    beside = diagnosis.reference is not None
    against = "the reference flights" if beside else "the simulator"
    if not diagnosis.compared:
        return (
            f"The logs do not say what the format asks for ({_parts(diagnosis)}): mend that first. "
            f"They were not compared with {against}: wrong columns say nothing of the vehicle."
        )
    if diagnosis.verdict == "none":
        return _none(diagnosis, against)
    if diagnosis.verdict == "too_few":
        return _too_few(diagnosis)
    if diagnosis.verdict == "partly":
        return _partly(diagnosis, against)
    if diagnosis.verdict == "unexplained":
        return _unexplained(diagnosis, against)
    found = ", together with ".join(effect_phrase(e, base(diagnosis)) for e in diagnosis.blamed)
    start = "These flights are explained by"
    if beside:
        apart = ", apart from the mass that was weighed" if weighed_anew(diagnosis) else ""
        start = f"What changed since the reference flights{apart}:"
    drift = drift_clause(diagnosis, "it" if len(diagnosis.blamed) == 1 else "them")
    sentences = [f"{start} {found}{_sure(diagnosis)}.", *_alike(diagnosis)]
    return " ".join([*sentences, *([f"{drift}."] if drift else [])])


def weighed_anew(diagnosis: Diagnosis) -> bool:
    """Whether the vehicle is believed to weigh something else than in the reference flights."""
    reference = diagnosis.reference
    return reference is not None and reference.mass != diagnosis.flights.mass


def base(diagnosis: Diagnosis) -> str:
    """What sizes are relative to."""
    new = diagnosis.reference is None or weighed_anew(diagnosis)
    return "believed" if new else "before"


def _sure(diagnosis: Diagnosis) -> str:
    """The probability of the verdict, and whose it is where it holds for several together."""
    value = probability(diagnosis.probability)
    if not any(is_shared(diagnosis, effect) for effect in diagnosis.blamed):
        return f", probability {value}"
    labels = map(class_label, diagnosis.blamed)
    return f"; {join(labels)}, probability {value} together"


def is_shared(diagnosis: Diagnosis, effect: Effect) -> bool:
    """Whether the stated probability belongs to an effect and its aliases together.

    So it is beside a twin, which sums the candidates that look alike.
    """
    return bool(diagnosis.details.followed and effect.aliases)


def class_label(effect: Effect) -> str:
    """An effect and its aliases by their short names."""
    return " or ".join(set_label([name]) for name in (effect.name, *effect.aliases))


def _none(diagnosis: Diagnosis, against: str) -> str:
    beyond = "what they differ by among themselves" if diagnosis.details.followed else "noise"
    if diagnosis.interface:
        return (
            f"Nothing in the vehicle separates these flights from {against} beyond {beyond} "
            f"({_extent(diagnosis)}), but check the logs: {_parts(diagnosis)}."
        )
    return f"Nothing separates these flights from {against} beyond {beyond}: {_extent(diagnosis)}."


def _too_few(diagnosis: Diagnosis) -> str:
    said = f"Too few flights to tell whether anything changed: {_extent(diagnosis)}"
    if diagnosis.reference is not None:
        said += f", beside {count(len(diagnosis.reference.used), 'reference flight')}"
    if not diagnosis.effects:
        return f"{said}."
    likeliest = effect_phrase(diagnosis.effects[0], base(diagnosis))
    return (
        f"{said}. If something did, it looks most like {likeliest}, but two "
        "flights of an unchanged vehicle may differ as much."
    )


def _partly(diagnosis: Diagnosis, against: str) -> str:
    much = "Most" if diagnosis.remainder.mostly_explained else "Part"
    found = ", together with ".join(effect_phrase(e, base(diagnosis)) for e in diagnosis.blamed)
    sure = {line.effect for line in diagnosis.support if line.confirmed}
    confirmed = {effect.name for effect in diagnosis.blamed} <= sure
    learned = bool(diagnosis.details.followed)
    helps = ", which flights left out of the fit confirm"
    if not learned:
        helps = "; with this, flights left out of the fit are followed better"
    tail = helps if confirmed else ""
    is_like = "is explained by" if learned else "looks like"
    sentences = [
        f"{much} of what separates these flights from {against} {is_like} {found}{tail}.",
        *_alike(diagnosis),
        _not_known(diagnosis),
    ]
    return " ".join(sentences)


def _not_known(diagnosis: Diagnosis) -> str:
    """How much of the gap the likeliest set leaves, and in which channels."""
    share, where = percent(diagnosis.remainder.share), diagnosis.remainder.where
    mostly, names = outstanding(where)
    if mostly:
        return f"{share} of the gap, mostly in {names}, fits no known effect."
    if names:
        left = f"of this remainder, what is beyond noise lies in {names}"
        return f"{share} of the gap fits no known effect; {left}."
    alone = ", and no single channel is beyond noise" if where else ""
    return f"{share} of the gap fits no known effect{alone}."


def _unexplained(diagnosis: Diagnosis, against: str) -> str:
    share = diagnosis.remainder.share
    if logs_first(diagnosis) and diagnosis.effects:
        return (
            f"These flights differ from {against}, but their logs do not say what the format asks "
            f"for ({_parts(diagnosis)}); mend that first: until then no cause in the vehicle can "
            "be named."
        )
    tail = _remainder_tail(diagnosis)
    if diagnosis.remainder.mostly_explained and diagnosis.effects:
        together = set_label([effect.name for effect in diagnosis.effects])
        return (
            f"These flights differ from {against}; {together} would make up for all but "
            f"{percent(share)} of the gap, but no effect among them passes every test of a cause"
            f"{tail}."
        )
    if diagnosis.effects and is_number(share) and share < 1.0:
        tail = f"; the likeliest set leaves {percent(share)} of the gap{tail}"
    return f"These flights differ from {against}, and no known effect explains how{tail}."


def _remainder_tail(diagnosis: Diagnosis) -> str:
    """In which channels the remainder lies, as the end of a sentence."""
    mostly, names = outstanding(diagnosis.remainder.where)
    if names:
        return f"; the remainder {'lies mostly' if mostly else 'is beyond noise'} in {names}"
    alone = "; no single channel of the remainder is beyond noise"
    return alone if diagnosis.remainder.where else ""


def _parts(diagnosis: Diagnosis) -> str:
    return join(fault.part for fault in diagnosis.interface)


def logs_first(diagnosis: Diagnosis) -> bool:
    """Whether the logs must be mended before anything can be said of the vehicle."""
    return diagnosis.verdict == "unexplained" and bool(diagnosis.interface)


def kind_label(diagnosis: Diagnosis) -> str:
    """What the verdict is called, in a few words."""
    if logs_first(diagnosis):
        return "Mend the logs first"
    if diagnosis.verdict == "none" and diagnosis.interface:
        return "Check the logs"
    if diagnosis.verdict == "unexplained" and diagnosis.remainder.mostly_explained:
        return "No cause confirmed"
    if diagnosis.verdict == "effect" and any(effect.aliases for effect in diagnosis.blamed):
        return "Explained, with an alternative"
    return KINDS[diagnosis.verdict]


def next_flight(diagnosis: Diagnosis) -> str:
    """What to fly next; nothing where the logs must be mended first."""
    return "" if logs_first(diagnosis) else clean(diagnosis.next_flight or "")


def remarks(diagnosis: Diagnosis) -> list[str]:
    """What must be said beside the verdict, each as a sentence."""
    said = [fault.advice for fault in diagnosis.interface]
    said += [
        *_beside_effect(diagnosis),
        *_at_bounds(diagnosis),
        *_support(diagnosis),
        *measured_attitude(diagnosis),
        *not_given(diagnosis),
        *_twin(diagnosis),
        *_silent(diagnosis),
    ]
    for soon, why in ((False, "alone"), (True, "soon after a gap in the log or its start")):
        lines = [line for line in diagnosis.details.set_aside if line.after_gap is soon]
        if lines:
            at = join(f"{clean(line.flight)} at {rounded(line.t, 2)} s" for line in lines)
            said.append(f"Left out, half a second each, for standing out {why}: {at}.")
    said += not_checked(diagnosis.untold)
    if diagnosis.settings.exclude:
        names = join(load_card(clean(name)).label for name in diagnosis.settings.exclude)
        said.append(f"Withheld from the candidates, with what always looks alike: {names}.")
    left_out = left_out_lines(diagnosis)
    if left_out:
        first = left_out[0][1].rstrip(".")
        others = f", and {len(left_out) - 1} more, see below" if len(left_out) > 1 else ""
        said.append(f"Left out: {first}{others}.")
    return said


def _twin(diagnosis: Diagnosis) -> list[str]:
    """That the reference is a learned twin, and how much better it follows."""
    lines = diagnosis.details.followed
    if not lines:
        return []
    best = max(lines, key=lambda line: line.simulator / max(line.twin, 1e-12))
    single = diagnosis.reference is not None and len(diagnosis.reference.used) == 1
    left_out = "parts of its flight" if single else "reference flights"
    why = "The simulator as delivered already misses the reference flights"
    if weighed_anew(diagnosis):
        why = "The vehicle weighed something else in the reference flights"
    return [
        f"{why}, so these flights are "
        f"compared with a twin that was learned from the reference: on {left_out} left out of its "
        f"fit it is off by {quantity(best.twin, best.unit, 2)} in {clean(best.channel)}, the "
        f"simulator by {quantity(best.simulator, best.unit, 2)}."
    ]


def _silent(diagnosis: Diagnosis) -> list[str]:
    """That silence is no proof, and where it says how large a change may hide in it."""
    if not diagnosis.shows_nothing or not diagnosis.details.limits:
        return []
    return [
        'A small change could still hide: "What these flights cannot tell" lists the smallest '
        "one of each kind that they could have shown."
    ]


def _beside_effect(diagnosis: Diagnosis) -> list[str]:
    """What limits an answer that names effects as the whole cause."""
    if diagnosis.verdict != "effect":
        return []
    said, doubt, shrink = [], diagnosis.doubt, diagnosis.shrink
    if diagnosis.remainder.noteworthy:
        mostly, where = outstanding(diagnosis.remainder.where, shares=False)
        tail = f", {'most of it' if mostly else 'beyond noise'} in {where}" if where else ""
        said.append(f"{percent(diagnosis.remainder.share)} of the gap stays unexplained{tail}.")
    if doubt is not None:
        said.append(
            f"More than noise is left ({rounded(doubt.structure, 2)} times it); where that was so, "
            f"{percent(doubt.true_share)} of the effects named in cases with known answers were "
            "true."
        )
    if shrink.reason:
        said.append(f"How far the gap shrinks is not known: {clean(shrink.reason).rstrip('.')}.")
    return said


def _at_bounds(diagnosis: Diagnosis) -> list[str]:
    """Parameters at an end of their allowed range, with the side to which they point, or beyond."""
    sides = {"low": "at most", "high": "at least"}
    at, beyond = [], []
    for effect in diagnosis.blamed:
        name = clean(effect.name)
        for p in effect.parameters:
            if p.at_bound not in sides:
                continue
            size = parameter_texts(name, p)[0]
            words = f"{clean(parameter_words(name, p.name).label)} of {load_card(name).label}"
            if outside(name, p):
                beyond.append(f"{words} ({size})")
            else:
                at.append(f"{words} ({sides[p.at_bound]} {size})")
    where = (("At the end of", at), ("Beyond", beyond))
    so = "its allowed range, and so descriptive only"
    return [f"{place} {so}: {join(ends)}." for place, ends in where if ends]


def _support(diagnosis: Diagnosis) -> list[str]:
    """What flights that were left out say where evidence is not to be relied on."""
    idle = join(
        load_card(clean(line.effect)).label for line in diagnosis.support if line.confirmed is False
    )
    said = []
    if diagnosis.verdict == "partly":
        text = "The remaining misfit could bias the sizes, so they are descriptive only."
        if not diagnosis.details.followed:
            rough = diagnosis.settings.simulator == "point_mass"
            text = f"{ROUGH if rough else LIKENESS} {text}"
        drift = drift_clause(diagnosis, "the likeliest set")
        said.append(f"{text} {drift}." if drift else text)
    if idle and not logs_first(diagnosis):
        said.append(f"Flights left out of the fit do not confirm {idle}.")
    return said


def not_checked(parts: Sequence[Untold]) -> list[str]:
    """One sentence on what of the logs was not checked; none where everything was."""
    if not parts:
        return []
    what = join(dict.fromkeys(one.what for one in parts))
    moves = {move for one in parts for move in one.fly}
    steps = " and ".join(axis for axis in ("x", "y") if axis in moves)
    fly = [f"steps in {steps}"] if steps else []
    fly += ["climbs and descents"] if "z" in moves else []
    fly += ["turns in yaw"] if "yaw" in moves else []
    return [f"Not checked for want of motion: {what}; fly {join(fly)}."]


def left_out_lines(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """Each flight that was left out, with the reason; a reference flight is marked as such."""
    lines = [(clean(x.name), clean(x.reason)) for x in diagnosis.flights.left_out]
    beside = diagnosis.reference.left_out if diagnosis.reference is not None else ()
    return lines + [(clean(x.name), f"reference, {clean(x.reason)}") for x in beside]


def set_label(names: Sequence[str]) -> str:
    """A set of effects by their short names."""
    labels = [load_card(clean(name)).label for name in names]
    return " + ".join(labels) if labels else "no effect"


def _alike(diagnosis: Diagnosis) -> list[str]:
    """What would look like the named effects, a sentence each."""
    return [
        f"In these flights, {' or '.join(set_label([a]) for a in effect.aliases)} would look "
        f"nearly the same as {load_card(clean(effect.name)).label}."
        for effect in diagnosis.blamed
        if effect.aliases
    ]


def _extent(diagnosis: Diagnosis) -> str:
    flights = diagnosis.flights
    return f"{count(len(flights.used), 'flight')}, {rounded(flights.seconds)} s in all"
