"""The tables of a diagnosis as texts, for the page and for Markdown alike."""

import dataclasses
from typing import Any

from bench.diagnosis_report.effect_words import effect_words, parameter_words
from bench.diagnosis_report.numbers import (
    MISSING,
    clean,
    estimate,
    is_number,
    number,
    percent,
    probability,
    quantity,
    scale_of,
    with_unit,
)
from bench.diagnosis_report.sentences import Json, chosen_set, parameter_texts, set_label
from diagnosis.logs.noise import CHANNELS, UNITS


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


@dataclasses.dataclass(frozen=True)
class Bar:
    """A bar with an interval and a mark, all as shares of the longest in the table."""

    length: float
    low: float | None = None
    high: float | None = None
    mark: float | None = None
    chosen: bool = True
    """Whether it stands out from the others."""


def where_table(diagnosis: Json) -> Table:
    """The gap per channel, largest share first."""
    channels = sorted(diagnosis["where"], key=lambda c: -_or_zero(c["share"]))
    headings = ("channel", "share", "gap", "95 %", "noise floor", "sets in")
    rows = [
        (
            clean(c["channel"]),
            percent(c["share"]),
            *_channel_texts(c),
            with_unit(number(c.get("onset_s"), 2), "s"),
        )
        for c in channels
    ]
    shown = len(headings) if any(row[-1] != MISSING for row in rows) else len(headings) - 1
    return Table(
        "Gap per channel: share of the whole, and root mean square",
        headings[:shown],
        tuple(row[:shown] for row in rows),
        bars=_where_bars(channels),
        bar_heading="gap in noise floors",
    )


def _channel_texts(channel: Json) -> tuple[str, str, str]:
    factor, unit = scale_of(channel["unit"])
    gap, low, high = (
        factor * channel[key] if is_number(channel.get(key)) else None
        for key in ("gap_rms", "low", "high")
    )
    value, interval = estimate(gap, low, high)
    return (
        with_unit(value, unit),
        interval or MISSING,
        quantity(channel["noise_floor"], clean(channel["unit"])),
    )


def _in_noise_floors(channel: Json) -> list[float | None]:
    """Gap and both ends of its interval over the noise floor; None where one is not known."""
    floor = channel["noise_floor"]
    values = [channel.get(key) for key in ("gap_rms", "low", "high")]
    if not is_number(floor) or floor <= 0.0:
        return [None] * 3
    return [value / floor if is_number(value) else None for value in values]


def _where_bars(channels: list[Json]) -> tuple[Bar | None, ...]:
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
            (gap if low is None else low) > 1.0,
        )
        for gap, low, high in scaled
    )


def candidates_table(diagnosis: Json) -> Table | None:
    """What was considered, most probable first."""
    candidates = sorted(
        diagnosis.get("candidates") or [],
        key=lambda c: (-_or_zero(c["probability"]), -_or_zero(c["evidence"])),
    )
    if not candidates:
        return None
    chosen = chosen_set(diagnosis)
    rows = [
        (
            set_label(c["effects"]),
            probability(c["probability"]),
            number(c["evidence"], 2),
            f"{number(c['shrink_percent'], 2)} %"
            if is_number(c.get("shrink_percent"))
            else MISSING,
        )
        for c in candidates
    ]
    return Table(
        "Candidates by their posterior, the share of each among all that were looked at",
        ("effects", "posterior", "evidence [nats]", "drift in the fit falls by"),
        tuple(rows),
        bars=tuple(
            Bar(min(1.0, _or_zero(c["probability"])), chosen=set(c["effects"]) == chosen)
            for c in candidates
        ),
        bar_heading="posterior",
    )


def support_table(diagnosis: Json) -> Table | None:
    """What each effect of the likeliest set does for flights that were left out of the fit."""
    rows = []
    for line in details(diagnosis, "support"):
        value, interval = estimate(line["percent"], line["low"], line["high"])
        cell = (f"{value} %", f"{interval} %") if interval else (MISSING, MISSING)
        rows.append((effect_words(clean(line["effect"])).label, *cell, str(line["n"])))
    caption = "The likeliest set, effect by effect, on flights left out of the fit in turn"
    headings = ("effect", "misfit falls by", "95 %", "flights")
    return Table(caption, headings, tuple(rows)) if rows else None


def parameters_table(effect: Json) -> Table | None:
    """The parameters of a found effect, in the units that people use and in SI."""
    name = clean(effect["name"])
    rows = []
    for key, parameter in (effect.get("parameters") or {}).items():
        words = parameter_words(name, key)
        value, interval = parameter_texts(name, key, parameter)
        raw = with_unit(number(parameter["value"], 4), parameter["unit"])
        rows.append((clean(words.label), value, interval or MISSING, f"{clean(key)} = {raw}"))
    if not rows:
        return None
    caption = f"Parameters of {effect_words(name).label}"
    return Table(caption, ("parameter", "value", "95 %", "in the simulator"), tuple(rows))


