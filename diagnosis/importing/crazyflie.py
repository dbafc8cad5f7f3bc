"""Crazyflie: variables of the firmware by name, and the CSV files that its clients write.

| field | variables | |
|---|---|---|
| `pos`, `vel` | `stateEstimate` x y z, vx vy vz | or `stateEstimateZ`, in mm |
| `quat` | `stateEstimate` qx qy qz qw | or `stateEstimateZ.quat`, or angles |
| `ang_vel`, `acc` | `gyro` [deg/s], `acc` [g] | |
| `cmd_angles` | `controller` roll pitch yaw [deg] | or `ctrlMel` zdx zdy zdz, measured yaw |
| `cmd_thrust` | `stabilizer.thrust` | or `controller.cmd_thrust`, `ctrlMel.cmd_thrust` |
| `pwm`, `rotor_vel` | `motor` m1 .. m4; `rpm` m1 .. m4 | 0 to 65535; rev/min |
| `battery` | `pm.vbat` [V] | |

Pitch angles of the firmware point the other way ("legacy CF2 body coordinate system"), quaternions
do not. A thrust of 65535 is the airframe's largest thrust, as firmware with battery compensation
has it since 2025 (THRUST_MAX of `platform_defaults_*.h`); older firmware means 60 gf of all rotors,
0.589 N, which `--full-thrust` says. Source: crazyflie-firmware, `stabilizer.c`, `controller_pid.c`,
`controller_mellinger.c`, `kalman_core.c`, `quatcompress.h`, `motors.c` (August 2026).
"""

import dataclasses
from collections.abc import Mapping
from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd
from jaxtyping import Float64

from diagnosis.importing.frames import quat_of_rpy, rpy_of
from diagnosis.importing.reader import (
    AbstractReader,
    Recording,
    Request,
    Stream,
    broken_off,
    known_voltage,
    read_csv,
    reading,
)
from diagnosis.logs.columns import LogError
from simulators.vehicle import GRAVITY

FULL = 65535.0
"""Largest command of thrust and of a motor; firmware, `UINT16_MAX`."""
TIMES = ("timestamp", "time", "t", "tick")
"""What clients call the column of times, in any case of letters."""
MILLISECONDS = 0.5
"""Median step from which times are milliseconds: a log has more than 2 rows a second."""
TOGETHER = 0.5
"""Share of times at which variables must stand together to be of one block; a choice. Of different
blocks nearly none do."""
INVALID_RPM = 65535.0
"""A motor's speed that was not measured. Source: `motors.c`, `UINT16_MAX`."""
PITCH = np.asarray([1.0, -1.0, 1.0])
"""Signs of roll, pitch, yaw as the firmware counts them."""

MOST_LOGGED = 20
"""Variables that the uSD deck logs of one event; it leaves out the others without a word. Source:
`MAX_USD_LOG_VARIABLES_PER_EVENT` of `usddeck.c`."""
LOGGED = (
    *(f"stateEstimate.{name}" for name in ("x", "y", "z", "vx", "vy", "vz")),
    *(f"stateEstimate.{name}" for name in ("qx", "qy", "qz", "qw")),
    *(f"controller.{name}" for name in ("roll", "pitch", "yaw")),
    "stabilizer.thrust",
    *(f"motor.m{i}" for i in range(1, 5)),
    "pm.vbat",
)
"""Variables that the recipe logs, `MOST_LOGGED` at most."""
MELLINGER = {
    "controller.roll": "ctrlMel.zdx",
    "controller.pitch": "ctrlMel.zdy",
    "controller.yaw": "ctrlMel.zdz",
}
"""What to log in the place of some of them where Mellinger's controller flies."""


def _instead(name: str) -> str:
    """The comment on a variable that Mellinger's controller has under another name."""
    return f"   # Mellinger's controller: {MELLINGER[name]}" if name in MELLINGER else ""


