"""A gap in words: where it lies, how far it shrinks, and in which model.

Beside a twin of the reference flights both drifts are the twin's, which cannot be handed over: the
corrected simulator has the change alone.
"""

from collections.abc import Sequence

from bench.text.numbers import estimate, is_number, percent, quantity, rounded, scaled
from bench.text.words import clean, count, join
from diagnosis.logs.airframes import ASSUMED
from diagnosis.logs.inputs import PRESCRIBED
from diagnosis.result import Diagnosis
from diagnosis.result_parts import ChannelGap

MOST_CHANNELS = 3
"""Channels that a sentence names."""
TWIN = "a model learned from the reference flights (the twin)"
"""What a twin is called where nothing has spoken of it before."""
KEEPS = "the corrected simulator has the change alone and keeps what it missed before"
"""What must be said beside numbers of a twin."""


def where_sentence(diagnosis: Diagnosis) -> str:
    """In which channels the gap lies and when it sets in."""
    if diagnosis.shows_nothing:
        return _of_nothing(diagnosis)
    mostly, names = outstanding(diagnosis.where)
    if not names:
        return "No single channel is beyond noise."
    onsets = [
        f"{clean(c.channel)} at {rounded(c.onset_s, 2)} s"
        for c in diagnosis.where
        if c.onset_s is not None
    ]
    start = f" It sets in during the flights: {join(onsets)} after the start." if onsets else ""
    return f"The gap {'lies mostly' if mostly else 'is beyond noise'} in {names}.{start}"


def _of_nothing(diagnosis: Diagnosis) -> str:
    """Which channels stand out where the verdict sees nothing."""
    names = _names([c for c in diagnosis.where if c.beyond_noise], shares=False)
    if not names:
        return "No channel is beyond noise."
    few = "with so few flights that may be chance"
    why = few if diagnosis.verdict == "too_few" else "no known effect shows in it"
    return f"In {names} the gap exceeds its noise floor, but {why}."


def outstanding(where: Sequence[ChannelGap], shares: bool = True) -> tuple[bool, str]:
    """Channels in which a gap is beyond noise, and whether they hold most of it.

    They are the main channels if noise explains none of these, and otherwise all that it does not
    explain. The text is empty if there are none; with `shares`, it holds the share of each.
    """
    main = [c for c in where if c.main]
    mostly = bool(main) and all(c.beyond_noise for c in main)
    return mostly, _names(main if mostly else [c for c in where if c.beyond_noise], shares)


def _names(channels: Sequence[ChannelGap], shares: bool) -> str:
    """The channels with the largest shares."""
    largest = sorted(channels, key=lambda c: -c.share)[:MOST_CHANNELS]
    return join(clean(c.channel) + (f" ({percent(c.share)})" if shares else "") for c in largest)


def drift_clause(diagnosis: Diagnosis, what: str) -> str:
    """How the drift changes with `what`, such as "it", as a sentence; empty if it is not known."""
    span = drift_span(diagnosis, "its drift")
    if not span:
        return ""
    tail = f"; {KEEPS}" if diagnosis.details.followed else ""
    return f"With {what} in {_model(diagnosis)}, {span}{tail}"


def drift_span(diagnosis: Diagnosis, whose: str) -> str:
    """From what to what `whose`, some drift, falls on held-out flights; empty if not known."""
    shrink = diagnosis.shrink
    if not (is_number(shrink.before) and is_number(shrink.after)):
        return ""
    verb = "falls" if shrink.after <= shrink.before else "grows"
    span = f"{quantity(shrink.before, 'm', 2)} to {quantity(shrink.after, 'm', 2)}"
    return f"{whose} from held-out flights over {shrink.horizon_s:g} s {verb} from {span}"


def expected(diagnosis: Diagnosis) -> str:
    """The drift that is expected once a vehicle is mended, as a sentence; empty if not known."""
    if diagnosis.details.followed:
        span = drift_span(diagnosis, f"the drift of {TWIN}")
        return f"Expected once vehicle and twin agree: {span}; {KEEPS}." if span else ""
    span = drift_span(diagnosis, "the simulator's drift")
    return f"Expected once vehicle and simulator agree: {span}." if span else ""


def shrink_sentence(diagnosis: Diagnosis) -> str:
    """How far the gap shrinks, with its interval; or why that is not known."""
    shrink = diagnosis.shrink
    if not is_number(shrink.percent):
        reason = clean(shrink.reason or "no effect was found").rstrip(".")
        return f"How far the gap shrinks is not known: {reason}."
    sign, word = (1.0, "less") if shrink.percent >= 0.0 else (-1.0, "more")
    ends = scaled(shrink.low, shrink.high, sign)
    value, interval = estimate(sign * shrink.percent, *ends)
    within = f" (95 %: {interval} %)" if interval else ""
    windows = diagnosis.details.windows
    aside = (
        f" Half seconds that fitted badly soon after a gap in the log, or alone, are in neither: "
        f"{windows.aside} of {windows.n}."
        if windows is not None and windows.aside
        else ""
    )
    keeps = f" {KEEPS[0].upper()}{KEEPS[1:]}." if diagnosis.details.followed else ""
    return (
        f"With {added(diagnosis)} in {_model(diagnosis)}, {drift_span(diagnosis, 'its drift')}: "
        f"{value} % {word}{within}, over {count(shrink.n, 'flight')}. Measurement noise is in both "
        f"numbers.{aside}{keeps}"
    )


def added(diagnosis: Diagnosis) -> str:
    """What the better of two numbers has in its model: all of it is found, or it is likeliest."""
    return "what was found" if diagnosis.verdict == "effect" else "the likeliest set of effects"


def _model(diagnosis: Diagnosis) -> str:
    return TWIN if diagnosis.details.followed else "the simulator"


def measured_attitude(diagnosis: Diagnosis) -> list[str]:
    """That the attitude was taken from the logs, where commands were, too, and what that hides."""
    if diagnosis.flights.driven_by != PRESCRIBED:
        return []
    own = diagnosis.flights.airframe
    unknown = own is not None and own.attitude_lag is None and diagnosis.reference is None
    why = "vehicle.toml gives no attitude_lag, so measured" if unknown else "Measured"
    said = (
        f"{why} attitudes drove the simulator: nothing is said of how the vehicle follows attitude "
        "commands."
    )
    more = " Give attitude_lag, or reference flights, to have that looked at."
    return [said + more * unknown]


def not_given(diagnosis: Diagnosis) -> list[str]:
    """The numbers that the data sheet of an own airframe leaves out, and what flies in their place.

    Beside a twin the vehicle is learned, so that they hardly matter there.
    """
    own = diagnosis.flights.airframe
    missing = [key for key in ASSUMED if own is not None and getattr(own, key) is None]
    if not missing or diagnosis.details.followed:
        return []
    said = f"vehicle.toml does not give {join(missing)}"
    if "drag" not in missing:
        return [f"{said}, which a point mass does not need."]
    who = (
        ": the point mass" if missing == ["drag"] else ". Of these a point mass needs drag only: it"
    )
    return [f"{said}{who} flies without, and the answer may name drag."]
