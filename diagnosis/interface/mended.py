"""Flights without the faults of their interface that can be taken out before physics."""

import dataclasses
import math
from collections.abc import Sequence

import numpy as np

from diagnosis.interface.fault import MOTOR_CLOCK, Evidence, InterfaceFault
from diagnosis.interface.motors import inputs_column
from diagnosis.logs.flights import DroneLog, FlightSet
from simulators.vehicle import VEHICLES

LOWEST = -0.05
"""Lowest height above the simulator's floor [m]: below the noise of indoor positions (millimetres)
and a marker's distance from the centre (centimetres); a choice."""


def mended(flights: FlightSet, faults: Sequence[InterfaceFault]) -> FlightSet:
    """The flights without drift of their motors' clock, and turned back into the reference's frame.

    Left in, a turn would be taken for forces across the flight, a drift for slow motors.
    """
    flights = in_time(flights, faults, MOTOR_CLOCK)
    turns = [f for f in faults if f.part == "frame of the path since the reference"]
    if not turns:
        return flights
    angle = math.radians(turns[0].evidence[0].value)
    c, s = math.cos(angle), math.sin(angle)
    back = np.asarray([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])

    def turned(log: DroneLog) -> DroneLog:
        return dataclasses.replace(log, pos=log.pos @ back.T, vel=log.vel @ back.T)

    return flights.each(turned)


def in_time(flights: FlightSet, faults: Sequence[InterfaceFault], part: str) -> FlightSet:
    """The flights with what the motors are given where a clock without drift would stamp it.

    `part` is the motors' clock of these flights. Rows whose input lies beyond the log are dropped.
    """
    drifts = [f for f in faults if f.part == part]
    if not drifts:
        return flights
    rate = drifts[0].evidence[0].value / 1e3

    def stamped(log: DroneLog) -> DroneLog:
        then = log.t - rate * (log.t - log.t[0])
        kept = (then >= log.t[0]) & (then <= log.t[-1])
        # An input is held until the next row.
        held = np.searchsorted(log.t, then[kept] + 1e-9, side="right") - 1
        moved = inputs_column(log)
        columns = {
            field.name: None if value is None else value[held if field.name == moved else kept]
            for field in dataclasses.fields(log)
            for value in [getattr(log, field.name)]
        }
        return DroneLog(**columns)  # pyright: ignore[reportArgumentType]

    return flights.each(stamped)


def lowest(flights: FlightSet) -> float:
    """Lowest height of all flights [m]."""
    return min(float(log.pos[:, 2].min()) for one in flights.flights for log in one.drones)


def _sunk(flights: FlightSet) -> bool:
    """Whether heights go below the floor of the simulator; a point mass has none."""
    return flights.vehicle.spec.name in VEHICLES and lowest(flights) < LOWEST


def lifted(flights: FlightSet) -> FlightSet:
    """The flights, raised until none is below the floor of the simulator, which lies at 0.

    Simulated from below it, a drone would stand on that floor.
    """
    if not _sunk(flights):
        return flights
    low = lowest(flights)
    return flights.each(lambda log: dataclasses.replace(log, pos=log.pos - [0.0, 0.0, low]))


def below_floor(flights: FlightSet) -> InterfaceFault | None:
    """Heights below the floor of the airframe's nominal simulator."""
    if not _sunk(flights):
        return None
    low = lowest(flights)
    evidence = Evidence(
        quantity="lowest height",
        value=low,
        low=None,
        high=None,
        unit="m",
        allowed=f"{LOWEST:g} and more",
    )
    return InterfaceFault(
        part="height",
        readings=("heights that do not count from the floor",),
        advice=f"Heights go down to {low:.2f} m, and the simulator's floor is at 0: was the origin "
        f"above the floor? All else is said of flights that are raised by {-low:.2f} m.",
        evidence=(evidence,),
    )