RECIPE = (
    "1     # version\n512   # buffer size [bytes]\nlog   # file name\n0     # start by itself\n"
    "on:fixedFrequency\n250   # rate [Hz]\n1     # mode: in step with the stabilizer\n"
    + "".join(f"{name}{_instead(name)}\n" for name in LOGGED)
)
"""config.txt on the card of the uSD deck; start with the parameter usd.logging = 1."""


Variables = Mapping[str, pd.Series]
"""Variables of the firmware by name, as it logs them, over time [s]."""


class CrazyflieCsvReader(AbstractReader):
    """CSV of cfclient or of a script around cflib; a folder holds the blocks of one flight."""

    name: ClassVar[str] = "cflib"
    label: ClassVar[str] = "Crazyflie CSV"

    def recognises(self, path: Path, head: bytes) -> bool:
        if not path.is_dir():
            return _is_header(head)
        files = _files(path)
        headers = [_first(file) for file in files]
        # Blocks of one flight, unless one of them is a flight by itself.
        return len(files) > 1 and all(map(_is_header, headers)) and not any(map(_whole, headers))

    def read(self, path: Path, request: Request) -> Recording:
        variables: dict[str, pd.Series] = {}
        notes = []
        for file in _files(path) if path.is_dir() else [path]:
            found, said = _read_csv(file, request)
            variables |= found
            notes += said
        with reading("CSV file"):
            streams, missing = crazyflie_streams(variables, request)
        return Recording({"": tuple(streams)}, tuple(missing), tuple(notes))


def crazyflie_streams(variables: Variables, request: Request) -> tuple[list[Stream], list[str]]:
    """Streams of one Crazyflie, and what is missing."""
    every = [_pos_vel(variables), _quat(variables), _plain(variables), _angles(variables)]
    every += [_thrust(variables, request), _rotors(variables)]
    streams = [stream for some in every for stream in some]
    there = {stream.field for stream in streams}
    missing = [f"{what} was not logged." for what, field in _WANTED.items() if field not in there]
    return streams, missing


_WANTED = {
    "stateEstimate.x, y, z": "pos",
    "stateEstimate.vx, vy, vz": "vel",
    "stateEstimate.qx, qy, qz, qw": "quat",
    "controller.roll, pitch, yaw or ctrlMel.zdx, zdy, zdz": "cmd_angles",
    "stabilizer.thrust": "cmd_thrust",
    "motor.m1 to m4": "pwm",
    "pm.vbat": "battery",
}
"""What a diagnosis can use, and the field that it becomes."""


def _group(variables: Variables, names: str) -> tuple[np.ndarray, np.ndarray] | None:
    """Times and columns of variables that were logged together; `names` as `group.a b c`.

    A time at which one of them has no number gives a row without one.

    Raises:
        LogError: They were logged at different times.
    """
    group, _, rest = names.partition(".")
    found = [variables.get(f"{group}.{name}") for name in rest.split()]
    known = [variable for variable in found if variable is not None]
    if len(known) < len(found):
        return None
    if all(variable.index.equals(known[0].index) for variable in known):
        return known[0].index.to_numpy(), np.stack([v.to_numpy() for v in known], axis=1)
    rows = pd.concat([v.groupby(level=0).first() for v in known], axis=1)
    if rows.notna().all(axis=1).mean() < TOGETHER:
        raise LogError(f"{names} stand in different blocks; log them in one block.")
    return rows.index.to_numpy(), rows.to_numpy()


def _stream(
    variables: Variables, field: str, names: str, factor: float = 1.0, change: str = ""
) -> list[Stream]:
    found = _group(variables, names)
    if found is None:
        return []
    return [Stream(field, found[0], factor * found[1], names, change or "as it is")]


def _pos_vel(variables: Variables) -> list[Stream]:
    out = []
    for field, names in (("pos", "x y z"), ("vel", "vx vy vz")):
        fine = _stream(variables, field, f"stateEstimate.{names}")
        coarse = f"stateEstimateZ.{names}"
        out += fine or _stream(variables, field, coarse, 1e-3, "thousandths to SI")
    return out


