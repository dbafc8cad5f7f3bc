"""The cost to be as good as training from scratch in the high-fidelity simulator."""

import dataclasses
import math

import numpy as np
import pandas as pd
import pytest
from tables_for_tests import SPAWN, TAKEOFF, Sheet

from bench.report.leaderboard import COLUMNS
from bench.stats.leaderboard_rows import leaderboard_rows
from bench.stats.statistics import Cell, Entry
from bench.stats.target import SMOOTHING, costs_to_target
from bench.store.tables import Tables

CELL = Cell("spread", 3)
TOLERATED = -0.01 * SPAWN
"""How far below the reference's mean a return may be."""


def costs(sheet, curves=()):
    tables = sheet.tables()
    rows = [
        {"run": run, "epoch": i, "reward": x, "smooth_reward": x, "crashes": 0.0, "grad_norm": 1.0}
        for run, values in curves
        for i, x in enumerate(values)
    ]
    if rows:
        tables = Tables(tables.results, pd.DataFrame(rows), tables.trajectories, tables.runs)
    return costs_to_target(tables).get(CELL, {})


def test_the_target_is_a_little_below_the_reference_and_every_run_is_paid_for():
    sheet = Sheet().add("hf_scratch", rewards=(-50.0, -60.0), fleet_minutes=100.0)
    near, far = -55.0 - 0.9 * TOLERATED, -55.0 - 1.1 * TOLERATED
    sheet.add("hybrid", "mlp", rewards=(near, far, far), fleet_minutes=40.0, train_seconds=10.0)
    found = costs(sheet)[Entry("hybrid", "mlp")]
    assert found.minutes == {0: 40.0}
    assert (found.expected_minutes, found.expected_seconds) == (120.0, 30.0)


def test_who_never_gets_there_has_no_finite_cost():
    sheet = Sheet().add("hf_scratch", fleet_minutes=100.0).add(rewards=(-500.0, -600.0))
    found = costs(sheet)[Entry("lf_baseline")]
    assert (found.minutes, found.expected_minutes) == ({}, math.inf)
    row = next(row for row in leaderboard_rows(sheet.tables()) if row["method"] == "lf_baseline")
    column = next(c for c in COLUMNS if c.heading == "HF fleet-minutes to target")
    assert column.text(row) == "- (0 of 2 runs)"
    assert math.isnan(column.order(row))


def test_diverged_runs_are_paid_for_and_reach_the_target_if_their_policy_does():
    sheet = Sheet().add("hf_scratch", fleet_minutes=100.0)
    sheet.add("hf_hotstart", fleet_minutes=30.0)
    diverged = {"fleet_minutes": 30.0, "status": "diverged"}
    sheet.add("hf_hotstart", rewards=(-500.0,), first_seed=1, **diverged)
    found = costs(sheet)[Entry("hf_hotstart")]
    assert (found.minutes, found.expected_minutes) == ({0: 30.0}, 60.0)
    sheet.add("hf_hotstart", rewards=(-50.0,), first_seed=2, **diverged)
    found = costs(sheet)[Entry("hf_hotstart")]
    assert (found.minutes, found.expected_minutes) == ({0: 30.0, 2: 30.0}, 45.0)


def test_the_return_at_the_spawn_is_that_of_each_run():
    sheet = Sheet().add("hf_scratch", rewards=(-80.0,))
    sheet.add(rewards=(-80.0,), fleet_minutes=3.0)
    sheet.add(rewards=(-80.0,), fleet_minutes=3.0, first_seed=1, spawn_reward=0.5 * SPAWN)
    assert costs(sheet)[Entry("lf_baseline")].minutes == {0: 3.0}


def test_a_cost_that_no_row_tells_is_nothing():
    tables = Sheet().add("hf_scratch", rewards=(-50.0,), fleet_minutes=100.0).tables()
    untimed = tables.results.loc[tables.results["metric"] != "train_seconds"]
    found = costs_to_target(dataclasses.replace(tables, results=untimed))[CELL]
    entry = found[Entry("hf_scratch")]
    assert (entry.expected_minutes, entry.expected_seconds) == (100.0, 0.0)


def test_runs_without_a_return_at_the_spawn_have_no_cost_to_target():
    tables = Sheet().add("hf_scratch").add().tables()
    old = tables.results.loc[tables.results["metric"] != "spawn_reward"]
    assert costs_to_target(dataclasses.replace(tables, results=old)) == {}


def test_what_diverged_without_a_return_is_paid_for_alike():
    sheet = Sheet().add("hf_scratch", fleet_minutes=100.0)
    sheet.add("hf_hotstart", fleet_minutes=30.0)
    sheet.add(
        "hf_hotstart", rewards=(math.nan,), fleet_minutes=30.0, first_seed=1, status="diverged"
    )
    found = costs(sheet)[Entry("hf_hotstart")]
    assert found.expected_minutes == 60.0


def test_training_in_high_fidelity_is_billed_up_to_the_epoch_that_gets_there():
    sheet = Sheet().add("hf_scratch", fleet_minutes=100.0)
    n, half = 4 * SMOOTHING, 2 * SMOOTHING
    curve = np.where(np.arange(n) < half, -500.0, -50.0 + TAKEOFF)
    found = costs(sheet, [("run000", curve)])[Entry("hf_scratch")]
    # The window must lie past the jump but for what the tolerance forgives (none: 45 a step).
    assert found.minutes[0] == pytest.approx(100.0 * (half + SMOOTHING) / n)


def test_calibration_flights_are_billed_in_full_whatever_the_curve_says():
    sheet = Sheet().add("hf_scratch", fleet_minutes=100.0).add("hybrid", fleet_minutes=40.0)
    tables = sheet.tables()
    results = tables.results
    results.loc[results["method"] == "hybrid", "calibration_flights"] = 240
    curves = pd.DataFrame(
        {"run": "run001", "epoch": range(40), "reward": -1.0, "smooth_reward": -1.0}
    ).assign(crashes=0.0, grad_norm=1.0)
    found = costs_to_target(Tables(results, curves, tables.trajectories, tables.runs))
    assert found[CELL][Entry("hybrid")].minutes == {0: 40.0}


def test_without_the_reference_there_is_no_target():
    assert costs(Sheet().add("lf_baseline")) == {}
    assert costs(Sheet().add("hf_scratch", status="failed")) == {}
    assert leaderboard_rows(Sheet().add().tables())[0]["reached"] is None
    assert costs_to_target(Sheet().tables()) == {}
