"""How entries are drawn: the same colour and marker in every figure.

Colours are those of Okabe and Ito (2008) and a grey for the baseline, told apart under the common
colour blindnesses; the built-in methods keep theirs from report to report. Markers differ too.
"""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
from markupsafe import Markup
from matplotlib.markers import MarkerStyle

from bench.report.pictures.svg import INK
from bench.stats.statistics import Entry

BUILT_IN = (
    Entry("lf_baseline"),
    Entry("hf_scratch"),
    Entry("hf_hotstart"),
    Entry("hybrid", "affine"),
    Entry("hybrid", "sindy"),
    Entry("hybrid", "mlp"),
    Entry("grey_box"),
    Entry("domain_randomization"),
    Entry("hybrid_once"),
    Entry("recalibrated"),
)
"""The order in which methods are shown; others follow by name."""
BLACK = "#000000"
"""What a page in dark mode shows in its own ink."""
COLORS = (
    "#6E6E6E",
    "#D55E00",
    "#009E73",
    "#CC79A7",
    "#56B4E9",
    "#0072B2",
    "#E69F00",
    BLACK,
    "#882255",
    "#999933",
    "#6A3D9A",
    "#44AA99",
)
"""One an entry, in order; repeated, with another marker, beyond twelve."""
MARKERS = "osD^PX*vh<>p"
"""One a method, repeated."""


class Key(NamedTuple):
    """A line of a legend."""

    label: str
    swatch: Markup


def ordered(entries: Iterable[Entry]) -> list[Entry]:
    """The built-in methods in their usual order, then the others by name."""
    entries = set(entries)
    known = [entry for entry in BUILT_IN if entry in entries]
    return known + sorted(entries - set(BUILT_IN))


def look_of(entry: Entry, entries: Sequence[Entry]) -> tuple[str, str]:
    """Colour and marker; whoever shares a colour has another marker."""
    order = [*BUILT_IN, *(e for e in entries if e not in BUILT_IN)]
    turn, place = divmod(order.index(entry), len(COLORS))
    return COLORS[place], MARKERS[(place + turn) % len(MARKERS)]


def on_page(entry: Entry, entries: Sequence[Entry]) -> tuple[str, str]:
    """The same for a page, where black is the page's ink."""
    color, marker = look_of(entry, entries)
    return INK if color == BLACK else color, marker


def legend(entries: Sequence[Entry], everybody: Sequence[Entry]) -> list[Key]:
    """Keys of `entries`, with the look that they have among `everybody`."""
    return [Key(entry.label, _swatch(*look_of(entry, everybody))) for entry in entries]


def _swatch(color: str, marker: str) -> Markup:
    """A line with its marker, as an SVG of 24 by 12 pixels."""
    style = MarkerStyle(marker)
    path = style.get_path().transformed(style.get_transform())
    points = np.concatenate([np.asarray(part, dtype=float) for part in path.to_polygons()])
    corners = " ".join(f"{12 + 9 * x:.1f},{6 - 9 * y:.1f}" for x, y in points)
    paint = "var(--ink)" if color == BLACK else color
    return Markup(
        f'<svg viewBox="0 0 24 12" aria-hidden="true"><path d="M0 6H24" stroke="{paint}"/>'
        f'<polygon points="{corners}" fill="{paint}"/></svg>'
    )
