"""What is kept: diagnoses, keys and rows, each made by one function."""

import hashlib
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

from bench.plan.expansion import expand
from bench.plan.provenance import processor
from bench.plan.suite import load_suite
from bench.store.tables import Tables
from blind.draw.cases import Case, draw_cases, fly_case, make_case, write_flights
from diagnosis.engine import diagnose
from diagnosis.logs.flights import load_flights

HOUSE = Path(__file__).parents[2]
REAL = HOUSE.parent / "shared" / "flights"
"""Real flights, where there are any."""
SETS = ("crazyflie_changed", "crazyflie_plain", "nanobench")
DRAW = 20261123
"""Seed of the cases; no counted draw has it."""
COUNTS = {"single": 5, "pair": 3, "clean": 2, "unknown": 2}
"""Cases of each kind in each reality: 24 in all."""
SEEDS = {"crazyflow": 0, "rotorpy": 1}
CANDIDATES = 3
"""Likeliest sets of effects of a diagnosis that are kept."""

Maker = Callable[[], Mapping[str, Any]]
"""Makes one kept answer, as JSON."""


def makers() -> dict[str, Maker]:
    """Each kept answer by its name; real sets only where they lie."""
    found: dict[str, Maker] = {"keys": _keys, "rows": _rows}
    for reality, seed in SEEDS.items():
        for i, case in enumerate(draw_cases(COUNTS, reality, DRAW + seed)):
            found[f"{reality}_{i:02d}_{case.kind}"] = lambda case=case: _blind(case)
    for name in SETS:
        if (REAL / name).is_dir():
            found[f"real_{name}"] = lambda name=name: _shown(REAL / name)
    changed = (REAL / "crazyflie_changed", REAL / "crazyflie_plain")
    if all(path.is_dir() for path in changed):
        found["real_changed_beside_plain"] = lambda: _shown(*changed)
    return found


def made(name: str) -> tuple[dict[str, Any], float]:
    """An answer with the processor that made it, and the seconds that it took."""
    begun = time.monotonic()
    answer = json.loads(json.dumps(makers()[name]()))
    return {"processor": processor(), "answer": answer}, time.monotonic() - begun


def _blind(case: Case) -> dict[str, Any]:
    """The diagnosis of a case, with what was withheld beside it for the reader."""
    with tempfile.TemporaryDirectory() as temporary:
        flights, reference = Path(temporary) / "flights", Path(temporary) / "reference"
        write_flights(flights, [one.logged for one in fly_case(case)])
        if case.reality == "crazyflow":
            found = _shown(flights)
        else:
            rng = np.random.default_rng(DRAW)
            plain = make_case("clean", (), rng, reality=case.reality)
            while plain.drones > 1:
                plain = make_case("clean", (), rng, reality=case.reality)
            write_flights(reference, [one.logged for one in fly_case(plain)])
            found = _shown(flights, reference)
    return {"withheld": [effect.name for effect in case.effects], "diagnosis": found}


def _shown(flights: Path, reference: Path | None = None) -> dict[str, Any]:
    """What a diagnosis answers: verdict, sizes, probabilities, shares and names.

    Not kept, so that a change of it goes unseen here: noise floors and regimes, drift by channel,
    candidates after the first `CANDIDATES`, why flights were left out, settings and details.
    """
    beside = load_flights(reference) if reference else None
    found = diagnose(load_flights(flights), reference=beside).to_json()
    likeliest = found["candidates"][:CANDIDATES]
    return {
        **{name: found[name] for name in ("verdict", "probability", "effects", "next_flight")},
        "left": found["remainder"]["share"],
        "where": {line["channel"]: line["share"] for line in found["where"]},
        "candidates": {" + ".join(c["effects"]): c["posterior"] for c in likeliest},
        "drift_falls_by": found["shrink"]["percent"],
        "interface": [fault["part"] for fault in found["interface"]],
        "flights": [flight["name"] for flight in found["flights"]["used"]],
    }


def _keys() -> dict[str, Any]:
    """The keys of all runs of the suites, hashed a suite; of the quick one each."""
    names = sorted(path.stem for path in (HOUSE / "bench" / "plan" / "suites").glob("*.toml"))
    found: dict[str, Any] = {}
    for name in names:
        keys = {run.name: run.key for run in expand(load_suite(name)).runs}
        text = "\n".join(f"{run} {key}" for run, key in sorted(keys.items()))
        found[name] = keys if name == "quick" else hashlib.sha256(text.encode()).hexdigest()
    return found


def _rows() -> dict[str, Any]:
    """What short trainings of every configuration are worth, by run and metric.

    Twenty epochs are too few for rounding to grow, so they are the same on processors alike.
    """
    with tempfile.TemporaryDirectory() as temporary:
        suite = Path(__file__).with_name("rows.toml")
        command = [sys.executable, "-m", "bench", "run", str(suite), "--out", temporary]
        subprocess.run(command, check=True, stdout=subprocess.DEVNULL)
        rows = Tables.load(Path(temporary)).results
        kept = rows[rows["metric"] != "train_seconds"]
        return {f"{r.run} {r.metric}": r.value for r in kept.itertuples()}
