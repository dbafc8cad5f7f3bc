"""The tables of a diagnosis as texts, for the page and for Markdown alike."""

import dataclasses
from collections.abc import Sequence

from bench.diagnosis_report.effect_words import (
    limit_text,
    parameter_texts,
    parameter_words,
    shared_text,
    toward,
    use_text,
)
from bench.diagnosis_report.gap_text import added
from bench.diagnosis_report.sentences import (
    class_label,
    is_shared,
    left_out_lines,
    set_label,
)
from bench.text.numbers import (
    MISSING,
    estimate,
    is_number,
    percent,
    probability,
    quantity,
    rounded,
    scale_of,
    with_unit,
)
from bench.text.words import clean, join
from diagnosis.result import Diagnosis, Effect
from diagnosis.result_parts import ChannelGap
from simulators.effects.card import load_card


@dataclasses.dataclass(frozen=True)
class Table:
    """Texts in rows; none of them is escaped."""

    caption: str
    headings: tuple[str, ...]
    rows: tuple[tuple[str, ...], ...]
    left: frozenset[int] = frozenset({0})
    """Columns of words, which align left."""
    bars: tuple["Bar | None", ...] = ()
    """One a row, or none at all."""
    bar_heading: str = ""
    notes: tuple[str, ...] = ()
    """What must be known to read it, a sentence or two each."""


@dataclasses.dataclass(frozen=True)
class Bar:
    """A bar with an interval and a mark, all as shares of the longest in the table."""

    length: float
    low: float | None = None
    high: float | None = None
    mark: float | None = None
    chosen: bool = True
    """Whether it stands out from the others."""


def where_table(diagnosis: Diagnosis) -> Table:
    """The gap per channel, largest share first."""
    channels = sorted(diagnosis.where, key=lambda c: -c.share)
    headings = ("channel", "share", "gap", "95 %", "noise floor", "sets in")
    rows = [
        (
            clean(c.channel),
            percent(c.share),
            *_channel_texts(c),
            with_unit(rounded(c.onset_s, 2), "s"),
        )
        for c in channels
    ]
    nothing = diagnosis.shows_nothing  # noise has no shares
    left_out = {"share"} if nothing else set()
    if all(row[-1] == MISSING for row in rows):
        left_out.add("sets in")
    shown = [i for i, heading in enumerate(headings) if heading not in left_out]
    return Table(
        f"Gap per channel: {'' if nothing else 'share of the whole, and '}root mean square",
        tuple(headings[i] for i in shown),
        tuple(tuple(row[i] for i in shown) for row in rows),
        bars=_where_bars(channels),
        bar_heading="gap in noise floors",
    )


def _channel_texts(channel: ChannelGap) -> tuple[str, str, str]:
    factor, unit = scale_of(channel.unit)
    gap, low, high = (
        factor * x if is_number(x) else None for x in (channel.gap_rms, channel.low, channel.high)
    )
    value, interval = estimate(gap, low, high)
    return (
        with_unit(value, unit),
        interval or MISSING,
        quantity(channel.noise_floor, clean(channel.unit)),
    )


def _in_noise_floors(channel: ChannelGap) -> list[float | None]:
    """Gap and both ends of its interval over the noise floor; None where one is not known."""
    floor = channel.noise_floor
    values = (channel.gap_rms, channel.low, channel.high)
    return [x / floor if is_number(x) and floor > 0.0 else None for x in values]


def _where_bars(channels: Sequence[ChannelGap]) -> tuple[Bar | None, ...]:
    scaled = [_in_noise_floors(channel) for channel in channels]
    longest = max((x for row in scaled for x in row if x is not None), default=0.0)
    longest = max(longest, 1.0)
    return tuple(
        None
        if gap is None
        else Bar(
            gap / longest,
            None if low is None else low / longest,
            None if high is None else high / longest,
            1.0 / longest,
            channel.beyond_noise,
        )
        for channel, (gap, low, high) in zip(channels, scaled, strict=True)
    )


def candidates_table(diagnosis: Diagnosis) -> Table | None:
    """What was considered, most probable first; columns that nothing is known of are left out."""
    rows = [
        (
            set_label(c.effects),
            probability(c.posterior),
            rounded(c.evidence, 2),
            f"{rounded(c.shrink_percent, 2)} %" if c.shrink_percent is not None else MISSING,
        )
        for c in diagnosis.candidates
    ]
    if not rows:
        return None
    headings = ("effects", "probability", "evidence [nats]", "drift in the fit falls by")
    kept = [i for i in range(len(headings)) if any(row[i] != MISSING for row in rows)]
    return Table(
        "Sets of effects that were looked at, by their probability among each other",
        tuple(headings[i] for i in kept),
        tuple(tuple(row[i] for i in kept) for row in rows),
        bars=tuple(Bar(min(1.0, c.posterior), chosen=c.named) for c in diagnosis.candidates),
        notes=tuple(_candidate_notes(diagnosis)),
    )


