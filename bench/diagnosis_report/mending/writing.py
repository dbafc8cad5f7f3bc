"""Writes the folder of a remedy beside a diagnosis: what to change, and what to fly next."""

from pathlib import Path

from bench.diagnosis_report.documents import NAMES, write_files
from bench.diagnosis_report.mending.flight_files import (
    mission,
    polynomial_csv,
    setpoint_csv,
    way_points,
)
from bench.diagnosis_report.mending.patch import patch_text
from bench.diagnosis_report.mending.px4_params import changed_params, read_params
from bench.diagnosis_report.mending.remedy_text import flight_lines, remedy_text
from bench.diagnosis_report.sentences import logs_first
from diagnosis.decide.advice import pair_to_separate
from diagnosis.remedies.changes import firmware_changes
from diagnosis.remedies.flight_paths import GENERAL
from diagnosis.remedies.trajectory import Geofence, Trajectory, plan
from diagnosis.result import Diagnosis
from simulators.effects.card import manoeuvre_path


def write_remedy(
    diagnosis: Diagnosis,
    out: Path,
    target: str,
    geofence: Geofence,
    home: tuple[float, float] | None = None,
    parameters: Path | None = None,
) -> Path:
    """Writes the folder `remedy-TARGET` in `out`, all files or none, and returns it.

    Args:
        diagnosis: What was found.
        out: Folder of the diagnosis.
        target: Key of `remedy_text.TARGETS`.
        geofence: Where the next flight must stay.
        home: Latitude and longitude [degrees] of the geofence's middle, for a mission of PX4.
        parameters: PX4's parameters as QGroundControl saves them.

    Raises:
        UsageError: `out` cannot be written to, or `parameters` cannot be read.
    """
    folder = out / f"remedy-{target}"
    values = read_params(parameters) if parameters else {}
    pair = pair_to_separate({effect.name: effect.aliases for effect in diagnosis.blamed})
    path = manoeuvre_path(*pair) if pair else None
    texts, lines = {}, [NO_FLIGHT]
    if not logs_first(diagnosis):
        trajectory = plan(path or GENERAL, geofence)
        texts = _flight(trajectory, target, geofence, home)
        lines = flight_lines(diagnosis, trajectory, geofence, pair if path else None)
        if home and "next_flight.plan" not in texts:
            lines.append("No mission is written: the path stays within a metre. Fly the setpoints.")
    new = _new_values(diagnosis, values) if parameters else {}
    unwritten = UNWRITTEN if parameters and not new and firmware_changes(diagnosis, target) else ""
    texts["remedy.md"] = remedy_text(diagnosis, target, values, lines, unwritten)
    if target == "crazyflow" and diagnosis.effects:
        texts["params.toml"] = patch_text(diagnosis)
    if parameters and new:
        texts["changed.params"] = changed_params(parameters, new)
    write_files(folder, texts)
    for name in FILES:
        if name not in texts:
            (folder / name).unlink(missing_ok=True)  # of an earlier remedy
    return folder


UNWRITTEN = (
    "No changed.params is written: what would change is descriptive, waits, is not among the "
    "parameters that were given, or would be a share beyond 0 to 1."
)
"""What is said where parameters were given and none of them gets a new value."""
NO_FLIGHT = "No flight is written: mend the logs first, and diagnose the flights again."
"""What stands in the place of the next flight."""
FILES = (
    "remedy.md",
    "params.toml",
    "changed.params",
    "next_flight.csv",
    "next_flight_setpoints.csv",
    "next_flight.plan",
)
"""What the folder of a remedy may hold."""


def _flight(
    trajectory: Trajectory, target: str, geofence: Geofence, home: tuple[float, float] | None
) -> dict[str, str]:
    """Files of the next flight, by name."""
    if target != "px4":
        return {"next_flight.csv": polynomial_csv(trajectory)}
    texts = {"next_flight_setpoints.csv": setpoint_csv(trajectory)}
    if home and len(way_points(trajectory)) > 1:
        texts["next_flight.plan"] = mission(trajectory, geofence, home)
    return texts


def load_diagnosis(path: Path) -> tuple[Diagnosis, Path]:
    """The diagnosis in a folder or in its `diagnosis.json`, and the folder.

    Raises:
        ValueError: The file is no diagnosis.
    """
    file = path / NAMES[0] if path.is_dir() else path
    return Diagnosis.load(file), file.parent


def _new_values(diagnosis: Diagnosis, values: dict[str, float]) -> dict[str, float]:
    """New values of the parameters in `values` that are measured and wait for nothing.

    Changes of one parameter that hold on different vehicles are left to the reader, as are shares
    that would not lie between 0 and 1.
    """
    new: dict[str, float] = {}
    changes = firmware_changes(diagnosis, "px4")
    for change in changes:
        if change.descriptive or change.waits_for:
            continue
        for name in change.parameters:
            where = {other.where for other in changes if name in other.parameters}
            if name in values and where == {change.where}:
                new[name] = change.of(new.get(name, values[name]))
                if change.share and not 0.0 < new[name] < 1.0:
                    del new[name]
    return new
