"""Heights that do not count from the floor: what is said of them, and flights that are raised."""

import dataclasses

from diagnosis.interface.fault import Evidence, InterfaceFault
from diagnosis.interface.mended import each_log
from diagnosis.logs.flights import FlightSet
from simulators.vehicle import VEHICLES

LOWEST = -0.05
"""Lowest height above the simulator's floor [m]: below the noise of indoor positions (millimetres)
and a marker's distance from the centre (centimetres); a choice."""


def lowest(flights: FlightSet) -> float:
    """Lowest height of all flights [m]."""
    return min(float(log.pos[:, 2].min()) for one in flights.flights for log in one.drones)


def lifted(flights: FlightSet) -> FlightSet:
    """The flights, raised until none is below the floor of the simulator, which lies at 0.

    Simulated from below it, a drone would stand on that floor.
    """
    low = lowest(flights)
    if low >= LOWEST:
        return flights
    return each_log(flights, lambda log: dataclasses.replace(log, pos=log.pos - [0.0, 0.0, low]))


def below_floor(flights: FlightSet) -> InterfaceFault | None:
    """Heights below the floor of the airframe's nominal simulator."""
    low = lowest(flights)
    if low >= LOWEST or flights.vehicle.spec.name not in VEHICLES:
        return None
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
