"""Any table (CSV or Parquet) whose columns columns.toml names.

    time = {column = "stamp", unit = "us"}
    world = "ENU"                       # or "NED"; "ENU" is any world whose z points up
    body = "FLU"                        # or "FRD"

    [columns]
    pos_x = "x"                         # already in the unit of the format
    pos_y = {column = "y mm", unit = "mm"}
    pitch = {column = "theta", unit = "deg", sign = -1}

Keys of `columns` are the columns of the format; `roll`, `pitch`, `yaw` may stand for `quat_x..w`.
Columns of a group belong together. Cells may be empty, so that one table can hold several rates.
"""

import csv
import tomllib
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd
from jaxtyping import Float64

from diagnosis.importing.frames import enu, flu, quat_of, quat_of_rpy, rpy_of
from diagnosis.importing.reader import (
    FIELDS,
    AbstractReader,
    Recording,
    Request,
    Stream,
    known_voltage,
    read_csv,
    reading,
    separators,
)
from diagnosis.logs.columns import LogError, did_you_mean, one_line
from diagnosis.logs.units import FOOT, KNOT
from simulators.vehicle import GRAVITY

FILE = "columns.toml"
"""What the file is called when it stands beside the logs."""

UNITS = {
    "s": {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9},
    "m": {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "ft": FOOT},
    "m/s": {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "km/h": 1 / 3.6, "ft/s": FOOT, "kt": KNOT},
    "m/s^2": {"m/s^2": 1.0, "g": GRAVITY, "mg": 1e-3 * GRAVITY, "ft/s^2": FOOT},
    "rad": {"rad": 1.0, "deg": np.pi / 180.0, "mrad": 1e-3},
    "rad/s": {"rad/s": 1.0, "deg/s": np.pi / 180.0, "rpm": 2.0 * np.pi / 60.0},
    "N": {"N": 1.0, "mN": 1e-3, "gf": 1e-3 * GRAVITY, "kgf": GRAVITY, "full": np.nan},
    "V": {"V": 1.0, "mV": 1e-3},
    "share": {"share": 1.0, "percent": 1e-2, "u16": 1.0 / 65535.0, "u8": 1.0 / 255.0},
    "": {"": 1.0},
}
"""Units that a column may have and their size, by the format's unit. A thrust in `full` is a share
of the largest command, which `--full-thrust` says in newtons."""

UNIT_OF = {"pos": "m", "vel": "m/s", "quat": "", "ang_vel": "rad/s", "acc": "m/s^2"}
UNIT_OF |= {"cmd_angles": "rad", "cmd_thrust": "N", "rotor_vel": "rad/s", "pwm": "share"}
UNIT_OF |= {"battery": "V", "rpy": "rad"}
"""The format's unit of each field."""

GROUPS = {**FIELDS, "rpy": ("roll", "pitch", "yaw")}
"""Columns of each field; `rpy` becomes `quat`."""


class TableReader(AbstractReader):
    """Tables, with a file that says what their columns are."""

    name: ClassVar[str] = "table"
    label: ClassVar[str] = "table with columns.toml"

    def recognises(self, path: Path, head: bytes) -> bool:
        return path.suffix.lower() in (".csv", ".parquet") and (path.parent / FILE).is_file()

    def read(self, path: Path, request: Request) -> Recording:
        place = request.columns or path.parent / FILE
        said = read_columns_file(place)
        with reading("table"):
            parquet = path.suffix.lower() == ".parquet"
            frame = pd.read_parquet(path) if parquet else _csv(path, request.truncated)
            streams = _streams(frame, said, request, place)
        missing = tuple(
            f"{field} is not named in {place.name}."
            for field in ("vel", "cmd_angles", "cmd_thrust", "battery")
            if not set(FIELDS[field]) & set(said["columns"])
        )
        return Recording({"": tuple(streams)}, missing)


def _streams(
    frame: pd.DataFrame, said: dict[str, Any], request: Request, place: Path
) -> list[Stream]:
    """A stream for each field that columns.toml names.

    Raises:
        LogError: The table has no rows, or columns.toml does not fit it.
    """
    if frame.empty:
        raise LogError("the table has no rows.")
    t, _ = _column(frame, said["time"], "s", request, "time", place)
    known = said["columns"]
    streams = []
    for field, names in GROUPS.items():
        there = [name for name in names if name in known]
        if not there:
            continue
        if len(there) < len(names):
            lacking = next(name for name in names if name not in known)
            raise LogError(f"{place}: '{lacking}' is missing beside '{there[0]}' in [columns].")
        unit = UNIT_OF[field]
        parts = [_column(frame, known[n], unit, request, n, place) for n in names]
        values = np.stack([values for values, _ in parts], axis=1)
        values = known_voltage(values) if field == "battery" else values
        source = ", ".join(dict.fromkeys(_name(known[name]) for name in names))
        change = ", ".join(dict.fromkeys(word for _, words in parts for word in words))
        streams.append(_turned(field, t, values, source, change, said))
    return streams


