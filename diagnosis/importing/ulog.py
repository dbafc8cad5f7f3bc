"""PX4: messages of ULog files, and the same ones on ROS 2 (`px4_msgs`).

| field | message and fields | |
|---|---|---|
| `pos`, `vel` | `vehicle_local_position` x y z, vx vy vz | north, east, down |
| `quat` | `vehicle_attitude` q | scalar first, FRD in NED |
| `ang_vel` | `vehicle_angular_velocity` xyz | FRD |
| `acc` | `vehicle_acceleration` xyz, else `sensor_combined` | FRD |
| `cmd_angles`, `cmd_thrust` | `vehicle_attitude_setpoint` q_d, thrust_body | 0 to 1 downwards |
| `rotor_vel` | `esc_status` esc[i].esc_rpm | rev/min |
| `battery` | `battery_status` voltage_v | |

Times are those of the measurement (`timestamp_sample`) where they are logged, else of the message.
A thrust of 1 is turned into newtons by the thrust that PX4 believes to hover, `MPC_THR_HOVER`.
Motor commands are not taken: what PWM means is known for the Crazyflie alone. Source of all names:
the uORB messages of PX4 v1.16 (PX4-Autopilot/msg).
"""

import collections
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import ClassVar

import numpy as np
from jaxtyping import Float64

from diagnosis.importing.frames import FRD, NED, enu, flu, quat_of, rpy_of
from diagnosis.importing.reader import (
    AbstractReader,
    Recording,
    Request,
    Stream,
    broken_off,
    known_voltage,
    reading,
)
from diagnosis.logs.columns import LogError

MAGIC = b"ULog\x01\x12\x35"
"""First bytes of a ULog file; PX4 user guide, "ULog file format"."""
ROTORS = 4
"""Rotors of the vehicles that can be diagnosed."""
HOVER = "MPC_THR_HOVER"
"""Parameter that holds the thrust which PX4 believes to hover [-]."""

Table = Mapping[str, np.ndarray]
"""A message's fields over time; elements of arrays are called `q[0]`."""

TOPICS = {
    "vehicle_local_position": 20,
    "vehicle_attitude": 10,
    "vehicle_angular_velocity": 10,
    "vehicle_acceleration": 20,
    "vehicle_attitude_setpoint": 10,
    "esc_status": 20,
    "battery_status": 200,
}
"""Messages that are read, and the distance at which the recipe logs them [ms]."""

OTHERS = ("sensor_combined",)
"""Messages that are read where one of `TOPICS` is missing."""

MOST_RETURNS = 10
"""How often a reader may go back to one place in a file; a choice."""

RECIPE = (
    "# etc/logging/logger_topics.txt on the SD card of the autopilot: message, distance [ms].\n"
    "# PX4 then logs these alone. Restart it, fly, and read the log with: bench import LOG.ulg\n"
    "# Before: SDLOG_MODE 0 (armed); MPC_THR_HOVER within 1.6 times the throttle in hover.\n"
    + "".join(f"{name} {distance}\n" for name, distance in TOPICS.items())
)
"""What to log."""


class _Forward(io.BufferedReader):
    """A file that a reader cannot wind back to one place again and again.

    pyulog does so for ever where a damaged message claims to be longer than the rest of the file.
    """

    def __init__(self, raw: io.RawIOBase) -> None:
        super().__init__(raw)
        self._back: collections.Counter[int] = collections.Counter()

    def seek(self, offset: int, whence: int = io.SEEK_SET) -> int:
        at = super().seek(offset, whence)
        if offset < 0:
            self._back[at] += 1
            if self._back[at] > MOST_RETURNS:
                raise EOFError("a message is longer than the file")  # pyulog catches no such
        return at


class UlogReader(AbstractReader):
    """ULog files of PX4, read with pyulog."""

    name: ClassVar[str] = "ulog"
    label: ClassVar[str] = "PX4 ULog"
    package: ClassVar[str] = "pyulog"
    extra: ClassVar[str] = "ulog"

    def recognises(self, path: Path, head: bytes) -> bool:
        return head.startswith(MAGIC)

    def read(self, path: Path, request: Request) -> Recording:
        pyulog = self.module()
        with reading("ULog file"), _Forward(io.FileIO(path)) as file:
            log = pyulog.ULog(file, [*TOPICS, *OTHERS])
        notes = []
        if log.file_corruption:
            raise LogError("the ULog file is damaged: it holds bytes that are no message.")
        if _breaks_off(path):
            notes.append(broken_off("the ULog file ends within a message", request))
        lost = sum(dropout.duration for dropout in log.dropouts)
        if lost:
            notes.append(f"The logger lost {lost} ms in {len(log.dropouts)} dropouts.")
        tables = {data.name: data.data for data in log.data_list if data.multi_id == 0}
        hover = log.initial_parameters.get(HOVER)
        with reading("ULog file"):
            streams, missing, more = px4_streams(tables, request, hover)
        return Recording({"": tuple(streams)}, tuple(missing), (*notes, *more))


