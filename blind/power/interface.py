"""How often faults of logs are named by the check of the interface, on flights that were drawn.

    python -m blind.power.interface DRAW [DRAW ...]

`DRAW` is a folder that `bench blind` wrote, with its flights (`runs/cases`). Each set of flights is
read as it is, and once with every fault of order, sign, frame or unit that its columns can have,
and with those of `SIZED`. Each time the flights are written to files and read back. A fault counts
as named if the check names one of its parts, or if the files are refused with the reason. The first
table counts sets of which something is said without a fault, by what acts on the drone.
"""

import argparse
import collections
import dataclasses
import sys
import tempfile
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

import numpy as np
from rich.progress import track

from blind.draw.cases import Case, read_labels
from blind.draw.catalogue import Parameters
from blind.draw.faults import ALL, ONE_SIZE
from blind.draw.folders import Folders
from blind.score.scoring import proportion
from diagnosis.interface.faults import interface_faults
from diagnosis.logs.flights import FlightSet, LogError, load_flights, write_flights


@dataclasses.dataclass(frozen=True)
class Put:
    """A fault that is put into logs."""

    fault: str
    """Name in `blind.draw.faults`."""
    parameters: Parameters
    """Its numbers."""
    parts: tuple[str, ...]
    """Parts of the interface by which it is named."""


SIZED: Mapping[str, Put] = {
    **{
        f"path turned by {degrees} degrees": Put(
            "path_turned_in_yaw", {"angle": float(np.radians(degrees))}, ("frame of the path",)
        )
        for degrees in (10, 20, 45)
    },
    **{
        f"commands turned by {degrees} degrees": Put(
            "tilt_turned_in_yaw",
            {"angle": float(np.radians(degrees))},
            ("frame of the commands", "attitude command"),
        )
        for degrees in (20, 45)
    },
    "commands stamped 0.2 s late": Put("clock_offset", {"seconds": 0.2}, ("command clock",)),
    "half of the thrust logged": Put("thrust_gain", {"e": 1.0}, ("thrust",)),
}
"""Faults of a size that no effect describes, or only at the end of its range."""
PUT: Mapping[str, Put] = {
    **{name: Put(name, {}, f.parts) for name, f in ALL.items() if f.sizes == ONE_SIZE},
    **SIZED,
}
"""Every fault."""


@dataclasses.dataclass(frozen=True)
class Said:
    """What is said of one set of flights."""

    kind: str
    """What was drawn: `clean`, `single` and so on."""
    fault: str
    """Name of the fault in its logs; empty for none."""
    parts: frozenset[str]
    """Parts of the interface that are called wrong."""
    refused: bool
    """Whether the files cannot be read."""

    @property
    def named(self) -> bool:
        """Whether the fault is named, or the files are refused."""
        return self.refused or bool(self.parts & {*PUT[self.fault].parts})


def say(kind: str, name: str, flights: FlightSet) -> Said:
    """What is said of flights with a fault; files are written and read again."""
    changed = flights
    if name:
        changed = ALL[PUT[name].fault].apply(flights, PUT[name].parameters)
    with tempfile.TemporaryDirectory() as folder:
        write_flights(Path(folder), changed.vehicle, changed.flights)
        try:
            found = interface_faults(load_flights(Path(folder)))
        except LogError:
            return Said(kind, name, frozenset(), True)
    return Said(kind, name, frozenset(fault.part for fault in found), False)


def say_all(kind: str, flights: FlightSet) -> Iterable[Said]:
    """What is said of flights as they are, and with every fault that they can have."""
    yield say(kind, "", flights)
    for name, put in PUT.items():
        if ALL[put.fault].fits(flights):
            yield say(kind, name, flights)


def write_tables(said: Sequence[Said]) -> str:
    """The tables of false alarms and of named faults, in Markdown."""
    plain = [one for one in said if not one.fault]
    lines = ["| flown with | sets | of which something is said | parts |", "|---|---|---|---|"]
    for kind in dict.fromkeys(one.kind for one in plain):
        own = [one for one in plain if one.kind == kind]
        wrong = [one for one in own if one.parts or one.refused]
        parts = collections.Counter(part for one in wrong for part in one.parts)
        listed = ", ".join(f"{part} ({n})" for part, n in parts.most_common())
        lines.append(
            f"| {kind} | {len(own)} | {proportion(len(wrong), len(own)).text(1)} | {listed} |"
        )
    lines += ["", "| fault | named, or refused | instead |", "|---|---|---|"]
    for name in PUT:
        own = [one for one in said if one.fault == name]
        if not own:
            continue
        missed = collections.Counter(
            " + ".join(sorted(one.parts)) or "nothing" for one in own if not one.named
        )
        instead = ", ".join(f"{parts} ({n})" for parts, n in missed.most_common())
        named = proportion(sum(one.named for one in own), len(own)).text(1)
        lines.append(f"| {name} | {named} | {instead} |")
    return "\n".join(lines)


def main() -> None:
    """Prints the tables of some draws."""
    parser = argparse.ArgumentParser(prog="python -m blind.power.interface", description=__doc__)
    parser.add_argument("draws", type=Path, nargs="+", help="folders that bench blind wrote")
    said: list[Said] = []
    for draw in parser.parse_args().draws:
        labels = read_labels(Folders(draw).labels, Case.of)
        for name, case in track(labels.items(), f"checking {draw.name}"):
            flights = load_flights(Folders(draw).cases / name)
            said += say_all(case.kind, flights)
    sys.stdout.write(f"{write_tables(said)}\n")


if __name__ == "__main__":
    main()
