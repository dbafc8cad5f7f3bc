"""Prints the peak memory of a process that diagnoses an hour of flight logged at 500 Hz."""

import json
import resource
import sys
import time
from pathlib import Path

from flights_for_tests import fly

from diagnosis.engine import diagnose
from diagnosis.logs.flights import VehicleFile, load_flights, write_flights
from simulators.contract import replayable_class, with_effects
from simulators.effects.drag import Drag
from simulators.point_mass import PointMass
from simulators.vehicle import CONTROL_DT

MINUTES = 10
"""Duration of one flight."""
RATE = 500
"""Rows per second."""
DRAG = 0.3
"""Drag [1/s] that the simulator lacks."""


def peak():
    """Peak memory of this process [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def write(folder):
    """Six flights of ten minutes, with more drag than the simulator has.

    The vehicle takes the steps of the replay, 5 ms: integrated from row to row, in steps of 2 ms,
    it differs by more than drag, and six flights of a minute show a delay of 0.17 ms.
    """
    reality = with_effects(PointMass(dt=replayable_class("point_mass").replay_dt), [Drag(c=DRAG)])
    rows = round(RATE * CONTROL_DT)
    logs = fly(reality, n_flights=6, seconds=60.0 * MINUTES, rows=rows)
    write_flights(folder, VehicleFile("hour", "cf21B_500", 0.0434), logs)


def main(folder):
    """The diagnosis of all six flights."""
    flights = load_flights(folder)
    found = {"loaded_mb": peak()}
    begun = time.perf_counter()
    content = diagnose(flights, simulator="point_mass").to_json()
    found |= {"diagnosed_mb": peak(), "seconds": time.perf_counter() - begun}
    found |= {"verdict": content["verdict"], "effects": [e["name"] for e in content["effects"]]}
    sys.stdout.write(json.dumps(found))


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    if not (folder / "flights").exists():
        write(folder)
    main(folder)
