"""Parameters of PX4 as QGroundControl saves them: read, and written with a remedy in them.

A line holds vehicle, component, name, value and type, with tabs between; 9 is a float, 6 an integer
(MAV_PARAM_TYPE of MAVLink).
"""

import math
from collections.abc import Mapping
from pathlib import Path

from bench.text.errors import UsageError

_INTEGERS = ("1", "2", "3", "4", "5", "6", "7", "8")
"""Types that hold integers."""


def read_params(path: Path) -> dict[str, float]:
    """Values by name.

    Raises:
        UsageError: The file is no parameter file of QGroundControl.
    """
    return {name: value for name, (value, _) in _rows(path).items()}


def changed_params(path: Path, new: Mapping[str, float]) -> str:
    """A file of the parameters in `new` alone, types as in the file at `path`."""
    rows = _rows(path)
    lines = ["# Vehicle-Id Component-Id Name Value Type"]
    for name, value in new.items():
        kind = rows[name][1]
        text = str(round(value)) if kind in _INTEGERS else f"{value:.9g}"
        lines.append("\t".join(("1", "1", name, text, kind)))
    return "\n".join(lines) + "\n"


def _rows(path: Path) -> dict[str, tuple[float, str]]:
    rows = {}
    try:
        lines = path.read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise UsageError(f"{path} cannot be read: {error}.") from None
    for number, line in enumerate(lines, 1):
        if not line.strip() or line.startswith("#"):
            continue
        try:
            _, _, name, value, kind = line.split()
            rows[name] = (float(value), kind)
            if not math.isfinite(rows[name][0]):
                raise ValueError
        except ValueError:
            raise UsageError(
                f"{path}, line {number}: vehicle, component, name, value and type are expected, "
                "as QGroundControl saves parameters (Vehicle Setup, Parameters, Tools, Save); the "
                "value must be finite."
            ) from None
    if not rows:
        raise UsageError(f"{path} holds no parameter.")
    return rows
