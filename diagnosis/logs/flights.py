"""Flight logs: read, checked and written, in version 1 of the format.

    FLIGHTS/vehicle.toml              name, drone (airframe), mass [kg] that the operator believes
    FLIGHTS/flights/NAME.parquet      or NAME.csv, one file a flight; columns:
    `diagnosis.logs.columns`

Files that cannot be used are left out with one line each that says why; the others are used.
"""

import dataclasses
import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float64

from diagnosis.logs.airframes import AIRFRAMES, Airframe, as_toml
from diagnosis.logs.columns import GROUPS, LeftOut, LogError
from diagnosis.logs.folder import check_header, find_flights, reason_for
from diagnosis.logs.table_files import Columns, read_columns
from diagnosis.logs.units import cells
from diagnosis.logs.validation import split_drones
from diagnosis.logs.vehicle_file import VehicleText, find_vehicle
from simulators.vehicle import VehicleSpec


@dataclasses.dataclass(frozen=True)
class DroneLog:
    """What one drone logged. World frame has z up, body frame x forward, y left, z up."""

    t: Float64[np.ndarray, " rows"]
    """Time, increasing, with gaps [s]."""
    pos: Float64[np.ndarray, "rows 3"]
    """Position, world [m]."""
    vel: Float64[np.ndarray, "rows 3"]
    """Velocity, world [m/s]."""
    quat: Float64[np.ndarray, "rows 4"]
    """Attitude, body to world, scalar last, unit norm, without jumps of sign [-]."""
    ang_vel: Float64[np.ndarray, "rows 3"] | None = None
    """Angular velocity, body [rad/s]."""
    acc: Float64[np.ndarray, "rows 3"] | None = None
    """Specific force, body [m/s^2]."""
    cmd: Float64[np.ndarray, "rows 4"] | None = None
    """Commanded roll, pitch, yaw [rad] and thrust [N], held until the next row."""
    thrust: Float64[np.ndarray, " rows"] | None = None
    """Commanded thrust [N] where no commanded angles are logged beside it."""
    rotor_vel: Float64[np.ndarray, "rows 4"] | None = None
    """Rotor speeds [rad/s]."""
    pwm: Float64[np.ndarray, "rows 4"] | None = None
    """Motor duty commands, 0 to 1 [-]."""
    battery: Float64[np.ndarray, " rows"] | None = None
    """Battery voltage; of one cell where a loaded log has several in series [V]."""
    interpolated: Bool[np.ndarray, " rows"] | None = None
    """Rows whose position and velocity lie between measurements; they are compared with nothing."""


@dataclasses.dataclass(frozen=True)
class FlightLog:
    """One flight."""

    name: str
    """The file's name without its ending."""
    drones: tuple[DroneLog, ...]
    """Every drone of the flight, by rising number."""

    @property
    def seconds(self) -> float:
        """Time from the first row of any drone to the last [s], gaps included."""
        return float(max(log.t[-1] for log in self.drones) - min(log.t[0] for log in self.drones))


def stretches(
    t: Float64[np.ndarray, " rows"], holds: Bool[np.ndarray, " rows"]
) -> list[tuple[float, float]]:
    """Begin and end [s] of every run of rows in which something holds.

    A run ends at the first row in which it does not, or at the last row of all.
    """
    edges = np.flatnonzero(np.diff(np.concatenate([[0], holds.astype(int), [0]])))
    pairs = edges.reshape(-1, 2)
    return [(float(t[a]), float(t[min(b, len(t) - 1)])) for a, b in pairs]


@dataclasses.dataclass(frozen=True)
class VehicleFile:
    """What the operator says about the vehicle."""

    name: str
    """Free text."""
    drone: str
    """Name of the airframe, one of `airframes.AIRFRAMES` or, with `airframe`, any other."""
    mass: float
    """Mass that the operator believes [kg]."""
    airframe: Airframe | None = None
    """Numbers of its data sheet, where no file of ours has them."""

    @property
    def spec(self) -> VehicleSpec:
        """The airframe at its own mass; one from a data sheet has the believed one."""
        if self.airframe is not None:
            return self.airframe.spec(self.drone, self.mass)
        return AIRFRAMES[self.drone]


@dataclasses.dataclass(frozen=True)
class FlightSet:
    """Flights of one vehicle."""

    path: Path
    """The folder."""
    vehicle: VehicleFile
    """Its vehicle.toml."""
    flights: tuple[FlightLog, ...]
    """Usable flights by name; at least one."""
    left_out: tuple[LeftOut, ...]
    """Files that are not among them."""

    def each(self, change: Callable[[DroneLog], DroneLog]) -> "FlightSet":
        """The flights with every drone's log changed."""
        flights = (
            dataclasses.replace(flight, drones=tuple(map(change, flight.drones)))
            for flight in self.flights
        )
        return dataclasses.replace(self, flights=tuple(flights))


def load_flights(path: Path) -> FlightSet:
    """All usable flights of a folder, and why each other file was left out.

    Raises:
        LogError: There is no such folder, its vehicle.toml is missing or wrong, or no flight is
            usable. The message has one line for each thing that is wrong.
    """
    path = Path(path)
    said, files = find_flights(path)
    vehicle = _vehicle(said)
    flights: dict[str, FlightLog] = {}
    left_out = []
    for file in files:
        try:
            if file.stem in flights:
                raise LogError(f"another file of this folder is called {file.stem}, too.")
            check_header(file)
            drones = split_drones(read_columns(file), vehicle.mass, vehicle.spec)
            flight = FlightLog(file.stem, tuple(map(_drone_log, drones)))
            for other in flights.values():
                if _same(flight, other):  # it would count as a second witness
                    raise LogError(
                        f"this is the flight {other.name} again: all positions are equal."
                    )
            flights[file.stem] = flight
        except LogError as error:
            left_out.append(LeftOut(file.name, reason_for(file, error)))
    if not flights:
        raise LogError("\n".join(f"{path}/{left.reason}" for left in left_out))
    return _of_one_cell(FlightSet(path, vehicle, tuple(flights.values()), tuple(left_out)))


