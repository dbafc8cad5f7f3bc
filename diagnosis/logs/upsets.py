"""Flights that end in an upset: a drone upside down that was not told to turn over.

From then on it tumbles or lies on the ground, which says nothing of the flight before.
"""

import dataclasses

import numpy as np

from diagnosis.logs.flights import DroneLog, FlightLog
from diagnosis.logs.validation import MIN_SECONDS

LASTS = 0.05
"""Shortest upset [s]; a shorter one is a glitch of the log. A drone that turns at 35 rad/s, about
as fast as a small quadrotor can, is upside down for 0.09 s."""
BEFORE = 1.0
"""Time before an upset that is left out with it, because control is lost sooner [s]."""


def before_upset(flight: FlightLog) -> tuple[FlightLog | None, str]:
    """The flight until it loses control, and what is left out and why.

    The flight itself and an empty text without an upset; no flight if too little is left.
    """
    begin = min(drone.t[0] for drone in flight.drones)
    upset = min(map(_first_upset, flight.drones))
    if not np.isfinite(upset):
        return flight, ""
    end = upset - BEFORE
    why = f"the drone turned over {upset - begin:.1f} s after its start without a command to"
    if end - begin < MIN_SECONDS:
        return None, f"flights/{flight.name}: {why}"
    left_out = f"flights/{flight.name}: all from {end - begin:.1f} s on, because {why}"
    drones = (_until(drone, end) for drone in flight.drones)
    kept = tuple(drone for drone in drones if drone.t[-1] - drone.t[0] >= MIN_SECONDS)
    return dataclasses.replace(flight, drones=kept), left_out


def _first_upset(drone: DroneLog) -> float:
    """When the drone is upside down for the first time [s]; infinite if never."""
    if drone.cmd is None:
        return np.inf
    x, y, _, _ = drone.quat.T
    upright = 1.0 - 2.0 * (x**2 + y**2)
    told = np.cos(drone.cmd[:, 0]) * np.cos(drone.cmd[:, 1])
    over = (upright < 0.0) & (told > 0.0)
    edges = np.flatnonzero(np.diff(np.concatenate([[0], over.astype(int), [0]])))
    ends = np.append(drone.t, drone.t[-1])
    lasting = [drone.t[a] for a, b in edges.reshape(-1, 2) if ends[b] - drone.t[a] >= LASTS]
    return float(lasting[0]) if lasting else np.inf


def _until(drone: DroneLog, end: float) -> DroneLog:
    """The rows of a log before `end` [s]."""
    rows = drone.t < end
    columns = {name: column[rows] for name, column in vars(drone).items() if column is not None}
    return dataclasses.replace(drone, **columns)
