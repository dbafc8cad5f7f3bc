"""Columns of a log file: what the format calls them, and which of them a file must have.

| column | unit | |
|---|---|---|
| `t` | s | increases from row to row (per drone) |
| `drone` | - | integer; where several drones share a flight |
| `pos_*`, `vel_*` | m, m/s | world frame, z up |
| `quat_*` | - | body to world, scalar last |
| `ang_vel_*` | rad/s | body frame; optional |
| `acc_*` | m/s^2 | specific force, body frame; optional |
| `cmd_roll`, `cmd_pitch`, `cmd_yaw`, `cmd_thrust` | rad, N | commanded attitude and thrust |
| `rotor_vel_*` | rad/s | measured rotor speeds |
| `pwm_*`, `battery` | 0 to 1, V | motor duty commands, and voltage |
| `interpolated` | 0, 1 | 1: position and velocity of this row lie between measurements |

Other columns are ignored. A group is there with all of its columns or with none of them, but
`cmd_thrust` may stand alone. Nothing here takes long to import: commands check names first.
"""

import csv
import dataclasses
import difflib
from collections.abc import Iterable, Sequence
from pathlib import Path

from simulators import registry

GROUPS = {
    "pos": ("pos_x", "pos_y", "pos_z"),
    "vel": ("vel_x", "vel_y", "vel_z"),
    "quat": ("quat_x", "quat_y", "quat_z", "quat_w"),
    "ang_vel": ("ang_vel_x", "ang_vel_y", "ang_vel_z"),
    "acc": ("acc_x", "acc_y", "acc_z"),
    "cmd": ("cmd_roll", "cmd_pitch", "cmd_yaw", "cmd_thrust"),
    "rotor_vel": ("rotor_vel_1", "rotor_vel_2", "rotor_vel_3", "rotor_vel_4"),
    "pwm": ("pwm_1", "pwm_2", "pwm_3", "pwm_4"),
}
"""Columns that belong together, by the name of the field that holds them."""

ANGLES = GROUPS["cmd"][:3]
"""Columns of commands that may be missing beside the thrust."""

REQUIRED = ("t", *GROUPS["pos"], *GROUPS["vel"], *GROUPS["quat"])
"""Columns without which nothing can be said about a flight."""

KNOWN = (
    "t",
    "drone",
    *(name for group in GROUPS.values() for name in group),
    "battery",
    "interpolated",
)
"""Every column that is read."""

LIKENESS = 0.6
"""Least ratio of `difflib.SequenceMatcher` at which a name is taken for another; its default."""

SEPARATORS = {";": "semicolons", "\t": "tabs", "|": "bars"}
"""What separates the columns of other tables."""


class LogError(ValueError):
    """Logs that cannot be used; the message is one line for each thing that is wrong."""


@dataclasses.dataclass(frozen=True)
class LeftOut:
    """A file, a flight or a part of it that does not count."""

    name: str
    """The file's name with its ending, or the flight's."""
    reason: str
    """One line: the file, where in it, what is wrong, what is expected."""


def did_you_mean(name: str, known: Iterable[str]) -> str:
    """A question after the name in `known` that `name` is close to, empty where none is."""
    return registry.did_you_mean(name, known, likeness=LIKENESS)


def one_line(error: Exception) -> str:
    """The message of an error of another library, in one line without a full stop."""
    text = (getattr(error, "strerror", None) or str(error)).strip()
    return " ".join(text.split()).rstrip(".") or type(error).__name__


def read_header(path: Path) -> list[str]:
    """The column names of a CSV file.

    Raises:
        LogError: It is no text, or its columns are not separated by commas. The message does not
            name the file.
    """
    try:
        with path.open(newline="", encoding="utf-8-sig") as file:
            rows = csv.reader(file)
            names = [name.strip() for name in next(rows, [])]
            alone = names[0] if len(names) == 1 else ""
            other = next((word for sign, word in SEPARATORS.items() if sign in alone), None)
            split = len(next(rows, [])) > 1 if other else False  # by its decimal commas
    except (UnicodeDecodeError, csv.Error) as error:
        raise LogError("this is not a CSV file (UTF-8 text), though its name ends in .csv.") from (
            error
        )
    if other:
        points = " Numbers need decimal points, such as 1.5." if split else ""
        raise LogError(f"The columns must be separated by commas, not {other}.{points}")
    return names


def check_names(names: Sequence[str]) -> list[str]:
    """The known ones among a file's column names.

    Raises:
        LogError: A required column is missing, a group is incomplete, a name stands twice, or
            there is no complete input.
    """
    known = [name for name in names if name in KNOWN]
    extra = [name for name in names if name not in KNOWN]
    twice = [name for name in known if known.count(name) > 1]
    if twice:
        raise LogError(f"column '{twice[0]}' is there twice; each may be there once.")
    missing = [name for name in REQUIRED if name not in known]
    if missing:
        raise LogError(f"{_missing(missing, extra)} Required: {', '.join(REQUIRED)}.")
    for group in GROUPS.values():
        lacking = [name for name in group if name not in known]
        misspelt = any(_misspelt(name, extra) for name in lacking)
        if 0 < len(lacking) < len(group) and (misspelt or lacking != list(ANGLES)):
            there = ", ".join(name for name in group if name in known)
            raise LogError(
                f"{_missing(lacking, extra)} With {there} alone the group is incomplete: "
                f"all of its columns are expected, or none."
            )
    if not {"cmd_thrust", "rotor_vel_1"} & set(known):
        if "pwm_1" in known and "battery" not in known:
            raise LogError(f"{_missing(['battery'], extra)} pwm_* is an input only with it.")
        if "pwm_1" not in known:
            hints = [_misspelt(name, extra) for key in ("cmd", "pwm") for name in GROUPS[key]]
            raise LogError(
                "no input is there: cmd_roll, cmd_pitch, cmd_yaw and cmd_thrust are expected, or "
                "cmd_thrust alone, or rotor_vel_1 to rotor_vel_4, or pwm_1 to pwm_4 with battery."
                + next(filter(None, hints), "")
            )
    return known


def _missing(missing: Sequence[str], extra: Sequence[str]) -> str:
    """Which columns are missing, and what was probably meant."""
    if len(missing) == 1:
        text = f"column '{missing[0]}' is missing."
    else:
        text = f"columns {', '.join(repr(name) for name in missing)} are missing."
    return text + next(filter(None, (_misspelt(name, extra) for name in missing)), "")


def _misspelt(name: str, extra: Sequence[str]) -> str:
    """A question whether an unknown column is the one called `name`; empty if none is like it."""
    close = difflib.get_close_matches(name, sorted(extra), n=1, cutoff=LIKENESS)
    return f" There is a column '{close[0]}': did you mean '{name}'?" if close else ""
