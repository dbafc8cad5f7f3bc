"""What is kept: diagnoses, keys and rows, each made by one function."""

import hashlib
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Collection, Mapping
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
from diagnosis.statements import judged_of

HOUSE = Path(__file__).parents[2]
REAL = HOUSE.parent / "shared" / "flights"
"""Real flights, where there are any."""
SETS = ("crazyflie_changed", "crazyflie_plain", "nanobench")
DRAW = 20261123
"""Seed of the cases; no counted draw has it."""
COUNTS = {"single": 5, "pair": 3, "clean": 2, "unknown": 2}
"""Cases of each kind in each reality: 24 in all."""
SEEDS = {"crazyflow": 0, "rotorpy": 1}
USES = ("fit", "held out")
"""What a flight may have been used for; both where it was left out in turn."""

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
    """A diagnosis without what only pictures need, and without which program gave it."""
    beside = load_flights(reference) if reference else None
    found = diagnose(load_flights(flights), reference=beside).to_json()
    return {key: value for key, value in found.items() if key not in ("details", "program")}


def comparable(kept: Any, found: Any) -> Any:
    """What of the answer `found` the kept one can hold: all of it, but of schema 1 what that had.

    Every field of schema 1 is compared. `partly`, which it did not know, was `unexplained` there,
    and an effect that was not the whole verdict had no sizes.
    """
    if not isinstance(kept, dict) or not isinstance(found, dict):
        return found
    if kept.get("schema") == 1 and found.get("schema") == 2:
        return _as_schema_1(found)
    return found | {
        name: comparable(kept[name], found[name]) for name in kept.keys() & found.keys()
    }


def _as_schema_1(found: Mapping[str, Any]) -> dict[str, Any]:
    flights, beside, shrink = found["flights"], found["reference"], found["shrink"]
    whole = found["verdict"] == "effect"
    left_out = list(flights["left_out"])
    for line in beside["left_out"] if beside else ():
        left_out.append(line | {"reason": f"reference, {line['reason']}"})
    used = {name: [f["name"] for f in flights["used"] if name in f["use"]] for name in USES}
    new = ("beyond_noise", "main")
    return {
        "schema": 1,
        "simulator": found["settings"]["simulator"],
        "drone": flights["drone"],
        "flights": {
            "n": len(flights["used"]),
            "seconds": sum(flight["seconds"] for flight in flights["used"]),
            "input": flights["driven_by"],
            "fit": used["fit"],
            "held_out": used["held out"],
            "left_out": left_out,
        },
        "where": [_without(line, new) for line in found["where"]],
        "verdict": judged_of(found["verdict"]),
        "unexplained_share": found["remainder"]["share"],
        "effects": [_effect(effect) for effect in found["effects"] if whole],
        "candidates": [
            _without(line, ("posterior", "named")) | {"probability": line["posterior"]}
            for line in found["candidates"]
        ],
        "shrink": _without(shrink, ("how",) if shrink["reason"] else ("reason",))
        | {"unit": "m"}
        | {"by_channel": {x["channel"]: _without(x, ("channel",)) for x in shrink["by_channel"]}},
        "next_flight": found["next_flight"],
    }


def _effect(found: Mapping[str, Any]) -> dict[str, Any]:
    sizes = {x["name"]: _without(x, ("name", "at_bound", "use")) for x in found["parameters"]}
    return _without(found, ("blamed",)) | {"parameters": sizes}


def _without(line: Mapping[str, Any], names: Collection[str]) -> dict[str, Any]:
    return {name: value for name, value in line.items() if name not in names}


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
