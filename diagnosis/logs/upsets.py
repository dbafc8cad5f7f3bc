"""Flights that end in an upset: a drone upside down that was not told to turn over.

After the upset the drone tumbles or lies on the ground. Neither says anything of the flight before.
"""

import dataclasses

import numpy as np

from diagnosis.logs.flights import DroneLog, FlightLog, stretches
from diagnosis.logs.validation import MIN_SECONDS

LASTS = 0.05
"""Shortest upset [s]. A shorter one is taken for a glitch of the log: a drone that turns at 35
rad/s, a guess at the fastest, is upside down for 0.09 s."""
BEFORE = 1.0
"""Time before an upset that is left out with it [s]. The drone loses control before it turns over:
in flights of crazyflow with rotors four times as slow, a lag of 3.8 instead of 4 left a misfit of
98 with 0.5 s, 8.9 with 1 s and 4.6 with 1.5 s."""


def before_upset(flight: FlightLog) -> tuple[FlightLog | None, str]:
    """The flight up to `BEFORE` its first upset, and a line that says what is left out and why.

    Without an upset, the whole flight and an empty line. If too little is left, no flight.
    """
    begin = min(drone.t[0] for drone in flight.drones)
    upset = min(map(_first_upset, flight.drones))
    if not np.isfinite(upset):
        return flight, ""
    end = upset - BEFORE
    why = f"the drone turned over {upset - begin:.1f} s after its start without a command to"
    long = [drone for drone in flight.drones if end - drone.t[0] > MIN_SECONDS]
    if not long:
        return None, f"flights/{flight.name}: {why}"
    left_out = f"flights/{flight.name}: all from {end - begin:.1f} s on, because {why}"
    drones = tuple(_until(drone, end) for drone in long)
    return dataclasses.replace(flight, drones=drones), left_out


def _first_upset(drone: DroneLog) -> float:
    """When the drone is upside down for the first time [s]; infinite if never."""
    if drone.cmd is None:
        return np.inf
    x, y, _, _ = drone.quat.T
    upright = 1.0 - 2.0 * (x**2 + y**2)
    told = np.cos(drone.cmd[:, 0]) * np.cos(drone.cmd[:, 1])
    over = stretches(drone.t, (upright < 0.0) & (told > 0.0))
    return min((a for a, b in over if b - a >= LASTS), default=np.inf)


def _until(drone: DroneLog, end: float) -> DroneLog:
    """The rows of a log before `end` [s]."""
    rows = drone.t < end
    columns = {name: column[rows] for name, column in vars(drone).items() if column is not None}
    return dataclasses.replace(drone, **columns)
