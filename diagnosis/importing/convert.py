"""Sources in any known format become a folder of flights: all of it or nothing.

The folder is built beside its place, read back by the diagnosis's own checks, and only then takes
its place. A source that cannot be used is left out with one line that says why.
"""

import dataclasses
import re
import shutil
import tempfile
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from diagnosis.importing.airborne import airborne, with_hint
from diagnosis.importing.ardupilot import ArdupilotReader
from diagnosis.importing.bags import BagReader
from diagnosis.importing.crazyflie import CrazyflieCsvReader
from diagnosis.importing.reader import HEAD_BYTES, AbstractReader, Recording, Request
from diagnosis.importing.report import Imported, ImportedFlight, import_report
from diagnosis.importing.resample import Rows, make_rows
from diagnosis.importing.tables import TableReader
from diagnosis.importing.ulog import UlogReader
from diagnosis.importing.usd import UsdReader
from diagnosis.logs.columns import LogError, did_you_mean
from diagnosis.logs.flights import LeftOut, load_flights, read_vehicle
from diagnosis.logs.units import cells

READERS: Mapping[str, AbstractReader] = {
    reader.name: reader
    for reader in (
        TableReader(),
        UlogReader(),
        ArdupilotReader(),
        BagReader(),
        UsdReader(),
        CrazyflieCsvReader(),
    )
}
"""Every reader by the name of its format; the first that recognises a source reads it. A table with
a columns.toml comes first, because the operator said what it holds."""


def import_logs(
    sources: Sequence[Path], out: Path, vehicle: str, *, kind: str | None = None, **asked: Any
) -> Imported:
    """Writes `out` with vehicle.toml, one Parquet file a flight, and the report import.md.

    Args:
        sources: Log files, or folders: a ROS 2 bag, one flight's CSV files, or several logs.
        out: The folder; must not be there, or be empty.
        vehicle: Text of vehicle.toml.
        kind: Name of the format of all sources; without it, each source's content tells.
        asked: Further fields of `Request`.

    Raises:
        LogError: No source is usable, or vehicle.toml is wrong; one line for each reason.
    """
    if out.exists() and (not out.is_dir() or any(out.iterdir())):
        raise LogError(f"{out}: is there already; a new or an empty folder is expected.")
    ground = next(place for place in out.absolute().parents if place.exists())
    part = Path(tempfile.mkdtemp(prefix=f".{out.name}.", dir=ground))
    try:
        (part / "vehicle.toml").write_text(vehicle, encoding="utf-8")
        try:
            said = read_vehicle(part)
        except LogError as error:  # the operator knows nothing of the folder that is built
            raise LogError(str(error).replace(f"{part}/", "")) from None
        request = Request(mass=said.mass, thrust_max=said.spec.thrust_max, **asked)
        found = _import_all(sources, part, kind, request)
        (part / "import.md").write_text(import_report(found), encoding="utf-8")
        part.chmod(0o755)  # a temporary folder is private
        if out.is_dir():
            out.rmdir()
        out.parent.mkdir(parents=True, exist_ok=True)
        part.replace(out)
    except BaseException:
        shutil.rmtree(part, ignore_errors=True)
        raise
    return found


def _import_all(
    sources: Sequence[Path], part: Path, kind: str | None, request: Request
) -> Imported:
    """All usable flights, written to the folder `part` and checked there.

    Raises:
        LogError: There is none.
    """
    folder = part / "flights"
    folder.mkdir()
    flights: dict[str, ImportedFlight] = {}
    left_out = []
    for source in _expanded(sources, request):
        try:
            name = _free_name(source, flights)
            flight, table = _import_one(source, name, kind, request)
            table.to_parquet(folder / f"{name}.parquet", index=False)
            flights[name] = flight
        except (LogError, OSError) as error:
            left_out.append(LeftOut(source.name, " ".join(f"{source}: {error}".split())))
    checked = _checked(part) if flights else ()
    for bad in checked:
        name = bad.name.removesuffix(".parquet")
        (folder / bad.name).unlink()
        reason = bad.reason.removeprefix(f"flights/{bad.name}: ")
        left_out.append(LeftOut(flights[name].source, f"{flights.pop(name).source}: {reason}"))
    if not flights:
        reasons = [left.reason for left in left_out] or ["no source was given."]
        raise LogError("\n".join(reasons))
    return Imported(tuple(flights.values()), tuple(left_out))


def _checked(part: Path) -> tuple[LeftOut, ...]:
    """The flights that the diagnosis would not take."""
    try:
        return load_flights(part).left_out
    except LogError as error:
        # Not one is usable: each line begins with the file that it is about.
        lines = [line.removeprefix(f"{part}/") for line in str(error).splitlines()]
        return tuple(LeftOut(Path(line.partition(":")[0]).name, line) for line in lines)