def px4_streams(
    tables: Mapping[str, Table], request: Request, hover: float | None
) -> tuple[list[Stream], list[str], list[str]]:
    """Streams of one vehicle, what is missing, and notes.

    Args:
        tables: Messages by their name in uORB.
        request: What the operator says.
        hover: Thrust that PX4 believes to hover [-].
    """
    streams, missing, notes = [], [], []
    for name in ("vehicle_local_position", "vehicle_attitude", "vehicle_attitude_setpoint"):
        if name not in tables:
            missing.append(f"{name} was not logged.")
    if "vehicle_local_position" in tables:
        more, resets = _position(tables["vehicle_local_position"])
        streams += more
        if resets:
            notes.append(
                f"The position estimate was reset {resets} times; its jumps are no motion."
            )
    if "vehicle_attitude" in tables:
        table = tables["vehicle_attitude"]
        quat = quat_of(stack(table, "q", 4)[:, [1, 2, 3, 0]])
        source = "vehicle_attitude q"
        streams.append(Stream("quat", times(table), quat, source, f"{NED}, {FRD}"))
    for field, names in {
        "ang_vel": ("vehicle_angular_velocity xyz",),
        "acc": ("vehicle_acceleration xyz", "sensor_combined accelerometer_m_s2"),
    }.items():
        source = next((name for name in names if name.split()[0] in tables), None)
        if source is not None:
            table = tables[source.split()[0]]
            values = flu(stack(table, source.split()[1], 3))
            streams.append(Stream(field, times(table), values, source, FRD))
    if "vehicle_attitude_setpoint" in tables:
        streams += _commands(tables["vehicle_attitude_setpoint"], request, hover)
    if "esc_status" in tables:
        speeds = _rotors(tables["esc_status"])
        missing += [] if speeds else ["esc_status holds no speeds of four rotors."]
        streams += speeds
    if "battery_status" in tables:
        table = tables["battery_status"]
        volts = known_voltage(np.asarray(table["voltage_v"], float)[:, None])
        streams.append(Stream("battery", times(table), volts, "battery_status voltage_v"))
    return streams, missing, notes


def times(table: Table) -> Float64[np.ndarray, " rows"]:
    """When each row was measured [s]."""
    stamp = np.asarray(table["timestamp"])
    if "timestamp_sample" in table:
        sample = np.asarray(table["timestamp_sample"])
        stamp = np.where(sample > 0, sample, stamp)
    return stamp.astype(np.float64) * 1e-6


def stack(table: Table, name: str, size: int) -> Float64[np.ndarray, "rows columns"]:
    """The elements of an array as columns."""
    return np.stack([np.asarray(table[f"{name}[{i}]"], float) for i in range(size)], axis=1)


def _position(table: Table) -> tuple[list[Stream], int]:
    """Position and velocity, NaN where the estimate does not call them valid, and its resets."""
    t, streams = times(table), []
    for field, names, flags in (
        ("pos", "x y z", ("xy_valid", "z_valid")),
        ("vel", "vx vy vz", ("v_xy_valid", "v_z_valid")),
    ):
        good = np.ones(len(t), bool)
        for flag in flags:
            good &= np.asarray(table.get(flag, good)).astype(bool)
        values = np.stack([np.asarray(table[name], float) for name in names.split()], axis=1)
        source = f"vehicle_local_position {names}"
        values[~good] = np.nan
        streams.append(Stream(field, t, enu(values), source, NED))
    counters = [table[name] for name in ("xy_reset_counter", "z_reset_counter") if name in table]
    return streams, sum(int(np.count_nonzero(np.diff(np.asarray(c)))) for c in counters)


def _commands(table: Table, request: Request, hover: float | None) -> Sequence[Stream]:
    """Commanded attitude and thrust."""
    scale, words = request.scale(hover, HOVER)
    t = np.asarray(table["timestamp"]).astype(np.float64) * 1e-6  # when it took effect
    rpy = rpy_of(quat_of(stack(table, "q_d", 4)[:, [1, 2, 3, 0]]))
    thrust = -scale * np.asarray(table["thrust_body[2]"], float)[:, None]
    name = "vehicle_attitude_setpoint"
    return [
        Stream("cmd_angles", t, rpy, f"{name} q_d", f"{NED}, {FRD}, to roll, pitch, yaw"),
        Stream("cmd_thrust", t, thrust, f"{name} thrust_body[2]", f"upwards, {words}"),
    ]


def _rotors(table: Table) -> list[Stream]:
    """Rotor speeds, where four motors report one."""
    names = [f"esc[{i}].esc_rpm" for i in range(ROTORS)]
    if not all(name in table and np.any(table[name]) for name in names):
        return []
    speeds = np.stack([np.abs(np.asarray(table[name], float)) for name in names], axis=1)
    values = speeds * 2.0 * np.pi / 60.0
    return [Stream("rotor_vel", times(table), values, "esc_status esc_rpm", "rev/min to rad/s")]


def _breaks_off(path: Path) -> bool:
    """Whether the last message is shorter than its header says."""
    data, at = path.read_bytes(), 16
    while at + 3 <= len(data):
        at += 3 + int.from_bytes(data[at : at + 2], "little")
    return at != len(data)
