"""Crazyflie: binary logs of the uSD deck.

    0xBC, version u16, event types u16
    for each type:      id u16, name 0x00, variables u16, for each one "name(type)" 0x00
    for each event:     id u16, time u64 [us] (version 1: u32 [ms]), variables one after the other
    CRC-32 of all that, u32

Little-endian; a type is a letter of Python's `struct`. Source: crazyflie-firmware, `usddeck.c` and
the description of the format in `tools/usdlog` (August 2026).
"""

import struct
import zlib
from pathlib import Path
from typing import ClassVar

import numpy as np
import pandas as pd

from diagnosis.importing.crazyflie import crazyflie_streams
from diagnosis.importing.reader import AbstractReader, Recording, Request, broken_off, reading

MAGIC = 0xBC
"""First byte."""
TICKS = {1: ("u4", 1e-3), 2: ("u8", 1e-6)}
"""By version: how a time is stored, and its unit [s]."""
KINDS = {"b": "i1", "B": "u1", "h": "i2", "H": "u2", "i": "i4", "I": "u4", "f": "f4", "d": "f8"}
KINDS |= {"l": "i4", "L": "u4", "q": "i8", "Q": "u8", "e": "f2"}
"""Letters of types, as numpy calls them."""


NUMBER, TIME = "event id", "event time"
"""What an event begins with; no variable is called so, as events have a variable `id` or `t`."""


class UsdReader(AbstractReader):
    """Logs of the uSD deck; our own reader."""

    name: ClassVar[str] = "usd"
    label: ClassVar[str] = "Crazyflie uSD log"

    def recognises(self, path: Path, head: bytes) -> bool:
        return len(head) > 5 and head[0] == MAGIC and head[1:3] in (b"\x01\x00", b"\x02\x00")

    def read(self, path: Path, request: Request) -> Recording:
        data = path.read_bytes()
        notes = []
        with reading("uSD log"):
            types, start, scale = _header(data)
        end = len(data) - 4
        if end < start or zlib.crc32(data[:end]) != int.from_bytes(data[end:], "little"):
            what = "the uSD log's checksum does not match: it is damaged or breaks off"
            notes.append(broken_off(what, request, remedy=" (stop logging before power is cut)"))
            end = len(data)
        with reading("uSD log"):
            variables = _variables(data, start, end, types, scale)
            streams, missing = crazyflie_streams(variables, request)
        return Recording({"": tuple(streams)}, tuple(missing), tuple(notes))


def _header(data: bytes) -> tuple[dict[int, np.dtype], int, float]:
    """Event types by id, where events begin, and the unit of times [s]."""
    version, count = struct.unpack_from("<HH", data, 1)
    clock, scale = TICKS[version]
    at, types = 5, {}
    for _ in range(count):
        (number,) = struct.unpack_from("<H", data, at)
        _, at = _text(data, at + 2)  # the event's name
        (size,) = struct.unpack_from("<H", data, at)
        at += 2
        row = [(NUMBER, "<u2"), (TIME, f"<{clock}")]
        for _ in range(size):
            text, at = _text(data, at)
            variable, _, kind = text.rstrip(")").rpartition("(")
            row.append((variable, f"<{KINDS[kind]}"))
        types[number] = np.dtype(row)
    return types, at, scale


def _text(data: bytes, at: int) -> tuple[str, int]:
    """The text that ends at the next zero, and the place after it."""
    end = data.index(0, at)
    return data[at:end].decode("utf-8"), end + 1


def _variables(
    data: bytes, start: int, end: int, types: dict[int, np.dtype], scale: float
) -> dict[str, pd.Series]:
    """Every variable over time; the first event type that holds one counts."""
    places: dict[int, list[int]] = {number: [] for number in types}
    at = start
    while at + 2 <= end:
        number = data[at] | data[at + 1] << 8
        if number not in types or at + types[number].itemsize > end:
            break  # a whole log has a checksum, so that this is where one breaks off
        size = types[number].itemsize
        places[number].append(at)
        at += size
    raw = np.frombuffer(data, np.uint8)
    found: dict[str, pd.Series] = {}
    for number, kind in types.items():
        if not places[number]:
            continue
        index = np.asarray(places[number])[:, None] + np.arange(kind.itemsize)
        rows = raw[index].reshape(-1).view(kind)
        t = rows[TIME].astype(np.float64) * scale
        for name in kind.names or ():
            if name not in (NUMBER, TIME):
                found.setdefault(name, pd.Series(rows[name].astype(np.float64), t))
    return found
