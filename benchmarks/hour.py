"""Prints the peak memory of a process that loads and replays an hour of flight logged at 500 Hz."""

import json
import resource
import sys
from pathlib import Path

import numpy as np
from flights_for_tests import SIGMA, fly

from diagnosis.diagnose import STEPS, make_likelihood
from diagnosis.library import make_library
from diagnosis.likelihood import KEPT
from diagnosis.logs import DroneLog, FlightLog, VehicleFile, load_flights, write_flights
from diagnosis.replay import make_replay
from simulators.point_mass import PointMass

MINUTES = 10
"""Duration of one flight."""
RATE = 500
"""Rows per second."""
FITS = KEPT + 12
"""Fits, more than there are replays that are kept."""


def fine(log, name):
    """A log with rows between those that there are, on straight lines; commands are held."""
    t = np.arange(round(log.t[-1] * RATE)) / RATE
    between = lambda x: np.stack([np.interp(t, log.t, column) for column in x.T], axis=1)  # noqa: E731
    quat = between(log.quat)
    cmd = log.cmd[np.searchsorted(log.t, t + 1e-9) - 1]
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    return FlightLog(name, (DroneLog(t, between(log.pos), between(log.vel), quat, cmd=cmd),))


def peak():
    """Peak memory of this process [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024.0


def write(folder):
    """Six flights of ten minutes."""
    log = fly(PointMass(), n_flights=1, seconds=60.0 * MINUTES)[0].drones[0]
    write_flights(
        folder, VehicleFile("hour", "cf21B_500", 0.0434), [fine(log, f"f{i}") for i in range(6)]
    )


def main(folder):
    """A diagnosis keeps the last replays, and the normal equations of every fit."""
    replay = make_replay(make_library(PointMass(dt=STEPS["point_mass"])), STEPS["point_mass"])
    small = make_likelihood(replay, fly(PointMass(), n_flights=1, seconds=10.0), SIGMA)
    small.normal(replay.library.neutral)
    found = {"started_mb": peak()}
    flights = load_flights(folder)
    found["loaded_mb"] = peak()
    likelihood = make_likelihood(replay, flights.flights, SIGMA)
    del flights
    found["cut_mb"] = peak()
    shift = np.eye(len(replay.library.slots))[0]
    fits = []
    for i in range(FITS):
        fits.append(likelihood.normal(replay.library.neutral + 1e-3 * i * shift))
        found[f"fits_{i + 1}_mb"] = peak()
    sys.stdout.write(json.dumps(found))


if __name__ == "__main__":
    folder = Path(sys.argv[1])
    if not (folder / "flights").exists():
        write(folder)
    main(folder)
