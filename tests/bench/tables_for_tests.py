"""Small tables written by hand."""

import json

from bench.tables import UNITS, Tables, table

DEFAULTS = {
    "crashes": 1.0,
    "position_error": 0.1,
    "fleet_minutes": 0.0,
    "calibration_crashes": 0.0,
    "training_crashes": 0.0,
    "training_crash_step_rate": 0.0,
    "lf_collisions": 7.0,
    "epochs": 400.0,
    "train_seconds": 90.0,
    "training_reward": -40.0,
    "lf_position_error": 0.1,
}
"""Metrics of a run that a test does not care about."""


class Sheet:
    """Collects runs and makes tables of them."""

    def __init__(self):
        self.results, self.runs, self.curves, self.trajectories = [], [], [], []

    def add(
        self,
        method="lf_baseline",
        residual="",
        *,
        variant="",
        task="spread",
        team_size=3,
        rewards=(-50.0,),
        status="ok",
        cause="",
        first_seed=0,
        drawn=False,
        flights=0,
        **metrics,
    ):
        """Adds one run per reward; `status` is that of all of them."""
        for seed, reward in enumerate(rewards, first_seed):
            identity = {
                "run": f"run{len(self.runs):03d}",
                "method": method,
                "residual": residual,
                "variant": variant,
                "task": task,
                "team_size": team_size,
                "seed": seed,
            }
            texts = {"settings": json.dumps({"seed": seed}), "versions": '{"jax": "0.10.1"}'}
            self.runs.append({**identity, "status": status, "cause": cause, **texts})
            if status != "failed":
                world = {"simulator": "crazyflow", "trained_effects": "", "deployed_effects": ""}
                shared = {**identity, **world, "calibration_flights": flights, "status": status}
                for metric, value in (DEFAULTS | metrics | {"reward": reward}).items():
                    unit = UNITS.get(metric, "")
                    self.results.append({**shared, "metric": metric, "value": value, "unit": unit})
            if drawn:
                self._draw(identity["run"], team_size)
        return self

    def tables(self):
        return Tables(
            table("results", self.results),
            table("curves", self.curves),
            table("trajectories", self.trajectories),
            table("runs", self.runs),
        )

    def _draw(self, run, team_size):
        for epoch in range(30):
            row = {"epoch": epoch, "reward": -100.0 / (1 + epoch), "smooth_reward": -1.0}
            self.curves.append({"run": run, **row, "crashes": 0.0, "grad_norm": 1.0})
        for drone in range(team_size):
            for i in range(20):
                pos = {"pos_x": float(drone), "pos_y": 0.1 * i, "pos_z": 1.0}
                self.trajectories.append({"run": run, "drone": drone, "t": 0.1 * i, **pos})


def typical():
    """Two cells; ties, a lost run of each kind, a budget run, a variant and a hostile name."""
    sheet = Sheet()
    sheet.add("lf_baseline", rewards=(-60.0, -61.0, -63.5), drawn=True)
    sheet.add("hf_hotstart", rewards=(-50.0, -51.0, -52.5), fleet_minutes=80.0, drawn=True)
    sheet.add("hybrid", "mlp", rewards=(-50.5, -50.9, -53.1), fleet_minutes=40.0, drawn=True)
    sheet.add("hybrid", "mlp", variant="observe_attitude=true", rewards=(-51.0, -55.0, -54.0))
    sheet.add("hf_scratch", rewards=(-70.0, -71.0), training_crashes=5000.0, train_seconds=5000.0)
    sheet.add("hf_scratch", rewards=(-9.0,), status="failed", cause="out of memory", first_seed=2)
    sheet.add("hybrid", "affine", rewards=(-80.0,), first_seed=0)
    sheet.add("hybrid", "affine", rewards=(-9999.0,), status="diverged", first_seed=1)
    sheet.add("lf_baseline", task="circle", team_size=12, rewards=(-200.0,), drawn=True)
    sheet.add("<script>alert(1)</script>|x", task="circle", team_size=12, rewards=(-150.0,))
    sheet.add("hf_scratch", task="circle", team_size=12, rewards=(-140.0,), status="budget")
    return sheet.tables()


def empty():
    """Tables with columns and no rows."""
    return Sheet().tables()
