"""The drawing of the pipeline and the top views."""

import dataclasses
from pathlib import Path

import numpy as np
import pytest
from matplotlib.image import imread

from bench.paper.pictures import ARROWS, BOXES, keep_flights, write_pipeline, write_top_views
from bench.store.tables import FEW_TRAJECTORIES, SCHEMAS, Tables, table


@pytest.fixture(scope="module")
def flown():
    """The committed tables of the paper, with made-up paths of its Hybrids of three drones."""
    tables = Tables.load(Path(__file__).parents[3] / "results" / "paper")
    runs = tables.runs.query("method == 'hybrid' and residual == 'mlp' and team_size == 3")["run"]
    t = np.arange(0.0, 2.0, 0.1)
    rows = [
        {"run": run, "drone": i, "t": x, "pos_x": np.cos(x + i), "pos_y": np.sin(x), "pos_z": 1.0}
        for run in runs
        for i in range(3)
        for x in t
    ]
    assert set(rows[0]) == set(SCHEMAS["trajectories"].columns)
    return dataclasses.replace(tables, trajectories=table("trajectories", rows))


def test_the_pipeline_is_drawn_of_boxes_that_are_joined(tmp_path):
    assert {name for arrow in ARROWS for name in arrow} == set(BOXES)
    assert write_pipeline(Tables.empty(), tmp_path / "p.png")
    picture = imread(tmp_path / "p.png")
    assert picture.shape[1] > 1000
    assert picture.std() > 0.05


def test_top_views_are_there_where_trajectories_are(flown, tmp_path):
    path = tmp_path / "v.png"
    without = dataclasses.replace(flown, trajectories=table("trajectories", []))
    assert not write_top_views(flown, path)  # of five drones
    assert not write_top_views(without, path, 3)
    assert not path.exists()
    assert write_top_views(flown, path, 3)
    assert imread(path).std() > 0.02


def test_flights_that_are_kept_draw_the_same_picture(flown, tmp_path):
    few = dataclasses.replace(flown, curves=table("curves", []))
    few.save(tmp_path)
    (tmp_path / "trajectories.parquet").unlink()
    assert Tables.load(tmp_path).trajectories.empty
    keep_flights(flown, tmp_path, 3)
    kept = Tables.load(tmp_path)
    assert (
        kept.trajectories["run"].nunique()
        == kept.runs.query("method == 'hybrid' and residual == 'mlp' and team_size == 3")[
            "task"
        ].nunique()
    )  # one seed a task
    assert write_top_views(flown, tmp_path / "all.png", 3)
    assert write_top_views(kept, tmp_path / "few.png", 3)
    assert (tmp_path / "all.png").read_bytes() == (tmp_path / "few.png").read_bytes()
    few.save(tmp_path)  # the whole table counts where it is there
    assert (tmp_path / FEW_TRAJECTORIES).is_file()
    assert len(Tables.load(tmp_path).trajectories) == len(flown.trajectories)
