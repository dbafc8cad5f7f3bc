"""Cases made from logs of anybody's flights: a half with a fault in it, beside the other half.

Every case splits the flights anew at random. A part of the cases is undisturbed: both halves stay
as they were flown, and whatever a diagnosis finds there is a false alarm.
"""

import dataclasses
import hashlib
import secrets
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from blind.draw.catalogue import Parameters
from blind.draw.faults import ALL, able
from blind.draw.folders import Folders
from diagnosis.logs.flights import FlightSet, VehicleFile, write_flights

FEWEST_FLIGHTS = 4
"""Fewest flights that can be split into halves of which each tells a scatter."""
UNDISTURBED = 0.25
"""Share of the cases without a fault; a choice."""
DRAWS = 20
"""Most times that a fault's numbers are drawn again because the logs cannot hold them; a choice."""
NOTHING = "none"
"""What stands in the place of a fault in an undisturbed case."""
UNNAMED = "flights"
"""Name in the vehicle.toml of every case: the operator's own may say what was changed."""


@dataclasses.dataclass(frozen=True)
class Injected:
    """One case."""

    id: str
    """Random name of its folder."""
    fault: str
    """Name in `faults.ALL`, or `NOTHING`."""
    size: str
    """Name of its size; empty without a fault."""
    parameters: Parameters
    """Its numbers, SI."""
    target: tuple[str, ...]
    """Flights that are diagnosed."""
    reference: tuple[str, ...]
    """The other flights."""

    @classmethod
    def of(cls, label: Mapping[str, Any]) -> "Injected":
        """The case of a label."""
        names = {half: tuple(label[half]) for half in ("target", "reference")}
        return cls(**{**label, **names})

    @property
    def answers(self) -> Mapping[str, Parameters]:
        """Effects that describe the fault, each with its true numbers."""
        return ALL[self.fault].answers(self.parameters) if self.fault != NOTHING else {}


def draw_injected(flights: FlightSet, count: int, entropy: int | None = None) -> list[Injected]:
    """Cases in random order: the undisturbed ones, the others in whole rounds of fault and size.

    Args:
        flights: What was flown.
        count: Number of cases.
        entropy: Seed; from the operating system if None.

    Raises:
        ValueError: There are too few flights or cases.
    """
    n = len(flights.flights)
    if n < FEWEST_FLIGHTS:
        raise ValueError(
            f"`{flights.path}` must hold at least {FEWEST_FLIGHTS} usable flights, two for each "
            f"half, got {n}."
        )
    if count < 2:
        raise ValueError(f"`cases` must be at least 2, one of them undisturbed, got {count}.")
    rng = np.random.default_rng(secrets.randbits(128) if entropy is None else entropy)
    quiet = max(1, round(UNDISTURBED * count))
    pool = [(name, size) for name in able(flights) for size in range(len(ALL[name].sizes))]
    plans: list[tuple[str, int]] = [(NOTHING, 0)] * quiet
    while len(plans) < count:
        plans += [pool[i] for i in rng.permutation(len(pool))]
    order = rng.permutation(count)
    return [_case(flights, plans[i], rng) for i in order]


def _case(flights: FlightSet, plan: tuple[str, int], rng: np.random.Generator) -> Injected:
    name, size = plan
    names = np.asarray([flight.name for flight in flights.flights])
    chosen = rng.permutation(len(names))
    half = len(names) // 2
    fault, target = ALL.get(name), tuple(sorted(names[chosen[:half]].tolist()))
    return Injected(
        id=rng.bytes(8).hex(),
        fault=name,
        size=fault.sizes[size] if fault else "",
        parameters=_drawn(name, size, _some(flights, target), rng) if fault else {},
        target=target,
        reference=tuple(sorted(names[chosen[half:]].tolist())),
    )


def _drawn(name: str, size: int, flights: FlightSet, rng: np.random.Generator) -> Parameters:
    """Numbers of a fault that these logs can hold; others are drawn again.

    Raises:
        ValueError: None of many can be.
    """
    fault, why = ALL[name], ""
    for _ in range(DRAWS):
        parameters = fault.draw(size, rng, 0.0)
        try:
            fault.apply(flights, parameters)
        except ValueError as error:
            why = str(error)
        else:
            return parameters
    raise ValueError(f"`{flights.path}` cannot hold the fault '{name}': {why}")


def write_injected(folders: Folders, flights: FlightSet, cases: Sequence[Injected]) -> None:
    """Writes both halves of every case that is not there whole."""
    for case in cases:
        target = _some(flights, case.target)
        if case.fault != NOTHING:
            target = ALL[case.fault].apply(target, case.parameters)
        for place, part in (
            (folders.references / case.id, _some(flights, case.reference)),
            (folders.cases / case.id, target),
        ):
            if not place.is_dir():
                write_unnamed(place, part)


def write_unnamed(place: Path, flights: FlightSet) -> None:
    """Writes flights without what the operator calls the vehicle, whole or not at all."""
    half_written = place.with_name(f".{place.name}.part-{secrets.token_hex(4)}")
    vehicle = dataclasses.replace(flights.vehicle, name=UNNAMED)
    write_flights(half_written, vehicle, flights.flights)
    half_written.rename(place)


def flights_digest(flights: FlightSet) -> str:
    """SHA-256 of everything that was flown and believed."""
    found = hashlib.sha256(repr(_believed(flights.vehicle)).encode())
    for flight in flights.flights:
        for drone in flight.drones:
            for name, column in vars(drone).items():
                if column is not None:
                    found.update(f"{flight.name} {name} {column.shape}\n".encode())
                    found.update(np.ascontiguousarray(column).tobytes())
    return found.hexdigest()


def _believed(vehicle: VehicleFile) -> tuple:
    own = () if vehicle.airframe is None else (vehicle.airframe,)
    return vehicle.drone, vehicle.mass, *own


def _some(flights: FlightSet, names: Sequence[str]) -> FlightSet:
    chosen = tuple(flight for flight in flights.flights if flight.name in names)
    return dataclasses.replace(flights, flights=chosen)