def write_flights(
    path: Path,
    vehicle: VehicleFile,
    flights: Sequence[FlightLog],
) -> None:
    """A folder of flights, written so that `load_flights` reads them as they are.

    Args:
        path: The folder; made if it is not there.
        vehicle: What vehicle.toml says.
        flights: What flew; all drones of a flight log the same columns.

    Raises:
        ValueError: A name names no file, or drones of one flight log different columns.
        FileExistsError: There are flights in the folder.
    """
    names = [flight.name for flight in flights]
    for name in names:
        if not re.fullmatch(r"\w[\w.-]*", name) or names.count(name) > 1:
            raise ValueError(
                f"A flight's name must be made of letters, digits, '_', '-' and '.', and be there "
                f"once, because it names a file, got '{name}'."
            )
    tables = [_table(flight) for flight in flights]
    folder = Path(path) / "flights"
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()):
        raise FileExistsError(f"{folder} must be empty, because what is there would mix with this.")
    text = json.dumps(vehicle.name, ensure_ascii=False).replace("\x7f", "\\u007f")
    (Path(path) / "vehicle.toml").write_text(
        f'name = {text}\ndrone = "{vehicle.drone}"\nmass = {float(vehicle.mass)!r}\n'
        + (as_toml(vehicle.airframe) if vehicle.airframe is not None else ""),
        encoding="utf-8",
    )
    for name, table in zip(names, tables, strict=True):
        table.to_parquet(folder / f"{name}.parquet", index=False)


def _same(one: FlightLog, other: FlightLog) -> bool:
    """Whether two logs are of one flight: no two flights have the same positions in all rows."""
    return len(one.drones) == len(other.drones) and all(
        np.array_equal(a.pos, b.pos) for a, b in zip(one.drones, other.drones, strict=True)
    )


def check_comparable(flights: FlightSet, reference: FlightSet) -> None:
    """Refuses flights of two vehicles, and a flight that is in both sets.

    The believed mass may differ: a vehicle may be weighed anew.

    Raises:
        LogError: They are of two vehicles, or share a flight.
    """
    here, there = (
        {"drone": x.vehicle.drone, **(vars(x.vehicle.airframe) if x.vehicle.airframe else {})}
        for x in (flights, reference)
    )
    for name in here | there:
        if here.get(name) != there.get(name):
            raise LogError(
                f"{flights.path}/vehicle.toml: {name} is {_given(here, name)}, but "
                f"{_given(there, name)} in the vehicle.toml of the reference. Both sets of flights "
                "must be of one vehicle."
            )
    for flight in flights.flights:
        for other in reference.flights:
            if _same(flight, other):
                raise LogError(
                    f"{flights.path}: the flight {flight.name} has the positions of the flight "
                    f"{other.name} of the reference. Leave it in one of the two folders."
                )


def _given(said: Mapping[str, object], name: str) -> str:
    value = said.get(name)
    return "not given" if value is None else str(value)


def _of_one_cell(flights: FlightSet) -> FlightSet:
    """The flights with the voltage of one cell, which what follows it is made for."""
    logs = [drone for flight in flights.flights for drone in flight.drones]
    volts = [float(log.battery.max()) for log in logs if log.battery is not None]
    n_cells = cells(max(volts, default=0.0))

    def of_one(log: DroneLog) -> DroneLog:
        battery = None if log.battery is None else log.battery / n_cells
        return dataclasses.replace(log, battery=battery)

    return flights if n_cells == 1 else flights.each(of_one)


def _drone_log(columns: Columns) -> DroneLog:
    """The log that one drone's columns make."""
    groups = {
        field: np.stack([columns[name] for name in names], axis=1)
        for field, names in GROUPS.items()
        if names[0] in columns
    }
    between = columns.get("interpolated")
    return DroneLog(
        t=columns["t"],
        battery=columns.get("battery"),
        interpolated=None if between is None else between != 0.0,
        thrust=None if "cmd" in groups else columns.get("cmd_thrust"),
        **groups,
    )


def _table(flight: FlightLog) -> pd.DataFrame:
    """The rows of a flight, drone after drone; `drone` is a column where there are several."""
    tables = []
    for number, log in enumerate(flight.drones):
        columns = {"t": log.t}
        if len(flight.drones) > 1:
            columns["drone"] = np.full(len(log.t), number)
        for field, names in GROUPS.items():
            values = getattr(log, field)
            if values is not None:
                columns.update(zip(names, values.T, strict=True))
        if log.thrust is not None:
            columns["cmd_thrust"] = log.thrust
        if log.battery is not None:
            columns["battery"] = log.battery
        if log.interpolated is not None:
            columns["interpolated"] = log.interpolated.astype(int)
        tables.append(pd.DataFrame(columns))
    if any(set(table) != set(tables[0]) for table in tables):
        raise ValueError(f"All drones of flight '{flight.name}' must log the same columns.")
    return pd.concat(tables, ignore_index=True)


def read_vehicle(path: Path) -> VehicleFile:
    """What the vehicle.toml in a folder says.

    Raises:
        LogError: It is not there, or wrong; one line for each thing.
    """
    return _vehicle(find_vehicle(path))


def _vehicle(said: VehicleText) -> VehicleFile:
    airframe = None if said.airframe is None else Airframe(**said.airframe)
    return VehicleFile(said.name, said.drone, said.mass, airframe)