def _candidate_notes(diagnosis: Diagnosis) -> list[str]:
    notes = []
    if any(candidate.evidence is not None for candidate in diagnosis.candidates):
        notes.append(
            "Evidence is the gain in log-likelihood over the simulator as it is, when each fitted "
            "flight in turn is left out of the fit (to first order). The probability weighs the "
            "gain with all flights fitted, less a price for each effect, so that of two sets the "
            "one with more effects can have more evidence and still be less probable. The column "
            "on drift is about the flights that were fitted."
        )
    sets = [set(candidate.effects) for candidate in diagnosis.candidates]
    unnamed = set.intersection(*sets) - {effect.name for effect in diagnosis.blamed}
    if diagnosis.blamed and len(sets) > 1 and unnamed:
        labels = join(load_card(clean(name)).label for name in sorted(unnamed))
        notes.append(f"Each was tried beside {labels}, which the verdict does not blame.")
    if diagnosis.blamed and diagnosis.details.followed:
        notes.append(
            "The probability above is the sum over an effect and what looks like it, lowered by "
            "the chance that undisturbed flights show some effect."
        )
    elif diagnosis.blamed:
        notes.append("The probability of an effect is the sum over all sets that hold it.")
    if diagnosis.support:
        notes.append("Probabilities are too sure, because errors within one flight are alike.")
    return notes


def support_table(diagnosis: Diagnosis) -> Table | None:
    """What each effect of the likeliest set does for flights that were left out of the fit."""
    rows = []
    for line in diagnosis.support:
        value, interval = estimate(line.percent, line.low, line.high)
        cell = (f"{value} %", f"{interval} %") if interval else (MISSING, MISSING)
        rows.append((load_card(clean(line.effect)).label, *cell, str(line.n)))
    caption = "The likeliest set, effect by effect, on flights left out of the fit in turn"
    headings = ("effect", "misfit falls by", "95 %", "flights")
    note = (
        "Whole flights are independent: an effect counts if flights left out of the fit are "
        "followed worse without it, the others fitted again, and by more than flights differ."
    )
    return Table(caption, headings, tuple(rows), notes=(note,)) if rows else None


def effect_heading(diagnosis: Diagnosis, effect: Effect) -> str:
    """Label of an effect of the likeliest set, with its probability where it is blamed."""
    label = load_card(clean(effect.name)).label
    if not effect.blamed:
        return f"{label}, in the likeliest set but not blamed"
    if effect.probability is None:
        return label
    value = probability(effect.probability)
    if is_shared(diagnosis, effect):
        return f"{class_label(effect)}, probability {value} together"
    return f"{label}, probability {value}"


def parameters_table(effect: Effect) -> Table | None:
    """The parameters of an effect, in the units that people use and in SI."""
    name = clean(effect.name)
    rows = []
    for parameter in effect.parameters:
        words = parameter_words(name, parameter.name)
        label, sign = toward(words, parameter.value)
        value, interval = parameter_texts(name, parameter, sign)
        raw = with_unit(rounded(parameter.value, 4), parameter.unit)
        inside = f"{clean(parameter.name)} = {raw}"
        rows.append((label, value, interval or MISSING, inside, use_text(name, parameter)))
    if not rows:
        return None
    caption = f"Parameters of {load_card(name).label}"
    headings = ("parameter", "value", "95 %", "in the simulator", "use")
    shown = len(headings) - all(row[-1] == "measured" for row in rows)
    return Table(caption, headings[:shown], tuple(row[:shown] for row in rows), frozenset({0, 4}))


def shrink_table(diagnosis: Diagnosis) -> Table | None:
    """Drift before and after per channel."""
    rows = tuple(
        (
            clean(line.channel),
            quantity(line.before, clean(line.unit)),
            quantity(line.after, clean(line.unit)),
            f"{rounded(line.percent, 2)} %" if line.percent is not None else MISSING,
        )
        for line in diagnosis.shrink.by_channel
    )
    headings = ("channel", "without", "with", "falls by")
    return Table("Gap on held-out flights, by channel", headings, rows) if rows else None


def not_observable_table(diagnosis: Diagnosis) -> Table | None:
    """Effects on which these flights say nothing, with the reason."""
    rows = tuple(
        (load_card(clean(line.effect)).label, clean(line.why))
        for line in diagnosis.details.not_observable
    )
    caption = "Effects on which these flights say nothing"
    return Table(caption, ("effect", "why"), rows, frozenset({0, 1})) if rows else None


def limits_table(diagnosis: Diagnosis) -> Table | None:
    """The smallest size of each effect that these flights could have shown."""
    rows = []
    for line in diagnosis.details.limits:
        name = clean(line.effect)
        words = parameter_words(name, clean(line.parameter))
        shown, share = limit_text(line)
        either = " or ".join(filter(None, (words.label, words.opposite)))
        rows.append((load_card(name).label, clean(either), shown, percent(share)))
    if diagnosis.details.followed:
        note = (
            "A change of this size, alone, would be seen with a probability of 95 %, as far as "
            "flights differ from each other; which of the effects that look alike it is may stay "
            "open."
        )
    else:
        note = (
            "Five standard deviations by the Cramér-Rao bound, if this effect acted beside what "
            "was found and nothing else."
        )
    note += (
        " A smaller change may go unnoticed; longer or livelier flights show smaller ones. Where "
        "it is a large share of the range that a diagnosis allows, these flights hardly tell."
    )
    caption = "Smallest change that these flights could have shown"
    headings, left = ("effect", "parameter", "change", "share of its range"), frozenset({0, 1})
    return Table(caption, headings, tuple(rows), left, notes=(note,)) if rows else None


