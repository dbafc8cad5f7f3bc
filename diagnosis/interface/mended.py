"""Flights without the faults of their interface that can be taken out before physics."""

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np

from diagnosis.interface.fault import InterfaceFault
from diagnosis.logs.flights import DroneLog, FlightSet


def mended(flights: FlightSet, faults: Sequence[InterfaceFault]) -> FlightSet:
    """The flights with their path turned back into the frame that the reference's has.

    Left in, the turn would be taken for forces across the flight.
    """
    turns = [f for f in faults if f.part == "frame of the path since the reference"]
    if not turns:
        return flights
    angle = math.radians(turns[0].evidence[0].value)
    c, s = math.cos(angle), math.sin(angle)
    back = np.asarray([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])

    def turned(log: DroneLog) -> DroneLog:
        return dataclasses.replace(log, pos=log.pos @ back.T, vel=log.vel @ back.T)

    return each_log(flights, turned)


def each_log(flights: FlightSet, change: Callable[[DroneLog], DroneLog]) -> FlightSet:
    """The flights with every log changed."""
    return dataclasses.replace(
        flights,
        flights=tuple(
            dataclasses.replace(flight, drones=tuple(change(log) for log in flight.drones))
            for flight in flights.flights
        ),
    )