def _csv(path: Path, truncated: bool) -> pd.DataFrame:
    """The table; `truncated`: whether a last row that breaks off is left out, not refused."""
    frame = read_csv(path)
    last = path.read_text(encoding="utf-8-sig").rstrip().rpartition("\n")[2]
    cut = csv.reader([last], delimiter=separators(path)["sep"])
    cells, columns = len(next(cut, ())), len(frame.columns)
    if len(frame) and (cells < columns or frame.iloc[-1].isna().all()):
        if not truncated:
            what = f"has {cells} of {columns} cells" if cells < columns else "is empty"
            raise LogError(
                f"the last row {what}; is the file truncated? --truncated uses the rows before it."
            )
        frame = frame.iloc[:-1]
    return frame


def read_columns_file(path: Path) -> dict[str, Any]:
    """What columns.toml says, checked.

    Raises:
        LogError: It cannot be read, or a key or a value is unknown.
    """
    try:
        said = tomllib.loads(path.read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise LogError(f"{path} cannot be read: {error.strerror}.") from error
    except (UnicodeDecodeError, tomllib.TOMLDecodeError) as error:
        raise LogError(f"{path}: this is not TOML: {one_line(error)}.") from error
    _known(said, ("time", "world", "body", "columns"), path)
    for key in ("time", "columns"):
        if key not in said:
            raise LogError(f"{path}: key '{key}' is missing.")
    if not isinstance(said["columns"], dict):
        raise LogError(f"{path}: 'columns' must be a table, got {said['columns']!r}.")
    _known(said["columns"], [name for names in GROUPS.values() for name in names], path)
    twice = [next((n for n in GROUPS[f] if n in said["columns"]), None) for f in ("quat", "rpy")]
    if all(twice):
        raise LogError(f"{path}: '{twice[0]}' and '{twice[1]}' both give the attitude; keep one.")
    for key, allowed in (("world", ("ENU", "NED")), ("body", ("FLU", "FRD"))):
        if said.setdefault(key, allowed[0]) not in allowed:
            raise LogError(f"{path}: {key} must be {' or '.join(allowed)}, got {said[key]!r}.")
    for name, entry in (("time", said["time"]), *said["columns"].items()):
        if isinstance(entry, dict):
            _known(entry, ("column", "unit", "sign"), path)
            if entry.get("sign", 1) not in (1, -1):
                raise LogError(f"{path}: sign of '{name}' must be 1 or -1, got {entry['sign']!r}.")
            if not isinstance(entry.get("unit", ""), str):
                raise LogError(f"{path}: unit of '{name}' must be a text, got {entry['unit']!r}.")
        if not isinstance(_name(entry), str):
            raise LogError(f"{path}: '{name}' must name a column of the table, got {entry!r}.")
    return said


def _known(given: dict[str, Any], allowed: Any, path: Path) -> None:
    for key in given:
        if key not in allowed:
            hint = did_you_mean(key, allowed)
            raise LogError(f"{path}: unknown key '{key}'.{hint} Allowed: {', '.join(allowed)}.")


def _name(entry: Any) -> Any:
    """The table's name of a column."""
    return entry.get("column") if isinstance(entry, dict) else entry


def _column(
    frame: pd.DataFrame, entry: Any, unit: str, request: Request, name: str, place: Path
) -> tuple[Float64[np.ndarray, " rows"], list[str]]:
    """A column in the format's unit, NaN where a cell holds no number, and what was done to it."""
    column = _name(entry)
    if column not in frame.columns:
        hint = did_you_mean(column, [str(c) for c in frame.columns])
        raise LogError(f"{place}: the table has no column '{column}' for '{name}'.{hint}")
    given = entry.get("unit", unit) if isinstance(entry, dict) else unit
    if given not in UNITS[unit]:
        allowed = ", ".join(u for u in UNITS[unit] if u) or "no unit"
        raise LogError(f"{place}: '{name}' has the unit '{given}'; allowed: {allowed}.")
    factor = UNITS[unit][given]
    if given == "full":
        factor, _ = request.scale(None, "parameter")
    if not pd.api.types.is_numeric_dtype(frame[column]):
        raise LogError(f"column '{column}' holds text; numbers are expected.")
    sign = entry.get("sign", 1) if isinstance(entry, dict) else 1
    words = [f"{given} to {unit}"] if given != unit else []
    words += ["sign changed"] if sign < 0 else []
    values = frame[column].to_numpy(np.float64)
    return sign * factor * np.where(np.isfinite(values), values, np.nan), words


def _turned(
    field: str, t: np.ndarray, values: np.ndarray, source: str, change: str, said: dict[str, Any]
) -> Stream:
    """The stream in the frames of the format."""
    ned, frd = said["world"] == "NED", said["body"] == "FRD"
    frames = []
    if field in ("pos", "vel") and ned:
        values, frames = enu(values), ["NED to ENU"]
    elif field in ("ang_vel", "acc") and frd:
        values, frames = flu(values), ["FRD to FLU"]
    elif field in ("quat", "rpy", "cmd_angles"):
        quat = values if field == "quat" else quat_of_rpy(values)
        quat = quat_of(quat, ned=ned, frd=frd) if ned or frd else quat
        values = rpy_of(quat) if field == "cmd_angles" and (ned or frd) else values
        values = quat if field != "cmd_angles" else values
        frames = ["NED to ENU"] * ned + ["FRD to FLU"] * frd
    words = ", ".join([*([change] if change else []), *frames]) or "as it is"
    return Stream("quat" if field == "rpy" else field, t, values, source, words)
