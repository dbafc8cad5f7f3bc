"""Pictures of a diagnosis as small SVG panels that stand inside a page."""

from collections.abc import Sequence
from typing import Any

import numpy as np
from jaxtyping import Float
from matplotlib.axes import Axes

from bench.diagnosis_report.gap_text import added
from bench.report.pictures.svg import AFTER, BEFORE, INK, SOFT, Panel, render
from bench.text.numbers import is_number, rounded, scale_of, with_unit
from bench.text.words import clean, shorten
from diagnosis.result import Diagnosis
from diagnosis.result_parts import ChannelGap, GapInTime, RegimeGap

MOST_FLIGHTS = 6
"""Flights with a before/after panel."""
MOST_CHANNELS = 4
"""Channels with panels, those with the largest share of the gap."""
MOST_POINTS = 300
"""Points of a line: what keeps a page small."""


def before_after_panels(diagnosis: Diagnosis) -> list[Panel]:
    """Drift along held-out flights, in the simulator as it is and as corrected."""
    lines = diagnosis.details.before_after[:MOST_FLIGHTS]
    highest = [x for line in lines for x in (*line.before, *line.after)]
    top = 1.05 * max((x for x in highest if is_number(x)), default=1.0)
    factor, unit = scale_of("m") if top < 1.0 else (1.0, "m")
    panels, with_ = [], added(diagnosis)
    for i, line in enumerate(lines):
        t, before, after = map(_numbers, (line.t, line.before, line.after))

        def draw(axes: Axes, t: Any = t, before: Any = before, after: Any = after) -> None:
            axes.plot(*_thinned(t, factor * before), color=BEFORE, ls=(0, (4, 1.5)))
            axes.plot(*_thinned(t, factor * after), color=AFTER)
            axes.set(xlabel="time [s]", ylabel=f"drift [{unit}]", ylim=(0.0, factor * top or 1.0))

        middles = [
            with_unit(rounded(factor * _middle(values), 2), unit) for values in (before, after)
        ]
        name = clean(line.flight)
        alt = f"Drift along {name}: median {middles[0]} without, {middles[1]} with {with_}."
        panels.append(Panel(shorten(name, 40), render(draw, f"before-after-{i}"), alt))
    return panels


def time_panels(diagnosis: Diagnosis) -> list[Panel]:
    """The gap against the time since the start, with noise floor and onset."""
    channels = {c.channel: c for c in diagnosis.where}
    lines = [x for x in diagnosis.details.gap_in_time if len(x.t) > 1 and x.channel in channels]
    lines.sort(key=lambda line: -channels[line.channel].share)
    shown = enumerate(lines[:MOST_CHANNELS])
    return [_time_panel(line, channels[line.channel], f"time-{i}") for i, line in shown]


def _time_panel(line: GapInTime, channel: ChannelGap, salt: str) -> Panel:
    factor, unit = scale_of(line.unit)
    t, gap = _numbers(line.t), factor * _numbers(line.gap)
    low, high = (factor * _numbers(end) for end in (line.low, line.high))

    def draw(axes: Axes) -> None:
        if len(low) == len(high) == len(t):
            axes.fill_between(t, low, high, color=BEFORE, alpha=0.2, lw=0.0)
        axes.plot(t, gap, color=BEFORE)
        _noise_floor(axes, channel, factor)
        _onset(axes, channel)
        axes.set(xlabel="time since start [s]", ylabel=f"gap [{with_unit('', unit).strip()}]")
        axes.set_ylim(bottom=0.0)

    alt = _range_text(f"Gap of {clean(line.channel)} in time", gap, unit)
    return Panel(clean(line.channel), render(draw, salt), alt)


def regime_panels(diagnosis: Diagnosis) -> list[tuple[str, list[Panel]]]:
    """Per channel: the gap against speed, tilt, thrust and whatever else varied."""
    channels = sorted(diagnosis.where, key=lambda c: -c.share)[:MOST_CHANNELS]
    found = []
    for i, channel in enumerate(c for c in channels if c.share > 0.0):
        panels = []
        for j, regime in enumerate(channel.regimes):
            gap = _numbers(regime.gap)
            if np.isfinite(gap).sum() >= 2 and len(regime.edges) == len(gap) + 1:
                panels.append(_regime_panel(channel, regime, f"regime-{i}-{j}"))
        if panels:
            found.append((clean(channel.channel), panels))
    return found


def _regime_panel(channel: ChannelGap, regime: RegimeGap, salt: str) -> Panel:
    factor, unit = scale_of(channel.unit)
    gap = factor * _numbers(regime.gap)
    scale, shown = scale_of(regime.unit) if regime.unit == "rad" else (1.0, regime.unit)
    edges = scale * _numbers(regime.edges)
    variable = clean(regime.variable)

    def draw(axes: Axes) -> None:
        axes.bar(edges[:-1], gap, np.diff(edges), align="edge", color=BEFORE, alpha=0.35, ec=BEFORE)
        _noise_floor(axes, channel, factor)
        axes.set(xlabel=_axis(variable, shown), ylabel=_axis("gap", unit))

    alt = _range_text(f"Gap of {clean(channel.channel)} by {variable}", gap, unit)
    return Panel(f"by {variable}", render(draw, salt), alt)


def _axis(name: str, unit: str) -> str:
    shown = with_unit("", clean(unit)).strip()
    return f"{name} [{shown}]" if shown else name


def _noise_floor(axes: Axes, channel: ChannelGap, factor: float) -> None:
    axes.axhline(factor * channel.noise_floor, color=SOFT, lw=1.0, ls=(0, (2, 2)))


def _onset(axes: Axes, channel: ChannelGap) -> None:
    onset = channel.onset_s
    if onset is None:
        return
    axes.axvline(onset, color=INK, lw=1.0, ls=":")
    late = onset > np.mean(axes.get_xlim())
    axes.annotate(
        f" sets in at {rounded(onset, 2)} s ",
        (onset, 1.0),
        xycoords=("data", "axes fraction"),
        va="bottom",
        ha="right" if late else "left",
        color=INK,
    )


def _range_text(what: str, gap: Float[np.ndarray, " time"], unit: str) -> str:
    seen = gap[np.isfinite(gap)]
    if not len(seen):
        return f"{what}: no data."
    ends = (with_unit(rounded(end, 2), unit) for end in (seen[0], seen[-1], seen.max()))
    return "{}: {} at the left end, {} at the right, {} at most.".format(what, *ends)


def _numbers(values: Sequence[Any]) -> Float[np.ndarray, " time"]:
    """The values as an array; NaN for what is no number."""
    return np.array([x if is_number(x) else np.nan for x in values], dtype=np.float64)


def _thinned(
    t: Float[np.ndarray, " time"], values: Float[np.ndarray, " time"]
) -> tuple[Float[np.ndarray, " shown"], Float[np.ndarray, " shown"]]:
    """At most MOST_POINTS of the points, and a break wherever time jumps."""
    step = max(1, -(-len(t) // MOST_POINTS))
    t, values = t[::step], values[::step]
    if len(t) < 3:
        return t, values
    jumps = np.flatnonzero(np.diff(t) > 5.0 * np.nanmedian(np.diff(t))) + 1
    return np.insert(t, jumps, np.nan), np.insert(values, jumps, np.nan)


def _middle(values: Float[np.ndarray, " time"]) -> float:
    return float(np.nanmedian(values)) if np.isfinite(values).any() else float("nan")
