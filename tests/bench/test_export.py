"""`bench export`: what other tools read is what the tables say."""

import dataclasses
import json
import sqlite3
import struct
import sys

import numpy as np
import pandas as pd
import pytest
import yaml
from tables_for_tests import Sheet

from bench.cli.app import main
from bench.sharing.export import formats
from bench.sharing.export.column_words import COLUMN_WORDS, TABLE_WORDS
from bench.sharing.export.run_views import CURVES, run_views
from bench.store.tables import SCHEMAS

EXTRAS = {name: found.needs for name, found in formats.FORMATS.items()}
DRAWN = "run000"
"""The run with a curve, of `lf_baseline` and seed 0."""


def sheet():
    """Two entries, of which one has a run that failed; the first has curves."""
    made = Sheet().add("lf_baseline", rewards=(-50.0, -51.0), drawn=True)
    made.add("hybrid", "mlp", rewards=(-45.0,), fleet_minutes=2.0)
    made.add("hybrid", "mlp", rewards=(-1.0,), first_seed=1, status="failed", cause="no memory")
    return made


@pytest.fixture
def tables(tmp_path):
    """A folder of tables."""
    made, folder = sheet().tables(), tmp_path / "mine"
    made.save(folder)
    return folder


@pytest.fixture
def export(tables, tmp_path, capsys):
    """A function that exports the tables, and returns the folder and what was said."""

    def call(name, directory=tables):
        for package in EXTRAS[name]:
            pytest.importorskip(package, reason=f"{package} is not installed")
        out = tmp_path / "exported"
        assert main(["export", str(directory), "--to", name, "--out", str(out)]) == 0
        return out, " ".join(capsys.readouterr().out.split())

    return call


def scalars(folder):
    """(tag, step) -> value in the event files of a folder; the TFRecord format is TensorFlow's."""
    event_pb2 = pytest.importorskip("tensorboardX.proto.event_pb2")
    found = {}
    for path in sorted(folder.glob("events.*")):
        content = path.read_bytes()
        while content:
            (length,) = struct.unpack("<Q", content[:8])
            event = event_pb2.Event.FromString(content[12 : 12 + length])
            content = content[16 + length :]
            for value in event.summary.value:
                found[value.tag, event.step] = value.simple_value
    return found


def test_tensorboard_has_the_curve_and_the_final_metrics_of_every_run(export):
    out, said = export("tensorboard")
    assert {path.name for path in out.iterdir()} == {DRAWN, "run001", "run002"}
    curve = scalars(out / DRAWN)
    assert curve["training/reward", 9] == pytest.approx(-10.0)
    assert {tag for tag, _ in curve} == {f"training/{name}" for name in CURVES}
    assert len(curve) == 30 * len(CURVES)
    assert scalars(out / "run001" / "row")["final/settled_reward", 0] == -51.0
    assert "run003 failed and has no values" in said


def test_mlflow_has_parameters_metrics_and_the_status_of_every_run(export):
    out, _ = export("mlflow")
    with sqlite3.connect(out / "mlflow.db") as database:
        ask = lambda text, *names: database.execute(text, names).fetchall()  # noqa: E731
        statuses = dict(ask("SELECT name, status FROM runs"))
        ((run,),) = ask("SELECT run_uuid FROM runs WHERE name = ?", DRAWN)
        params = dict(ask("SELECT key, value FROM params WHERE run_uuid = ?", run))
        points = ask("SELECT key, value, step FROM metrics WHERE run_uuid = ?", run)
        ((place,),) = ask("SELECT artifact_location FROM experiments WHERE name = 'mine'")
    database.close()
    assert statuses == {DRAWN: "FINISHED", "run001": "FINISHED", "run002": "FINISHED"} | {
        "run003": "FAILED"
    }
    assert (params["method"], params["seed"], params["versions.jax"]) == (
        *("lf_baseline", "0", "0.10.1"),
    )
    assert ("training/reward", -10.0, 9) in points
    assert ("final/settled_reward", -50.0, 0) in points
    assert place == (out / "artifacts").as_uri()


def test_wandb_runs_are_offline_and_named_like_ours(export):
    out, _ = export("wandb")
    folders = [path for path in (out / "wandb").iterdir() if path.name.startswith("offline-run-")]
    assert {path.name.rpartition("-")[2] for path in folders} == {
        *(DRAWN, "run001", "run002", "run003"),
    }
    (file,) = (out / "wandb").glob(f"offline-run-*-{DRAWN}/run-{DRAWN}.wandb")
    written = file.read_bytes()
    assert all(text in written for text in (b"training/reward", b"settled_reward", b"lf_baseline"))
    assert not (out / "wandb" / "latest-run").exists()


def test_marl_eval_gets_complete_runs_and_the_others_are_named(export, tmp_path):
    made = sheet().add("lf_baseline", task="circle", rewards=(-5.0, -6.0))
    made.add("grey_box", task="circle", rewards=(-3.0, -4.0), fleet_minutes=0.5)
    made.add("grey_box", rewards=(-40.0, -41.0), fleet_minutes=0.5)
    made.tables().save(tmp_path / "two")
    out, said = export("marl-eval", tmp_path / "two")
    content = json.loads((out / "raw_data.json").read_text())
    assert [*content] == ["crazyflow, N = 3"]
    tasks = content["crazyflow, N = 3"]
    shapes = {
        (task, algorithm, *runs) for task, of in tasks.items() for algorithm, runs in of.items()
    }
    assert shapes == {
        (task, algorithm, "seed_0", "seed_1")
        for task in ("circle", "spread")
        for algorithm in ("grey_box", "lf_baseline")
    }
    run = tasks["circle"]["grey_box"]["seed_1"]
    assert run["step_1"]["step_count"] == 0.5 * 60 * 50
    assert run["absolute_metrics"]["settled_reward"] == [-4.0]
    assert "Left out: hybrid (mlp) lacks runs of crazyflow, N = 3." in said


