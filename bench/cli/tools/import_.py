"""`bench import`: logs of autopilots and of ROS, in the format that `bench diagnose` reads."""

import json
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Annotated

from bench.cli.checks import check_files
from bench.cli.options import Repeatable
from bench.text.errors import UsageError
from bench.text.words import clean
from diagnosis.logs.vehicle_file import parse_vehicle


def import_(
    *sources: Path,
    out: Path | None = None,
    vehicle: Path | None = None,
    drone: str | None = None,
    mass: float | None = None,
    format: str | None = None,
    full_thrust: float | None = None,
    topic: Annotated[list[str] | None, Repeatable] = None,
    columns: Path | None = None,
    truncated: Annotated[bool, Repeatable] = False,
    above: float | None = None,
    recipe: str | None = None,
) -> int:
    """Bring flight logs into the format that `bench diagnose` reads, with a report.

    Reads PX4 ULog, ROS 1 and 2 bags and MCAP, ArduPilot DataFlash, Crazyflie uSD logs and CSV, and
    any table that a columns.toml describes; a source's content tells its format. Writes the folder
    --out whole or not at all: vehicle.toml, flights/NAME.parquet and import.md. A log that cannot
    be used is left out with one line.

    Parameters
    ----------
    sources
        Log files; or folders: a ROS 2 bag, the CSV files of one Crazyflie flight, several logs.
    out
        Folder to write; it must be new or empty.
    vehicle
        A vehicle.toml to copy, instead of --drone and --mass.
    drone
        Airframe, such as cf21B_500.
    mass
        Mass of the vehicle, as you believe it [kg].
    format
        Format of all sources, if their content does not tell it: ulog, ros, ardupilot, usd, cflib,
        table.
    full_thrust
        Thrust of all rotors together at the largest command [N]. Default: computed from the logged
        hover thrust (PX4, ArduPilot), or the airframe's (Crazyflie).
    topic
        ROS topic to read a field from, if several could hold it, such as vel=/cf1/twist; may be
        repeated.
    columns
        The columns.toml that describes a table; default: the one beside the table.
    truncated
        Use the beginning of a file that breaks off, instead of refusing it.
    above
        Leave out take-off and landing: all that is at most this far above the lowest height of a
        log, such as 0.5 [m].
    recipe
        Print which quantities to log, for crazyflie or px4, and do nothing else.
    """
    if recipe is not None:
        if sources:
            raise UsageError(
                "Leave out the sources: --recipe prints what to log, and reads nothing."
            )
        return _print_recipe(recipe)
    if not sources or out is None:
        raise UsageError("Give at least one log, and the folder to write with --out.")
    if (vehicle is None) == (drone is None and mass is None):
        raise UsageError("Give either --vehicle FILE, or --drone and --mass.")
    if vehicle is None and (drone is None or mass is None):
        raise UsageError(
            "Give --drone and --mass together, such as --drone cf21B_500 --mass 0.0434."
        )
    check_files([*sources, *(path for path in (vehicle, columns) if path is not None)])
    if full_thrust is not None and not 0.0 < full_thrust < 1e4:
        raise UsageError(f"`--full-thrust` must be above 0 N, got {full_thrust:g}.")
    if above is not None and not 0.0 <= above < 1e4:
        raise UsageError(f"`--above` must be at least 0 m, got {above:g}.")
    text = _vehicle(out, vehicle, drone, mass)
    parse_vehicle(text, "vehicle.toml")
    from diagnosis.importing.convert import import_logs
    from diagnosis.importing.report import summary

    found = import_logs(
        sources,
        out,
        text,
        kind=format,
        full_thrust=full_thrust,
        topics=_topics(topic or ()),
        columns=columns,
        truncated=truncated,
        above=above,
    )
    for left in found.left_out:
        print(f"bench: left out: {clean(left.reason)}", file=sys.stderr)  # noqa: T201
    for flight in found.flights:
        print(clean(summary(flight)))  # noqa: T201
    print(f"What was taken from where: {clean(out / 'import.md')}")  # noqa: T201
    print(f"Next: bench diagnose {clean(out)}")  # noqa: T201
    return 0


def _vehicle(out: Path, vehicle: Path | None, drone: str | None, mass: float | None) -> str:
    """The text of vehicle.toml."""
    if vehicle is None:
        name = json.dumps(out.resolve().name, ensure_ascii=False)
        return f"name = {name}\ndrone = {json.dumps(drone)}\nmass = {mass!r}\n"
    try:
        return vehicle.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"--vehicle {vehicle} cannot be read: {error}") from error


def _topics(given: Sequence[str]) -> dict[str, tuple[str, ...]]:
    """Field -> topics."""
    from diagnosis.importing.bags import NAMED
    from diagnosis.importing.reader import FIELDS

    found: dict[str, tuple[str, ...]] = {}
    for text in given:
        match = NAMED.fullmatch(text)
        if match is None:
            raise UsageError(
                f"`--topic` must be FIELD=/TOPIC with one of {', '.join(FIELDS)}, got '{text}'."
            )
        found[match[1]] = (*found.get(match[1], ()), match[2])
    return found


def _print_recipe(name: str) -> int:
    """Prints a logging configuration."""
    from diagnosis.importing import crazyflie, ulog

    recipes = {"crazyflie": crazyflie.RECIPE, "px4": ulog.RECIPE}
    if name not in recipes:
        raise UsageError(f"`--recipe` must be {' or '.join(recipes)}, got '{name}'.")
    print(recipes[name], end="")  # noqa: T201
    return 0