def _quat(variables: Variables) -> list[Stream]:
    """The attitude, as finely as it was logged."""
    found = _stream(variables, "quat", "stateEstimate.qx qy qz qw")
    if found:
        return found
    packed = _group(variables, "stateEstimateZ.quat")
    if packed is not None:
        values = unpacked(packed[1][:, 0])
        return [Stream("quat", packed[0], values, "stateEstimateZ.quat", "unpacked from 32 bits")]
    for group in ("stateEstimate", "stabilizer"):
        angles = _group(variables, f"{group}.roll pitch yaw")
        if angles is not None:
            quat = quat_of_rpy(np.radians(angles[1] * PITCH))
            source = f"{group}.roll pitch yaw"
            return [Stream("quat", angles[0], quat, source, "degrees, pitch's sign changed")]
    return []


def unpacked(packed: Float64[np.ndarray, " rows"]) -> Float64[np.ndarray, "rows 4"]:
    """Quaternions of 32 bits: which part is the largest, then sign and 9 bits of each other one."""
    bits = packed.astype(np.int64) & 0xFFFFFFFF
    largest = bits >> 30
    quat = np.zeros((len(bits), 4))
    for i in (3, 2, 1, 0):
        here = largest != i
        part = np.where(bits & 0x200, -1.0, 1.0) * (bits & 0x1FF) / 511.0 * np.sqrt(0.5)
        quat[:, i] = np.where(here, part, 0.0)
        bits = np.where(here, bits >> 10, bits)
    rest = np.sqrt(np.maximum(1.0 - np.sum(quat**2, axis=1), 0.0))
    quat[np.arange(len(quat)), largest] = rest
    return quat


def _plain(variables: Variables) -> list[Stream]:
    """What needs a factor alone."""
    return [
        *_stream(variables, "ang_vel", "gyro.x y z", np.pi / 180.0, "deg/s to rad/s"),
        *_stream(variables, "acc", "acc.x y z", GRAVITY, "g to m/s^2"),
        *(
            dataclasses.replace(volts, values=known_voltage(volts.values))
            for volts in _stream(variables, "battery", "pm.vbat")
        ),
    ]


def _angles(variables: Variables) -> list[Stream]:
    """Commanded attitude of the controller that flew."""
    pid = _group(variables, "controller.roll pitch yaw")
    axis = _group(variables, "ctrlMel.zdx zdy zdz")
    if axis is not None and np.any(axis[1]):
        attitude = _quat(variables)
        yaw = rpy_of(attitude[0].values)[:, 2] if attitude else np.zeros(0)
        known = np.isfinite(yaw)
        if known.any():
            yaw = np.interp(axis[0], attitude[0].t[known], np.unwrap(yaw[known]))
            change = "direction of thrust to roll, pitch at the measured yaw"
            values = _tilt(axis[1], yaw)
            return [Stream("cmd_angles", axis[0], values, "ctrlMel.zdx zdy zdz", change)]
    if pid is None:
        return []
    values = np.radians(pid[1] * PITCH)
    source, change = "controller.roll pitch yaw", "degrees, pitch's sign changed"
    return [Stream("cmd_angles", pid[0], values, source, change)]


def _tilt(
    axis: Float64[np.ndarray, "rows 3"], yaw: Float64[np.ndarray, " rows"]
) -> Float64[np.ndarray, "rows 3"]:
    """Roll, pitch, yaw [rad] of bodies with a given z axis and yaw."""
    x, y, z = (axis / np.maximum(np.linalg.norm(axis, axis=1, keepdims=True), 1e-9)).T
    cos, sin = np.cos(yaw), np.sin(yaw)
    roll = np.arcsin(np.clip(sin * x - cos * y, -1.0, 1.0))
    return np.stack([roll, np.arctan2(cos * x + sin * y, z), yaw], axis=1)


def _thrust(variables: Variables, request: Request) -> list[Stream]:
    """Commanded thrust."""
    full = request.full_thrust
    words = f"65535 is {full or request.thrust_max:g} N, "
    words += "by --full-thrust" if full else "the airframe's largest thrust"
    for names in ("stabilizer.thrust", "controller.cmd_thrust", "ctrlMel.cmd_thrust"):
        factor = (full or request.thrust_max) / FULL
        found = _stream(variables, "cmd_thrust", names, factor, words)
        if found and np.any(found[0].values):
            return found
    return []


