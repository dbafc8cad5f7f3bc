"""Rebuilding the report of 1,000 runs from their tables."""

import numpy as np
import pandas as pd

from bench.report.page import write_report
from bench.store.tables import UNITS, Tables, table

METHODS = [("lf_baseline", ""), ("hf_scratch", ""), ("hf_hotstart", ""), ("grey_box", "")]
METHODS += [("hybrid", residual) for residual in ("affine", "sindy", "mlp")] + [("mine", "")]
EPOCHS, SAMPLES = 300, 100


def thousand_runs():
    """8 methods, 5 team sizes, 5 tasks, 5 seeds, with curves and flights of usual length."""
    rng = np.random.default_rng(0)
    results, runs, curves, flights = [], [], [], []
    cells = [(m, r, t, n, s) for m, r in METHODS for t in "abcde" for n in (3, 5, 7, 9, 12)
             for s in range(5)]  # fmt: skip
    for method, residual, task, n, seed in cells:
        identity = {
            "run": f"{method}{residual}-{task}-n{n}-s{seed}",
            "method": method,
            "residual": residual,
            "variant": "",
            "task": task,
            "team_size": n,
            "seed": seed,
        }
        runs.append({**identity, "status": "ok", "cause": "", "settings": "{}", "versions": "{}"})
        world = {"simulator": "crazyflow", "trained_effects": "", "deployed_effects": ""}
        shared = {**identity, **world, "calibration_flights": 0, "status": "ok"}
        results += [
            {**shared, "metric": name, "value": float(rng.normal()), "unit": unit}
            for name, unit in UNITS.items()
        ]
        columns = {name: rng.normal(size=EPOCHS) for name in ("reward", "smooth_reward", "crashes")}
        columns |= {"run": identity["run"], "epoch": np.arange(EPOCHS), "grad_norm": 1.0}
        curves.append(pd.DataFrame(columns))
        where = rng.normal(size=(SAMPLES * n, 3)).cumsum(axis=0) * 0.01
        rows = {"run": identity["run"], "drone": np.tile(np.arange(n), SAMPLES)}
        rows |= {"t": np.repeat(0.1 * np.arange(SAMPLES), n)}
        rows |= {f"pos_{axis}": where[:, i] for i, axis in enumerate("xyz")}
        flights.append(pd.DataFrame(rows))
    frames = {"curves": pd.concat(curves), "trajectories": pd.concat(flights)}
    frames = {name: table(name, frame) for name, frame in frames.items()}
    return Tables(results=table("results", results), runs=table("runs", runs), **frames)


def test_report_of_1000_runs_is_rebuilt(benchmark, tmp_path):
    tables = thousand_runs()
    assert len(tables.runs) == 1000
    path = tmp_path / "report.html"
    benchmark.pedantic(lambda: write_report(tables, path), rounds=1)
    assert path.stat().st_size < 40e6