def test_marl_eval_names_who_has_more_seeds_than_are_written(export, tmp_path):
    made = Sheet().add("lf_baseline", rewards=(-5.0,)).add("grey_box", rewards=(-5.0,))
    made.add("hybrid", "mlp", rewards=(-3.0, -4.0))
    made.tables().save(tmp_path / "two")
    _, said = export("marl-eval", tmp_path / "two")
    assert "Left out: hybrid (mlp) has further seeds of crazyflow, N = 3." in said


def test_marl_eval_names_a_run_with_a_number_that_is_not_finite(export, tmp_path):
    tables = sheet().tables()
    run = tables.results["run"].iloc[0]
    bad = tables.results["run"].eq(run) & tables.results["metric"].eq("settled_reward")
    results = tables.results.assign(value=tables.results["value"].mask(bad, np.nan))
    dataclasses.replace(tables, results=results).save(tmp_path / "bad")
    out, said = export("marl-eval", tmp_path / "bad")
    assert f"Left out: {run}, whose settled_reward is not finite." in said
    assert "NaN" not in (out / "raw_data.json").read_text()


@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_croissant_validates_and_its_records_are_the_rows(export, tables):
    out, _ = export("croissant")
    mlc = pytest.importorskip("mlcroissant")
    dataset = mlc.Dataset(jsonld=str(out / "croissant.json"))
    assert not dataset.metadata.issues.errors
    assert not dataset.metadata.issues.warnings
    for name in ("runs", "results", "curves"):
        rows = list(dataset.records(name))
        stored = pd.read_parquet(tables / f"{name}.parquet")
        assert len(rows) == len(stored)
        assert {*rows[0]} == {f"{name}/{column}" for column in stored}
    assert rows[9]["curves/reward"] == pytest.approx(-10.0)


def test_the_front_matter_for_the_hub_names_files_that_are_there(export, tables):
    out, _ = export("huggingface")
    _, header, body = (out / "README.md").read_text().split("---\n", 2)
    content = yaml.safe_load(header)
    assert (content["license"], content["pretty_name"]) == ("mit", "mine")
    assert content["size_categories"] == ["n<1K"]
    files = {entry["config_name"]: out / entry["data_files"] for entry in content["configs"]}
    assert {*files} == {"results", "curves", "trajectories", "runs"}
    for name, path in files.items():
        pd.testing.assert_frame_equal(
            pd.read_parquet(path), pd.read_parquet(tables / f"{name}.parquet")
        )
    assert [entry["config_name"] for entry in content["configs"] if entry["default"]] == ["runs"]
    assert "| `fleet_minutes`" not in body
    assert "| `team_size` | Number of drones. |" in body


def test_tables_without_curves_are_exported_and_said_to_have_none(export, tmp_path):
    Sheet().add().tables().save(tmp_path / "rows")
    out, said = export("huggingface", tmp_path / "rows")
    assert {path.name for path in (out / "data").iterdir()} == {"results.parquet", "runs.parquet"}
    assert "keeps no learning curves" in said


def test_every_table_and_column_has_words():
    assert {*TABLE_WORDS} == {*SCHEMAS}
    assert {*COLUMN_WORDS} == {name for schema in SCHEMAS.values() for name in schema.columns}


def test_what_is_known_of_a_run_is_plain():
    failed = list(run_views(sheet().tables()))[-1]
    assert (failed.failed, failed.metrics, list(failed.points())) == (True, {}, [])
    assert failed.about["cause"] == "no memory"
    assert {type(value) for value in failed.about.values()} <= {str, int, float, bool}


@pytest.mark.parametrize("name", [name for name, needs in EXTRAS.items() if needs])
def test_a_missing_extra_gets_one_line_that_names_the_command(
    name, tables, tmp_path, monkeypatch, capsys
):
    monkeypatch.setitem(sys.modules, EXTRAS[name][0], None)
    before = sorted(tmp_path.iterdir())
    out = tmp_path / "exported"
    assert main(["export", str(tables), "--to", name, "--out", str(out)]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert f"pip install 'fidelity-bench[{name}]'" in said
    assert sorted(tmp_path.iterdir()) == before


def test_nothing_is_left_of_an_export_that_fails(tables, tmp_path, monkeypatch, capsys):
    def broken(tables, title, folder, place):
        (folder / "half").write_text("written")
        raise OSError("the disk is full")

    before = sorted(tmp_path.iterdir())
    monkeypatch.setattr("bench.sharing.export.to_huggingface.write", broken)
    out = tmp_path / "exported"
    assert main(["export", str(tables), "--to", "huggingface", "--out", str(out)]) == 1
    assert "the disk is full" in capsys.readouterr().err
    assert sorted(tmp_path.iterdir()) == before


def test_a_folder_that_holds_something_is_refused(tables, capsys):
    assert main(["export", str(tables), "--to", "marl-eval", "--out", str(tables)]) == 2
    assert "is there already and would be overwritten" in capsys.readouterr().err
