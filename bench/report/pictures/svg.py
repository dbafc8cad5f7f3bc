"""SVG panels that stand inside a page.

Each panel is drawn in stand-in colours that are then replaced by the page's CSS variables, so that
a picture follows the page into dark mode and onto paper. Text stays text, and what has a name shows
it under the pointer.
"""

import dataclasses
import io
import re
from collections.abc import Callable
from typing import Any

import matplotlib
from markupsafe import Markup
from matplotlib.artist import Artist
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, NullFormatter

INK, SOFT, LINE, BEFORE, AFTER = "#010101", "#010102", "#010103", "#010104", "#010105"
VARIABLES = {INK: "ink", SOFT: "soft", LINE: "line", BEFORE: "before", AFTER: "after"}
"""Stand-in colours and the CSS variables that take their places."""
SIZE = (3.5, 2.1)
"""Width and height of a panel [in], of which its text has 8 points."""
NAMED = "named:"
"""How the identifier of an artist begins whose name is shown under the pointer."""

STYLE = {
    "svg.fonttype": "none",
    "font.size": 8.0,
    "text.color": INK,
    "text.parse_math": False,
    "axes.labelcolor": SOFT,
    "axes.edgecolor": LINE,
    "axes.linewidth": 0.8,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.facecolor": "none",
    "figure.facecolor": "none",
    "savefig.facecolor": "none",
    "xtick.color": LINE,
    "ytick.color": LINE,
    "xtick.labelcolor": SOFT,
    "ytick.labelcolor": SOFT,
    "lines.linewidth": 1.4,
}


@dataclasses.dataclass(frozen=True)
class Panel:
    """A picture with the words that stand for it."""

    title: str
    svg: Markup
    alt: str


def name(artist: Artist, text: str) -> None:
    """Lets `text` appear under a pointer that rests on the artist."""
    artist.set_gid(NAMED + text)


def plain_ticks(axis: Axis) -> None:
    """Writes the numbers of an axis that is not linear in full, without mathematics."""
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    axis.set_minor_formatter(NullFormatter())


def render(draw: Callable[[Axes], None], salt: str, size: tuple[float, float] = SIZE) -> Markup:
    """A panel as SVG for the inside of a page; `salt` keeps its ids apart from other panels'."""
    style: Any = {**STYLE, "svg.hashsalt": salt}
    with matplotlib.rc_context(style):
        figure = Figure(figsize=size, layout="constrained")
        draw(figure.subplots())
        text = io.StringIO()
        empty = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(text, format="svg", metadata=empty)
    svg = text.getvalue()
    svg = svg[svg.index("<svg") :]
    svg = re.sub(r"<metadata>.*?</metadata>|<style.*?</style>", "", svg, flags=re.DOTALL)
    svg = re.sub(rf'<g id="{NAMED}([^"]*)">', r"<g><title>\1</title>", svg)
    svg = re.sub(r'<g id="[^"]*"', "<g", svg)
    svg = re.sub(r'(<svg)[^>]*?( viewBox="[^"]*")[^>]*', r'\1\2 aria-hidden="true"', svg, count=1)
    for color, variable in VARIABLES.items():
        svg = re.sub(rf"{color}(?![0-9a-f])", f"var(--{variable})", svg)
    return Markup(svg)  # matplotlib escapes every text
