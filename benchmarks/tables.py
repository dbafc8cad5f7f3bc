"""The benchmarks that `make bench` ran as a tidy table and a figure.

python -m benchmarks.tables BENCHMARKS.json: writes `results/performance/benchmarks.parquet`, a row
for each benchmark (the shortest of its rounds counts: others did what else the machine did), and
`reports/performance/scale.png`, the cost of a drone and step against the team size.
"""

import json
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
import pandas as pd
import seaborn
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter

from bench.paper.figures import STYLE, saved
from bench.report.pictures.looks import COLORS

TABLE = Path("results/performance/benchmarks.parquet")
FIGURE = Path("reports/performance/scale.png")
LABELS = {
    "test_a_training_epoch_per_drone_and_step": "training",
    "test_deployment_per_drone_and_step": "deployment",
}
"""What benchmarks of scale measure."""


def rows(found: Mapping[str, Any]) -> pd.DataFrame:
    """One row a benchmark of a pytest-benchmark document, seconds."""
    return pd.DataFrame(
        [
            {
                "module": Path(each["fullname"].partition("::")[0]).stem,
                "benchmark": each["name"].partition("[")[0],
                **{name: str(value) for name, value in (each["params"] or {}).items()},
                "shortest": each["stats"]["min"],
                "median": each["stats"]["median"],
                "rounds": each["stats"]["rounds"],
                **each["extra_info"],
            }
            for each in found["benchmarks"]
        ]
    )


def draw_scale(table: pd.DataFrame, path: Path) -> bool:
    """Writes the figure; nothing, and False, where no benchmark of scale ran."""
    shown = table.loc[table["benchmark"].isin(LABELS)]
    if shown.empty:
        return False
    shown = shown.assign(
        what=shown["benchmark"].map(LABELS),
        team_size=shown["n_drones"].astype(int),
        simulator=shown["name"].str.replace("_", " "),
    )
    with plt.rc_context(STYLE):
        grid = seaborn.relplot(
            shown,
            x="team_size",
            y="us_per_drone_step",
            hue="simulator",
            style="simulator",
            col="what",
            kind="line",
            markers=True,
            dashes=False,
            palette=COLORS[: shown["simulator"].nunique()],
            height=3.2,
            aspect=1.3,
        )
        grid.set_titles("{col_name}")
        grid.set(xscale="log", yscale="log")
        grid.set_axis_labels("team size N", "µs a drone and step")
        for axis in grid.axes.flat:
            for each, steps in ((axis.xaxis, (1.0, 3.0)), (axis.yaxis, (1.0, 2.0, 5.0))):
                each.set_major_locator(LogLocator(subs=steps))
                each.set_major_formatter(StrMethodFormatter("{x:,.4g}"))
                each.set_minor_formatter(NullFormatter())
        if grid.legend is not None:
            grid.legend.set_title("")
        path.parent.mkdir(parents=True, exist_ok=True)
        return saved(grid.figure, path)


if __name__ == "__main__":
    measured = rows(json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")))
    TABLE.parent.mkdir(parents=True, exist_ok=True)
    measured.to_parquet(TABLE, index=False)
    draw_scale(measured, FIGURE)
    print(measured.drop(columns=["module"]).to_string())  # noqa: T201
