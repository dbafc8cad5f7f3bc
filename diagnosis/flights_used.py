"""The flights of a diagnosis as they were read, and what each was used for."""

import hashlib
from collections.abc import Callable
from typing import Any

import numpy as np

from diagnosis.logs.flights import FlightLog, FlightSet
from diagnosis.logs.inputs import Inputs
from diagnosis.result_parts import Flights, FlightUsed, NotUsed


def flights_used(flights: FlightSet, inputs: Inputs, use: Callable[[int], Any]) -> Flights:
    """The flights as they were read, with what each was used for."""
    read = {log.name: log for log in flights.flights}
    left_out = [(x.name, x.reason) for x in flights.left_out] + list(inputs.left_out)
    return Flights(
        name=flights.path.resolve().name or None,
        drone=flights.vehicle.drone,
        mass=flights.vehicle.mass,
        airframe=flights.vehicle.airframe,
        driven_by=inputs.kind,
        used=tuple(
            FlightUsed(name=f.name, seconds=f.seconds, use=use(i), digest=_digest(read[f.name]))
            for i, f in enumerate(inputs.flights)
        ),
        left_out=tuple(NotUsed(name=name, reason=reason) for name, reason in left_out),
    )


def _digest(log: FlightLog) -> str:
    """SHA-256 of a flight's columns."""
    found = hashlib.sha256()
    for i, drone in enumerate(log.drones):
        for name, column in vars(drone).items():
            if column is not None:
                found.update(f"{i} {name} {column.shape}\n".encode())
                found.update(np.ascontiguousarray(column).tobytes())
    return found.hexdigest()
