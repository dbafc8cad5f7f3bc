"""Figures of a pool: interquartile means with their intervals, and performance profiles."""

import html
from collections.abc import Mapping

import plotly.graph_objects as go

from bench.report.figures import Drawing, Style, drawing, faded
from bench.stats.pooled import Pool
from bench.stats.statistics import Entry
from bench.text.numbers import number


def pooled_drawings(pool: Pool, styles: Mapping[Entry, Style]) -> list[Drawing]:
    """Means and profiles of one pool."""
    return [_means(pool, styles), _profiles(pool, styles)]


def _means(pool: Pool, styles: Mapping[Entry, Style]) -> Drawing:
    plot = go.Figure()
    for row in reversed(pool.rows):
        style, iqm = styles[row.entry], row.iqm
        plot.add_scatter(
            x=[iqm.value],
            y=[f"{html.escape(row.entry.label)} ({row.groups})"],
            error_x={
                "type": "data",
                "symmetric": False,
                "array": [iqm.high - iqm.value],
                "arrayminus": [iqm.value - iqm.low],
            },
            mode="markers",
            marker={"color": style.color, "symbol": style.symbol, "size": 10},
            showlegend=False,
            hovertemplate="%{y}<br>%{x:.4f}<extra></extra>",
        )
    plot.update_xaxes(title="interquartile mean of the score")
    plot.update_yaxes(automargin=True)
    said = "; ".join(f"{row.entry.label} {number(row.iqm.value, 4)}" for row in pool.rows)
    return drawing(
        "Interquartile means",
        plot,
        height=150 + 34 * len(pool.rows),
        legend=0,
        caption="Higher is better. Bars: 95 % percentile-bootstrap intervals, each by itself; "
        "they may overlap between methods whose difference is certain. Letters: tie groups.",
        alt=f"Interquartile mean of the score, best first: {said}.",
    )


def _profiles(pool: Pool, styles: Mapping[Entry, Style]) -> Drawing:
    plot = go.Figure()
    for row in pool.rows:
        style, name = styles[row.entry], html.escape(row.entry.label)
        low, high = ([getattr(share, end) for share in row.profile] for end in ("low", "high"))
        plot.add_scatter(
            x=[*pool.grid, *reversed(pool.grid)],
            y=[*high, *reversed(low)],
            fill="toself",
            fillcolor=faded(style.color, 0.12),
            line={"width": 0},
            legendgroup=name,
            showlegend=False,
            hoverinfo="skip",
        )
        plot.add_scatter(
            x=pool.grid,
            y=[share.value for share in row.profile],
            mode="lines",
            name=name,
            legendgroup=name,
            line={"color": style.color, "dash": style.dash, "shape": "hv"},
            hovertemplate="above %{x:.3f}: %{y:.0%}",
        )
    plot.update_xaxes(title="score")
    plot.update_yaxes(title="share of runs above it", tickformat=".0%", range=[-0.02, 1.02])
    best = pool.rows[0]
    return drawing(
        "Performance profiles",
        plot,
        height=430,
        legend=len(pool.rows),
        caption="Share of a method's runs, cells weighing alike, whose score is above the one on "
        "the horizontal axis; a curve further up and to the right is better. Bands: 95 % "
        "percentile-bootstrap intervals, point by point.",
        alt=f"Share of runs above a score, for {len(pool.rows)} methods; half of the runs of "
        f"{best.entry.label} are above {_median(pool.grid, best.profile)}.",
    )


def _median(grid: list[float], profile: list) -> str:
    """The highest score that half of the runs exceed."""
    above = [score for score, share in zip(grid, profile, strict=True) if share.value >= 0.5]
    return number(max(above, default=grid[0]), 3)
