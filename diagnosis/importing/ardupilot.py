"""ArduPilot: DataFlash logs (.bin), read with pymavlink.

| field | message and fields | |
|---|---|---|
| `pos`, `vel` | `XKF1`, first core, PN PE PD, VN VE VD | north, east, down |
| `quat` | `ATT` Roll Pitch Yaw | degrees, FRD in NED |
| `ang_vel`, `acc` | `IMU`, first one, GyrX.., AccX.. | FRD |
| `cmd_angles` | `ATT` DesRoll DesPitch DesYaw | degrees |
| `cmd_thrust` | `RATE` AOut | 0 to 1 |
| `battery` | `BAT`, first one, Volt | |

A throttle of 1 is turned into newtons by the throttle that ArduPilot believes to hover,
`MOT_THST_HOVER`. Source of all names: ArduPilot's "Onboard message log messages" (Copter 4.6).
"""

import tempfile
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pandas as pd

from diagnosis.importing.frames import FRD, NED, enu, flu, quat_of, quat_of_rpy, rpy_of
from diagnosis.importing.reader import (
    AbstractReader,
    Recording,
    Request,
    Stream,
    broken_off,
    known_voltage,
    reading,
)

HEAD = bytes([0xA3, 0x95])
"""First bytes of every message."""
FMT = 0x80
"""The message that says what messages hold; the first of a log."""
HOVER = "MOT_THST_HOVER"
"""Parameter that holds the throttle which ArduPilot believes to hover [-]."""
PAGE = 256
"""A log in flash memory may end with so many bytes that were erased."""
TYPES = ("XKF1", "ATT", "IMU", "RATE", "BAT", "PARM")
"""Messages that are read."""
INSTANCE = {"XKF1": ("C",), "IMU": ("I",), "BAT": ("Instance", "Inst")}
"""Field that numbers the sensors or estimators of a message, older names last."""


class ArdupilotReader(AbstractReader):
    """DataFlash logs of ArduPilot."""

    name: ClassVar[str] = "ardupilot"
    label: ClassVar[str] = "ArduPilot DataFlash"
    package: ClassVar[str] = "pymavlink"
    extra: ClassVar[str] = "ardupilot"

    def recognises(self, path: Path, head: bytes) -> bool:
        return head[:2] == HEAD and head[2:3] == bytes([FMT])

    def read(self, path: Path, request: Request) -> Recording:
        module = self.module("pymavlink.DFReader")
        data = path.read_bytes()
        with reading("DataFlash log"):
            whole = _whole(data)
        notes = []
        if data[whole : whole + PAGE].strip(b"\xff\x00") or len(data) > whole + PAGE:
            what = f"the log holds {len(data) - whole} bytes at its end that are no message"
            notes.append(broken_off(what, request))
        with reading("DataFlash log"), tempfile.NamedTemporaryFile(suffix=".bin") as file:
            # The package complains about other bytes on the terminal, one line for each of them.
            file.write(data[:whole])
            file.flush()
            with module.DFReader_binary(file.name) as log:
                rows = _rows(log)
            tables = {name: _first(name, found) for name, found in rows.items()}
            parameters = {row["Name"]: float(row["Value"]) for row in rows.get("PARM", [])}
            streams = _streams(tables, request, parameters.get(HOVER))
        wanted = ("XKF1", "ATT", "RATE", "BAT")
        missing = tuple(f"{name} was not logged." for name in wanted if name not in tables)
        return Recording({"": tuple(streams)}, missing, tuple(notes))


def _first(name: str, rows: list[dict[str, Any]]) -> pd.DataFrame:
    """The rows of the first sensor or estimator of a message."""
    table = pd.DataFrame(rows)
    key = next((key for key in INSTANCE.get(name, ()) if key in table), None)
    return table if key is None else table.loc[table[key] == 0]


def _rows(log: Any) -> dict[str, list[dict[str, Any]]]:
    """The messages that are read, by their names."""
    found: dict[str, list[dict[str, Any]]] = {}
    while (message := log.recv_match(type=list(TYPES))) is not None:
        found.setdefault(message.get_type(), []).append(message.to_dict())
    return found


def _whole(data: bytes) -> int:
    """How many bytes from the start on are messages."""
    at, lengths = 0, {FMT: 89}
    while data[at : at + 2] == HEAD and at + 3 <= len(data):
        length = lengths.get(data[at + 2], 0)
        if length < 3 or at + length > len(data):
            break
        if data[at + 2] == FMT:
            lengths[data[at + 3]] = data[at + 4]
        at += length
    return at


def _streams(
    tables: dict[str, pd.DataFrame], request: Request, hover: float | None
) -> list[Stream]:
    def attitude(degrees: np.ndarray) -> np.ndarray:
        return quat_of(quat_of_rpy(np.radians(degrees)))

    change = f"degrees to radians, {NED}, {FRD}"
    wanted = [
        ("pos", "XKF1 PN PE PD", enu, NED),
        ("vel", "XKF1 VN VE VD", enu, NED),
        ("quat", "ATT Roll Pitch Yaw", attitude, change),
        ("cmd_angles", "ATT DesRoll DesPitch DesYaw", lambda x: rpy_of(attitude(x)), change),
        ("ang_vel", "IMU GyrX GyrY GyrZ", flu, FRD),
        ("acc", "IMU AccX AccY AccZ", flu, FRD),
    ]
    if "RATE" in tables:
        scale, words = request.scale(hover, HOVER)
        wanted.append(("cmd_thrust", "RATE AOut", lambda x: scale * x, words))
    wanted.append(("battery", "BAT Volt", known_voltage, "as it is"))
    streams = []
    for field, source, turned, done in wanted:
        name, *columns = source.split()
        if name in tables:
            t = tables[name]["TimeUS"].to_numpy(np.float64) * 1e-6
            values = turned(tables[name][columns].to_numpy(np.float64))
            streams.append(Stream(field, t, values, source, done))
    return streams