def _expanded(sources: Sequence[Path], request: Request) -> list[Path]:
    """Sources, with the files of a folder that is none itself.

    Raises:
        LogError: One is not there, or an empty folder.
    """
    found = []
    for source in sources:
        if not source.exists():
            raise LogError(f"{source}: there is no such file or folder.")
        if not source.is_dir() or _reader_of(source) is not None:
            found.append(source)
            continue
        inside = sorted(p for p in source.iterdir() if not p.name.startswith("."))
        inside = [p for p in inside if p.suffix.lower() not in (".toml", ".md", ".txt")]
        if not inside:
            raise LogError(f"{source}: the folder holds no log.")
        found += inside
    return found


def _reader_of(source: Path, tables: bool = False) -> AbstractReader | None:
    """The reader that recognises a source by its content."""
    head = b""
    if source.is_file():
        with source.open("rb") as file:
            head = file.read(HEAD_BYTES)
        if tables and source.suffix.lower() in (".csv", ".parquet"):
            return READERS["table"]
    return next((reader for reader in READERS.values() if reader.recognises(source, head)), None)


def _free_name(source: Path, taken: Mapping[str, ImportedFlight]) -> str:
    """A name for a flight that names a file and is not taken."""
    stem = source.name if source.is_dir() else source.stem
    name = re.sub(r"[^\w.-]+", "_", stem, flags=re.ASCII).lstrip(".-") or "flight"
    names = (name, *(f"{name}_{i}" for i in range(2, len(taken) + 3)))
    return next(free for free in names if free not in taken)


def _import_one(
    source: Path, name: str, kind: str | None, request: Request
) -> tuple[ImportedFlight, pd.DataFrame]:
    """One flight and its table.

    Raises:
        LogError: The source cannot be used; the message does not name it.
    """
    if source.is_file() and source.stat().st_size == 0:
        raise LogError("the file is empty (0 bytes).")
    if kind is not None and kind not in READERS:
        hint = did_you_mean(kind, READERS)
        raise LogError(f"`--format` is '{kind}'.{hint} Allowed: {', '.join(READERS)}.")
    reader = READERS[kind] if kind else _reader_of(source, request.columns is not None)
    if reader is None:
        labels = ", ".join(reader.label for reader in READERS.values())
        raise LogError(f"its content is of no known format ({labels}).")
    recording = reader.read(source, request)
    drones = _rows(recording, request.above)
    notes = list(recording.notes)
    if any("interpolated" in rows.columns for rows in drones.values()):
        for rows in drones.values():
            rows.columns.setdefault("interpolated", np.zeros(len(rows.columns["t"])))
    shared = set.intersection(*(set(rows.columns) for rows in drones.values()))
    tables = []
    for number, rows in enumerate(drones.values()):
        lost = [column for column in rows.columns if column not in shared]
        if lost:
            notes.append(f"Not every drone logged {', '.join(lost)}; left out.")
        table = pd.DataFrame({c: v for c, v in rows.columns.items() if c in shared})
        if len(drones) > 1:
            table.insert(1, "drone", np.full(len(table), number))
        tables.append(table)
    flight = ImportedFlight(
        name, source.name, reader.label, drones, recording.missing, tuple(notes)
    )
    return flight, pd.concat(tables, ignore_index=True)


def _rows(recording: Recording, above: float | None) -> dict[str, Rows]:
    """Rows of every drone; the recording starts at zero.

    Raises:
        LogError: There is none, or one of them has no rows.
    """
    times = [s.t[np.isfinite(s.t)] for streams in recording.drones.values() for s in streams]
    starts = [t[0] for t in times if len(t)]
    if not starts:
        raise LogError(" ".join(["nothing that a diagnosis needs was found.", *recording.missing]))
    found = {}
    for name, streams in recording.drones.items():
        try:
            rows = _with_cells(make_rows(streams, float(min(starts))))
            found[name] = with_hint(rows) if above is None else airborne(rows, above)
        except LogError as error:
            raise LogError(f"drone '{name}': {error}" if name else str(error)) from error
    return found


def _with_cells(rows: Rows) -> Rows:
    """The same rows, with a note where the battery has several cells."""
    highest = float(np.max(rows.columns.get("battery", 0.0)))
    if (n_cells := cells(highest)) == 1:
        return rows
    note = (
        f"The battery's voltage of up to {highest:.3g} V is taken for that of {n_cells} cells in "
        "series; a diagnosis goes by the voltage of one cell."
    )
    return dataclasses.replace(rows, notes=(*rows.notes, note))
