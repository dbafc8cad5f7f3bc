"""Prints the peak memory of a process that diagnoses an hour of flight logged at 500 Hz."""

import json
import resource
import sys
import time
from pathlib import Path

import numpy as np
from flights_for_tests import SIGMA, fly
from scipy.spatial.transform import Rotation

from diagnosis.diagnose import STEPS, diagnose
from diagnosis.logs import DroneLog, FlightLog, VehicleFile, load_flights, write_flights
from simulators.contract import with_effects
from simulators.effects.drag import Drag
from simulators.point_mass import PointMass

MINUTES = 10
"""Duration of one flight."""
RATE = 500
"""Rows per second."""
DRAG = 0.3
"""Drag [1/s] that the simulator lacks."""


def fine(log, name, rng):
    """A log with noisy rows between those that there are, on straight lines; commands are held."""
    t = np.arange(round(log.t[-1] * RATE)) / RATE
    between = lambda x: np.stack([np.interp(t, log.t, column) for column in x.T], axis=1)  # noqa: E731
    pos, vel, turn = rng.normal(size=(3, len(t), 3)) * SIGMA.reshape(3, 1, 3)
    quat = (Rotation.from_quat(between(log.quat)) * Rotation.from_rotvec(turn)).as_quat()
    cmd = log.cmd[np.searchsorted(log.t, t + 1e-9) - 1]
    drone = DroneLog(t, between(log.pos) + pos, between(log.vel) + vel, quat, cmd=cmd)
    return FlightLog(name, (drone,))


def peak():
    """Peak memory of this process [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def write(folder):
    """Six flights of ten minutes, with more drag than the simulator has."""
    reality = with_effects(PointMass(dt=STEPS["point_mass"]), [Drag(c=DRAG)])
    logs = fly(reality, n_flights=6, seconds=60.0 * MINUTES, noise=0.0)
    rng = np.random.default_rng(0)
    vehicle = VehicleFile("hour", "cf21B_500", 0.0434)
    write_flights(folder, vehicle, [fine(log.drones[0], log.name, rng) for log in logs])


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
