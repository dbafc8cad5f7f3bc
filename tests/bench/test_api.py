"""`bench.load` and `bench.run`, as scripts and notebooks use them."""

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import bench
from bench.plan.keys import SettingsError

PAPER = Path(__file__).parents[2] / "results" / "paper"


def test_the_public_names_are_imported_when_they_are_used():
    script = (
        "import sys, bench, diagnosis; assert {'load', 'run'} <= {*dir(bench)}; "
        "assert {'corrected', 'diagnose'} <= {*dir(diagnosis)}; "
        "sys.exit('jax is imported' if 'jax' in sys.modules else 0)"
    )
    subprocess.run([sys.executable, "-c", script], check=True)


def test_a_frame_has_a_row_a_run_and_a_column_a_metric():
    tables = bench.load(PAPER)
    frame = tables.to_pandas()
    assert len(frame) == len(tables.runs)
    assert frame["run"].is_unique
    long = tables.results.set_index(["run", "metric"])["value"]
    for run, metric in [(frame["run"].iloc[0], "reward"), (frame["run"].iloc[-1], "epochs")]:
        assert frame.set_index("run").at[run, metric] == long[run, metric]
    grey = frame.query("method == 'grey_box' and task == 'circle' and team_size == 3")
    assert grey["fleet_minutes"].unique() == pytest.approx([0.5])
    assert set(grey["simulator"]) == {"crazyflow"}


def test_run_trains_a_part_of_a_suite_and_returns_its_tables(in_process, write_suite, tmp_path):
    suite, out = write_suite("instant", "failing", seeds=2), tmp_path / "out"
    options = {"methods": ["instant"], "seeds": 1, "settings": {"inner.epochs": 2}, "jobs": 1}
    frame = bench.run(suite, out=out, **options).to_pandas()
    assert frame[["method", "seed", "variant", "status"]].to_numpy().tolist() == [
        ["instant", 0, "horizon=5, inner.epochs=2", "ok"]
    ]
    assert np.isfinite(frame["reward"]).all()
    assert (out / "report.html").is_file()
    both = bench.run(suite, out=out, seeds=1, jobs=1).to_pandas().set_index("method")
    assert both["status"].to_dict() == {"instant": "ok", "failing": "failed"}
    assert both.at["failing", "cause"] == "RuntimeError: the propellers fell off"
    assert np.isnan(both.at["failing", "reward"])


def test_run_refuses_a_setting_that_a_method_does_not_have(plugins, write_suite, tmp_path):
    with pytest.raises(SettingsError, match="Did you mean 'epochs'"):
        bench.run(write_suite("instant"), out=tmp_path / "out", settings={"inner.epoch": 2})
    assert not (tmp_path / "out").exists()
