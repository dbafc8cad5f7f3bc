"""Small tables written by hand."""

import json

from bench.store.tables import UNITS, Tables, table

SPAWN_SETTLED, SPAWN = -900.0, -1120.0
"""Settled and whole return of a team that stays at its spawn."""
TAKEOFF = -20.0
"""Return of every take-off: a whole return is that much below the settled one."""
DEFAULTS = {
    "takeoff_reward": TAKEOFF,
    "settling_time": 1.5,
    "spawn_reward": SPAWN,
    "spawn_settled_reward": SPAWN_SETTLED,
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
ORIGIN = {
    "committed": "2026-01-01T00:00:00+00:00",
    "commit": "0123abcd",
    "dirty": False,
    "program": "fedcba98",
    "machine": "a processor",
    "device": "cpu cpu",
}
"""Where every run comes from."""


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
        """Adds one run per reward, which is the settled one; `status` is that of all of them."""
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
            origin = {"key": f"key of {identity['run']}", **ORIGIN}
            self.runs.append({**identity, "status": status, "cause": cause, **texts, **origin})
            if status != "failed":
                world = {"simulator": "crazyflow", "trained_effects": "", "deployed_effects": ""}
                shared = {**identity, **world, "calibration_flights": flights, "status": status}
                rewarded = {"settled_reward": reward, "reward": reward + TAKEOFF}
                for metric, value in (DEFAULTS | rewarded | metrics).items():
                    unit = UNITS.get(metric, "")
                    self.results.append({**shared, "metric": metric, "value": value, "unit": unit})
            if drawn:
                self._draw(identity["run"], team_size)
        return self

    def add_upper(self, reward=-40.0, *, task="spread", team_size=3, **changes):
        """Adds one run of the method that a score of 1 means, with this settled reward."""
        return self.add(
            "upper_reference", task=task, team_size=team_size, rewards=(reward,), **changes
        )

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
    """Two cells: ties, a failed and a diverged run, a budget run, a variant and a hostile name.

    The upper reference has two seeds and competes with nobody all the same.
    """
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
    sheet.add_upper(-45.0).add_upper(-46.0, first_seed=1)
    return sheet.tables()


def empty():
    """Tables with columns and no rows."""
    return Sheet().tables()