def _rotors(variables: Variables) -> list[Stream]:
    """Motor commands and rotor speeds."""
    change = "0 to 65535 becomes 0 to 1"
    out = _stream(variables, "pwm", "motor.m1 m2 m3 m4", 1.0 / FULL, change)
    for names in ("rpm.m1 m2 m3 m4", "motor.m1_rpm m2_rpm m3_rpm m4_rpm"):
        found = _stream(variables, "rotor_vel", names, 2.0 * np.pi / 60.0, "rev/min to rad/s")
        if found and np.any(found[0].values):
            (speeds,) = found
            unknown = speeds.values > (INVALID_RPM - 0.5) * 2.0 * np.pi / 60.0
            values = np.where(unknown, np.nan, speeds.values)
            return [*out, dataclasses.replace(speeds, values=values)]
    return out


def _files(path: Path) -> list[Path]:
    """Every file of a folder but hidden ones."""
    return sorted(file for file in path.iterdir() if not file.name.startswith("."))


def _first(file: Path) -> bytes:
    """The first line of a file; none of a folder."""
    if not file.is_file():
        return b""
    with file.open("rb") as opened:
        return opened.readline(4096)


def _names(head: bytes) -> list[str]:
    line = head.split(b"\n")[0].decode("utf-8-sig", errors="replace")
    return [name.strip() for name in line.split(",")]


def _is_header(head: bytes) -> bool:
    """Whether a Crazyflie's CSV may begin like this: a time, and variables of the firmware."""
    names = _names(head)
    timed = any(name.lower() in TIMES for name in names)
    return timed and any(name.partition(".")[0] in _GROUPS and "." in name for name in names)


_GROUPS = {name.partition(".")[0] for name in (*LOGGED, *MELLINGER.values())}
_GROUPS |= {"stateEstimateZ", "ctrltarget", "gyro", "acc", "rpm"}
"""Groups of variables that are known."""


def _whole(head: bytes) -> bool:
    """Whether a file with this header is a flight by itself: it holds position and an input."""
    names = " ".join(_names(head))
    placed = any(f"{group}.x" in _names(head) for group in ("stateEstimate", "stateEstimateZ"))
    return placed and any(n in names for n in (".thrust", "cmd_thrust", "motor."))


def _read_csv(file: Path, request: Request) -> tuple[dict[str, pd.Series], list[str]]:
    """Variables of a CSV file, in which cells may be empty, and notes on what was read."""
    with reading("CSV file"):
        frame = read_csv(file)
    key = next((name for name in frame.columns if name.lower() in TIMES), None)
    if key is None or frame.empty:
        raise LogError(f"{file.name}: no row follows the header.")
    if not frame.columns.is_unique:
        raise LogError(f"{file.name}: a column is there twice.")
    kinds = frame.select_dtypes(exclude="number").columns
    if len(kinds):
        raise LogError(f"{file.name}: column '{kinds[0]}' holds text; numbers are expected.")
    if not np.isfinite(frame[key].to_numpy(np.float64)).all():
        raise LogError(f"{file.name}: a row has no time; is the file truncated?")
    notes, empty = [], frame.isna().to_numpy()
    if empty[-1].any() and not empty[:-1, empty[-1]].any():
        notes.append(broken_off(f"{file.name}: the last row is cut", request))
        frame = frame.iloc[:-1]
    t = frame[key].to_numpy(np.float64)
    milli = len(t) > 1 and float(np.median(np.diff(np.unique(t)))) >= MILLISECONDS
    frame = frame.drop(columns=key).astype(np.float64).set_index(t * 1e-3 if milli else t)
    known = {str(name): pd.Series(values) for name, values in frame.items()}
    found = {name: values.loc[np.isfinite(values)] for name, values in known.items()}
    unit = "milliseconds" if milli else "seconds"
    return found, [*notes, f"Times of {file.name} are read as {unit}."]
