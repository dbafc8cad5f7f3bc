"""The table and the figure that `make bench` writes."""

import pytest

from benchmarks.tables import draw_scale, rows


def benchmark(name, params, seconds, **extra):
    return {
        "name": name + "[some id]",
        "fullname": f"benchmarks/test_scale.py::{name}[some id]",
        "params": params,
        "stats": {"min": seconds, "median": 2.0 * seconds, "rounds": 5},
        "extra_info": extra,
    }


@pytest.fixture
def table():
    name = "test_deployment_per_drone_and_step"
    found = [
        benchmark(name, {"name": "point_mass", "n_drones": n}, 1e-3 * n, us_per_drone_step=1.5)
        for n in (3, 100)
    ]
    return rows({"benchmarks": [*found, benchmark("test_store", None, 0.25)]})


def test_each_benchmark_has_a_row_with_what_it_was_given_and_found(table):
    assert table["benchmark"].tolist() == ["test_deployment_per_drone_and_step"] * 2 + [
        "test_store"
    ]
    assert table["n_drones"].tolist()[:2] == ["3", "100"]
    assert table["shortest"].tolist() == pytest.approx([0.003, 0.1, 0.25])
    assert table["us_per_drone_step"].isna().tolist() == [False, False, True]


def test_scale_is_drawn_where_it_was_measured(table, tmp_path):
    assert draw_scale(table, tmp_path / "scale.png")
    assert (tmp_path / "scale.png").read_bytes().startswith(b"\x89PNG")
    assert not draw_scale(table[table["benchmark"] == "test_store"], tmp_path / "no.png")
    assert not (tmp_path / "no.png").exists()