def shrink_table(diagnosis: Json) -> Table | None:
    """Drift before and after per channel; a channel has a percentage or both numbers."""
    shrink = diagnosis.get("shrink") or {}
    rows = []
    for channel, entry in (shrink.get("by_channel") or {}).items():
        entry = entry if isinstance(entry, dict) else {"percent": entry}
        unit = clean(entry.get("unit", ""))
        less = entry.get("percent")
        rows.append(
            (
                clean(channel),
                quantity(entry.get("before"), unit),
                quantity(entry.get("after"), unit),
                f"{number(less, 2)} %" if is_number(less) else MISSING,
            )
        )
    if not rows:
        return None
    headings = ("channel", "before", "after", "falls by")
    empty = {i for i in (1, 2) if all(row[i] == MISSING for row in rows)}
    keep = [i for i in range(4) if i not in empty]
    return Table(
        "Gap on held-out flights, by channel",
        tuple(headings[i] for i in keep),
        tuple(tuple(row[i] for i in keep) for row in rows),
    )


def not_observable_table(diagnosis: Json) -> Table | None:
    """Effects on which these flights say nothing, with the reason."""
    rows = [
        (effect_words(clean(line["effect"])).label, clean(line["why"]))
        for line in details(diagnosis, "not_observable")
    ]
    caption = "Effects on which these flights say nothing"
    return Table(caption, ("effect", "why"), tuple(rows), frozenset({0, 1})) if rows else None


def limits_table(diagnosis: Json) -> Table | None:
    """The smallest size of each effect that these flights could have shown."""
    rows = []
    for line in details(diagnosis, "limits"):
        name, key = clean(line["effect"]), clean(line["parameter"])
        words = parameter_words(name, key)
        smallest = line["smallest"]
        size = number(words.factor * smallest, 2) if is_number(smallest) else MISSING
        rows.append(
            (
                effect_words(name).label,
                clean(words.label),
                with_unit(size, words.unit or line["unit"]),
            )
        )
    caption = "Smallest size that these flights could have shown"
    headings = ("effect", "parameter", "size")
    return Table(caption, headings, tuple(rows), frozenset({0, 1})) if rows else None


def shared_table(diagnosis: Json) -> Table | None:
    """With a reference: what separates the simulator from both sets of flights."""
    rows = []
    for line in details(diagnosis, "shared"):
        name, key = clean(line["name"]), clean(line["parameter"])
        value, _ = parameter_texts(name, key, line)
        rows.append((effect_words(name).label, clean(parameter_words(name, key).label), value))
    caption = "In the reference flights already, against the simulator as delivered"
    headings = ("effect", "parameter", "value")
    return Table(caption, headings, tuple(rows), frozenset({0, 1})) if rows else None


def noise_table(diagnosis: Json) -> Table | None:
    """Noise of each channel as estimated from the logs."""
    units = dict(zip(CHANNELS, UNITS, strict=True))
    noise = (diagnosis.get("details") or {}).get("noise") or {}
    rows = [
        (clean(channel), quantity(sigma, units.get(channel, "")))
        for channel, sigma in noise.items()
    ]
    caption = "Noise estimated from the logs, one standard deviation"
    return Table(caption, ("channel", "noise"), tuple(rows)) if rows else None


def left_out_table(diagnosis: Json) -> Table | None:
    """Flights that were not used, with the reason."""
    rows = []
    for line in diagnosis["flights"].get("left_out") or []:
        line = line if isinstance(line, dict) else {"name": line}
        rows.append((clean(line["name"]), clean(line.get("reason") or "no reason given")))
    caption = "Flights that were left out"
    return Table(caption, ("flight", "why"), tuple(rows), frozenset({0, 1})) if rows else None


def flights_table(diagnosis: Json) -> Table:
    """Every flight that was used, its length, and for what."""
    flights = diagnosis["flights"]
    seconds = (diagnosis.get("details") or {}).get("flights_seconds") or {}
    fit, held_out = flights.get("fit") or [], flights.get("held_out") or []
    rows = []
    for name in dict.fromkeys([*fit, *held_out]):
        both = "fit, and held out in turn" if name in fit else "held out"
        use = both if name in held_out else "fit"
        length = seconds.get(name)
        rows.append((clean(name), f"{length:.1f} s" if is_number(length) else MISSING, use))
    return Table("Flights used", ("flight", "length", "use"), tuple(rows), frozenset({0, 2}))


def facts(diagnosis: Json) -> list[tuple[str, str]]:
    """What stands at the head of the page: name and value."""
    flights = diagnosis["flights"]
    held_out = flights.get("held_out") or []
    found = [
        ("simulator", clean(diagnosis["simulator"])),
        ("drone", clean(diagnosis["drone"])),
        ("flights", str(flights["n"])),
        ("held out", str(len(held_out))),
        ("flown", f"{number(flights['seconds'])} s"),
    ]
    fit = (diagnosis.get("details") or {}).get("chi2_per_dof") or {}
    texts = [number(fit[key]) for key in ("before", "after") if is_number(fit.get(key))]
    if texts:
        found.append(("misfit (1: only noise)", " → ".join(texts)))
    return found


def details(diagnosis: Json, key: str) -> list[Any]:
    """A list among the details; empty where it is missing."""
    return (diagnosis.get("details") or {}).get(key) or []


def _or_zero(value: Any) -> float:
    return value if is_number(value) else 0.0
