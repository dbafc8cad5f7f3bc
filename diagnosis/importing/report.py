"""The report of an import: what was taken from where, and what was not there."""

import dataclasses
import re
from collections.abc import Mapping, Sequence

from diagnosis.importing.resample import Rows, Taken
from diagnosis.logs.flights import LeftOut

HEADINGS = ("columns", "taken from", "units and frames", "logged at", "rows", "longest hole")
"""Columns of a drone's table."""


@dataclasses.dataclass(frozen=True)
class ImportedFlight:
    """One flight, and where it came from."""

    name: str
    source: str
    """Name of the file or folder."""
    label: str
    """Its format in words."""
    drones: Mapping[str, Rows]
    """Rows of each drone by its name in the log."""
    missing: tuple[str, ...]
    notes: tuple[str, ...]


@dataclasses.dataclass(frozen=True)
class Imported:
    """What became of the sources."""

    flights: tuple[ImportedFlight, ...]
    left_out: tuple[LeftOut, ...]


def import_report(found: Imported) -> str:
    """The report as Markdown."""
    parts = [
        "# What was imported",
        "World frame: z up. Body frame: x forward, y left, z up. SI units. Times count from the "
        "first message of each log.",
    ]
    for flight in found.flights:
        parts += _flight(flight)
    if found.left_out:
        parts += ["## Left out", _lines([left.reason for left in found.left_out])]
    return "\n\n".join(parts) + "\n"


def summary(flight: ImportedFlight) -> str:
    """One line about a flight."""
    rows = next(iter(flight.drones.values()))
    t = rows.columns["t"]
    inputs = [taken.field for taken in rows.taken if taken.field in _INPUTS]
    notes = len(flight.notes) + sum(len(rows.notes) for rows in flight.drones.values())
    drones = f", {len(flight.drones)} drones" if len(flight.drones) > 1 else ""
    said = f"; {notes} notes in the report" if notes else ""
    return (
        f"{flight.name}: {flight.label}{drones}, {t[-1] - t[0]:.1f} s, {len(t)} rows, "
        f"driven by {' and '.join(inputs)}{said}"
    )


_INPUTS = ("cmd_angles", "cmd_thrust", "rotor_vel", "pwm")
"""Fields that drive a replay."""


def _flight(flight: ImportedFlight) -> list[str]:
    parts = [f"## {_text(flight.name)}", f"{flight.label}, `{_text(flight.source)}`."]
    for name, rows in flight.drones.items():
        t = rows.columns["t"]
        who = f"Drone `{_text(name)}`: " if name else ""
        parts.append(f"{who}{len(t)} rows over {t[-1] - t[0]:.2f} s.")
        parts.append(_table(rows))
        parts += [_lines(rows.notes)] if rows.notes else []
    if flight.notes or flight.missing:
        parts.append(_lines([*flight.notes, *flight.missing]))
    return parts


def _table(rows: Rows) -> str:
    cells = [HEADINGS, *((":---",) * len(HEADINGS),), *(_cells(taken) for taken in rows.taken)]
    return "\n".join("| " + " | ".join(row) + " |" for row in cells)


def _cells(taken: Taken) -> tuple[str, ...]:
    rows = taken.resampling + (f", {taken.dropped} empty or dropped" if taken.dropped else "")
    return (
        taken.field,
        _text(taken.source),
        _text(taken.change),
        f"{taken.rate:.4g} Hz",
        rows,
        f"{taken.hole:.3g} s",
    )


def _lines(texts: Sequence[str]) -> str:
    return "\n".join(f"- {_text(text)}" for text in texts)


def _text(text: str) -> str:
    """A text of a log, harmless in Markdown."""
    flat = re.sub(r"[\x00-\x1f\x7f\u2028\u2029]+", " ", text)
    return re.sub(r"([|`<>])", r"\\\1", flat)
