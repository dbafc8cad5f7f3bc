"""What every diagnosis records, however it was made: its flights, its settings, its program."""

import hashlib
import math
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import numpy as np

import diagnosis
import simulators
from diagnosis.decide.prepared import Question
from diagnosis.logs.flights import FlightLog, FlightSet
from diagnosis.logs.inputs import Inputs
from diagnosis.program import sources_digest, version
from diagnosis.replay.library import Slot, with_aliases
from diagnosis.result import Program, Settings
from diagnosis.result_parts import Flights, FlightUsed, Limit

MOST_CANDIDATES = 8
"""Sets of effects that are listed."""


def flights_used(flights: FlightSet, inputs: Inputs, use: Callable[[int], Any]) -> Flights:
    """The flights as they were read, with what each was used for."""
    read = {log.name: log for log in flights.flights}
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
        left_out=(*flights.left_out, *inputs.left_out),
    )


def limits_of(slots: Sequence[Slot], seen: Iterable[tuple[int, float]]) -> tuple[Limit, ...]:
    """The smallest visible size of parameters, given by their places in the vector."""
    return tuple(
        Limit(
            effect=slots[i].effect,
            parameter=slots[i].parameter,
            unit=slots[i].unit,
            smallest=float(size) if math.isfinite(size) else None,
        )
        for i, size in seen
    )


def settings_of(question: Question) -> Settings:
    """What was asked, and what decided."""
    return Settings(
        simulator=question.simulator,
        exclude=tuple(question.exclude),
        withheld=tuple(sorted(with_aliases(question.exclude))),
        decision=question.decision.values(),
    )


def this_program() -> Program:
    """The program that answers."""
    return Program(version=version(), digest=sources_digest(diagnosis, simulators))


def _digest(log: FlightLog) -> str:
    """SHA-256 of a flight's columns."""
    found = hashlib.sha256()
    for i, drone in enumerate(log.drones):
        for name, column in vars(drone).items():
            if column is not None:
                found.update(f"{i} {name} {column.shape}\n".encode())
                found.update(np.ascontiguousarray(column).tobytes())
    return found.hexdigest()
