"""Flight logs: read, checked and written, in version 1 of the format.

    FLIGHTS/vehicle.toml              name, drone (airframe), mass [kg] that the operator believes
    FLIGHTS/flights/NAME.parquet      or NAME.csv, one file a flight; columns:
    `diagnosis.logs.columns`

Files that cannot be used are left out with one line each that says why; the others are used.
"""

import dataclasses
import json
import re
import tomllib
from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import numpy as np
import pandas as pd
from jaxtyping import Bool, Float64

from diagnosis.logs.airframes import AIRFRAMES, Airframe, as_toml, read_airframe
from diagnosis.logs.columns import GROUPS, Columns, LogError, did_you_mean, one_line, read_columns
from diagnosis.logs.validation import split_drones
from simulators.vehicle import VehicleSpec

MASS_FACTOR = 3.0
"""How far the believed mass may be from the airframe's, as a factor; a guess, wider than any
payload, narrower than another unit."""


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
    """Battery voltage [V]."""
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
class LeftOut:
    """A file that cannot be used."""

    name: str
    """The file's name with its ending."""
    reason: str
    """One line: the file, where in it, what is wrong, what is expected."""


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


def load_flights(path: Path) -> FlightSet:
    """All usable flights of a folder, and why each other file was left out.

    Raises:
        LogError: There is no such folder, its vehicle.toml is missing or wrong, or no flight is
            usable. The message has one line for each thing that is wrong.
    """
    path = Path(path)
    if not path.is_dir():
        what = "is a file" if path.exists() else "does not exist"
        raise LogError(f"{path}: {what}; a folder with vehicle.toml and flights/ is expected.")
    vehicle = read_vehicle(path)
    folder = path / "flights"
    if not folder.is_dir():
        raise LogError(f"{folder}: there is no such folder; log files are expected in it.")
    files = sorted(file for file in folder.iterdir() if not file.name.startswith("."))
    if not files:
        raise LogError(f"{folder}: the folder is empty; NAME.parquet or NAME.csv is expected.")
    flights: dict[str, FlightLog] = {}
    left_out = []
    for file in files:
        try:
            if file.stem in flights:
                raise LogError(f"another file of this folder is called {file.stem}, too.")
            flights[file.stem] = _read_flight(file, vehicle)
        except LogError as error:
            reason = " ".join(f"{folder.name}/{file.name}: {error}".split())
            left_out.append(LeftOut(file.name, reason))
    if not flights:
        raise LogError("\n".join(f"{path}/{left.reason}" for left in left_out))
    return FlightSet(path, vehicle, tuple(flights.values()), tuple(left_out))


def write_flights(
    path: Path,
    vehicle: VehicleFile,
    flights: Sequence[FlightLog],
    kind: Literal["parquet", "csv"] = "parquet",
) -> None:
    """A folder of flights, written so that `load_flights` reads them as they are.

    Args:
        path: The folder; made if it is not there.
        vehicle: What vehicle.toml says.
        flights: What flew; all drones of a flight log the same columns.
        kind: Ending and format of the log files; CSV keeps every digit.

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
        file = folder / f"{name}.{kind}"
        if kind == "csv":
            table.to_csv(file, index=False)
        else:
            table.to_parquet(file, index=False)


def _read_flight(file: Path, vehicle: VehicleFile) -> FlightLog:
    """The flight in one file; a LogError does not name the file."""
    if not file.is_file():
        raise LogError("this is not a file; NAME.parquet or NAME.csv is expected.")
    if file.suffix.lower() not in (".parquet", ".csv"):
        raise LogError("the name ends in neither .parquet nor .csv; one of them is expected.")
    drones = split_drones(read_columns(file), vehicle.mass, vehicle.spec)
    return FlightLog(file.stem, tuple(_drone_log(drone) for drone in drones))


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
    """What vehicle.toml says, or a LogError with one line for each thing that is wrong with it."""
    file = path / "vehicle.toml"
    if not file.is_file():
        hint = f" Did you mean {path.parent}?" if (path.parent / "vehicle.toml").is_file() else ""
        raise LogError(f"{file}: there is no such file; it says name, drone and mass.{hint}")
    try:
        given = tomllib.loads(file.read_text(encoding="utf-8-sig"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, OSError) as error:
        raise LogError(f"{file}: this is not TOML: {one_line(error)}.") from error
    keys = [field.name for field in dataclasses.fields(VehicleFile)]
    wrong = [
        f"unknown key '{key}'.{did_you_mean(key, keys)} Allowed: {', '.join(keys)}."
        for key in given
        if key not in keys
    ]
    wrong += [f"key '{key}' is missing; {_EXPECTED[key]}" for key in _EXPECTED if key not in given]
    wrong += [_wrong_value(key, given) for key in _EXPECTED if key in given]
    airframe = None
    if "airframe" in given:
        airframe, more = read_airframe(given["airframe"], given.get("mass"))
        wrong += more
    if any(wrong):
        raise LogError("\n".join(f"{file}: {line}" for line in wrong if line))
    return VehicleFile(given["name"], given["drone"], float(given["mass"]), airframe)


_EXPECTED = {
    "name": "a text that says what flew is expected.",
    "drone": f"an airframe is expected: {', '.join(sorted(AIRFRAMES))}, or another with a table "
    "[airframe] of its numbers.",
    "mass": "the mass in kg is expected.",
}
"""What each key of vehicle.toml is for."""


def _wrong_value(key: str, given: dict[str, object]) -> str:
    """What is wrong with the value of a key of vehicle.toml; empty if nothing is."""
    value = given[key]
    if key != "mass":
        if not isinstance(value, str):
            return f"key '{key}': got {value!r}; {_EXPECTED[key]}"
        if key == "drone" and "airframe" in given:
            return _wrong_own_name(value)
        if key == "drone" and value not in AIRFRAMES:
            return f"key 'drone': got '{value}'.{did_you_mean(value, AIRFRAMES)} {_EXPECTED[key]}"
        return ""
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e9:
        return f"key 'mass': got {value!r}; {_EXPECTED[key]}"
    if "airframe" in given:  # its thrust says what mass is plausible
        return "" if value > 0 else f"key 'mass': got {value:g}; {_EXPECTED[key]}"
    known = [spec for spec in AIRFRAMES.values() if spec.name == given.get("drone")]
    known = known or list(AIRFRAMES.values())
    low = min(spec.mass for spec in known) / MASS_FACTOR
    high = max(spec.mass for spec in known) * MASS_FACTOR
    if not low <= value <= high:
        grams = " Is it in grams?" if low <= value / 1000.0 <= high else ""
        return f"key 'mass': got {value:g}; {low:.3f} to {high:.3f} kg is plausible.{grams}"
    return ""


def _wrong_own_name(name: str) -> str:
    """What is wrong with the name of an airframe that has a table of its own; empty if nothing."""
    if name in AIRFRAMES:
        return f"key 'drone': '{name}' is known; leave out [airframe], or give another name."
    if not re.fullmatch(r"\w[\w.-]*", name):
        return f"key 'drone': got '{name}'; letters, digits, '_', '-' and '.' are expected."
    return ""
