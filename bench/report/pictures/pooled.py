"""Figures of a pool: interquartile means with their intervals, and performance profiles."""

from matplotlib.axes import Axes

from bench.report.pictures.looks import Key, legend, on_page
from bench.report.pictures.svg import INK, Panel, name, render
from bench.stats.pooled import Pool
from bench.text.numbers import measured, number

SIZE = (4.6, 3.0)
"""Width and height of a panel [in]."""
MEANS_NOTE = (
    "Interquartile means: 95 % percentile-bootstrap intervals, each by itself; they may overlap "
    "between methods whose difference is certain. Letters: tie groups. Profiles: share of a "
    "method's runs, cells weighing alike, whose score is above the one on the horizontal axis, "
    "with such intervals point by point; further up and to the right is better."
)


def pooled_panels(pool: Pool, salt: str) -> tuple[list[Panel], list[Key]]:
    """Means and profiles of one pool, and who is drawn how."""
    everybody = [row.entry for row in pool.rows]
    panels = [_means(pool, f"{salt}-means"), _profiles(pool, f"{salt}-profiles")]
    return panels, legend(everybody, everybody)


def _means(pool: Pool, salt: str) -> Panel:
    everybody = [row.entry for row in pool.rows]

    def draw(axes: Axes) -> None:
        for i, row in enumerate(pool.rows):
            color, marker = on_page(row.entry, everybody)
            low, high = row.iqm.value - row.iqm.low, row.iqm.high - row.iqm.value
            drawn = axes.errorbar(
                row.iqm.value, -i, xerr=[[low], [high]], color=color, marker=marker, linestyle=""
            )
            name(drawn.lines[0], f"{row.entry.label}: {measured(*row.iqm)}")
        labels = [f"{row.entry.label} ({row.groups})" for row in pool.rows]
        axes.set_yticks([-i for i in range(len(labels))], labels, color=INK)
        axes.set_xlabel("interquartile mean of the score")

    said = "; ".join(f"{row.entry.label} {number(row.iqm.value, 4)}" for row in pool.rows)
    alt = f"Interquartile mean of the score: {said}."
    return Panel("Interquartile means", render(draw, salt, SIZE), alt)


def _profiles(pool: Pool, salt: str) -> Panel:
    everybody = [row.entry for row in pool.rows]

    def draw(axes: Axes) -> None:
        for row in pool.rows:
            color, _ = on_page(row.entry, everybody)
            low, high = [x.low for x in row.profile], [x.high for x in row.profile]
            axes.fill_between(pool.grid, low, high, color=color, alpha=0.12, linewidth=0)
            values = [share.value for share in row.profile]
            (line,) = axes.step(pool.grid, values, where="post", color=color)
            name(line, row.entry.label)
        axes.set(xlabel="score", ylabel="share of runs above it", ylim=(-0.02, 1.02))

    alt = (
        f"Share of runs above a score, for {len(pool.rows)} methods; half of the runs of "
        f"{pool.rows[0].entry.label} are above {_median(pool.grid, pool.rows[0].profile)}."
    )
    return Panel("Performance profiles", render(draw, salt, SIZE), alt)


def _median(grid: list[float], profile: list) -> str:
    """The highest score that half of the runs exceed."""
    above = [score for score, share in zip(grid, profile, strict=True) if share.value >= 0.5]
    return number(max(above, default=grid[0]), 3)