def shared_table(diagnosis: Diagnosis) -> Table | None:
    """With a reference: what separates the simulator from both sets of flights."""
    rows = []
    for line in diagnosis.details.shared:
        name = clean(line.effect)
        label, sign = toward(parameter_words(name, clean(line.parameter)), line.value)
        rows.append((load_card(name).label, label, shared_text(line, sign)))
    caption = "In the reference flights already, against the simulator as delivered"
    headings = ("effect", "parameter", "value")
    return Table(caption, headings, tuple(rows), frozenset({0, 1})) if rows else None


def followed_table(diagnosis: Diagnosis) -> Table | None:
    """With a twin of the reference: how well it follows flights that it has not seen."""
    rows = tuple(
        (
            clean(line.channel),
            quantity(line.simulator, line.unit),
            quantity(line.twin, line.unit),
        )
        for line in diagnosis.details.followed
    )
    caption = "Reference flights, left out in turn: error of the simulator and of the learned twin"
    return Table(caption, ("channel", "simulator", "twin"), rows) if rows else None


def interface_table(diagnosis: Diagnosis) -> Table | None:
    """What shows that a part of the logs does not say what the format asks for."""
    rows = tuple(
        (
            fault.part,
            clean(" or ".join(fault.readings)),
            line.quantity,
            f"{rounded(line.value, 3)} {line.unit}".removesuffix(" -"),
            MISSING if line.low is None else f"{rounded(line.low, 3)} to {rounded(line.high, 3)}",
            line.allowed,
        )
        for fault in diagnosis.interface
        for line in fault.evidence
    )
    caption = "Checked before any physics; intervals are 99.9 %"
    headings = ("part", "looks like", "evidence", "measured", "interval", "allowed")
    return Table(caption, headings, rows, frozenset({0, 1, 2, 5})) if rows else None


def noise_table(diagnosis: Diagnosis) -> Table | None:
    """Noise of each channel as estimated from the logs."""
    rows = tuple(
        (clean(line.channel), quantity(line.sigma, line.unit)) for line in diagnosis.details.noise
    )
    caption = "Noise estimated from the logs, one standard deviation"
    return Table(caption, ("channel", "noise"), rows) if rows else None


def left_out_table(diagnosis: Diagnosis) -> Table | None:
    """Flights, or parts of them, that were not used, with the reason."""
    rows = tuple(left_out_lines(diagnosis))
    caption = "Flights, or parts of them, that were not used"
    return Table(caption, ("flight", "why"), rows, frozenset({0, 1})) if rows else None


def flights_table(diagnosis: Diagnosis) -> Table:
    """Every flight that was used, its length, and for what."""
    rows = tuple(
        (
            clean(flight.name),
            f"{flight.seconds:.1f} s" if flight.seconds is not None else MISSING,
            flight.use,
        )
        for flight in diagnosis.flights.used
    )
    caption = "Flights used" if diagnosis.compared else "Flights"
    return Table(caption, ("flight", "length", "use"), rows, frozenset({0, 2}))


def facts(diagnosis: Diagnosis) -> list[tuple[str, str]]:
    """What stands at the head of the page: name and value."""
    flights, misfit = diagnosis.flights, diagnosis.details.misfit
    used = {flight.name for flight in flights.used}
    in_turn = bool(used) and used == set(flights.held_out)
    held_out = [("held out", "each in turn" if in_turn else str(len(flights.held_out)))]
    if not diagnosis.compared:
        held_out = []
    found = [
        ("simulator", clean(diagnosis.settings.simulator)),
        ("drone", clean(flights.drone)),
        ("flights", str(len(flights.used))),
        *held_out,
        ("flown", f"{rounded(flights.seconds)} s"),
    ]
    if diagnosis.reference is not None:
        found.append(("reference flights", str(len(diagnosis.reference.used))))
    texts = [rounded(x) for x in (misfit.before, misfit.after) if x is not None]
    if texts:
        same = len(set(texts)) == 1
        ends = texts[0] if same else f"{texts[0]} without, {texts[-1]} with {added(diagnosis)}"
        found.append(("misfit (1 is noise alone)", ends))
    return found


def title(diagnosis: Diagnosis) -> str:
    """The head line of every document."""
    return f"Diagnosis of {clean(diagnosis.flights.name or 'flights')}"


def reference_name(diagnosis: Diagnosis) -> str | None:
    """Name of the reference flights, where there are some."""
    if diagnosis.reference is None:
        return None
    return clean(diagnosis.reference.name or "reference")
