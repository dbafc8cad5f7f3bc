"""The file vehicle.toml: what its text says, and what is wrong with it.

Nothing here takes long to import, so that commands can check the file before any work.
"""

import re
import tomllib
from pathlib import Path
from typing import Any, NamedTuple

from diagnosis.logs.columns import LogError, did_you_mean, one_line

MASSES = {
    "cf21B_500": 0.0434,
    "cf2x_L250": 0.0328,
    "cf2x_P250": 0.0318,
    "cf2x_T350": 0.0379,
    "crazyflie": 0.03,
    "crazyfliebrushless": 0.044,
    "hummingbird": 0.5,
    "px4_sihsim_quadx": 1.0,
}
"""Airframes that need no table `[airframe]`, and their masses [kg]. The first two are those of
`simulators.vehicle.VEHICLES`, here again because that module takes seconds to import."""
GRAVITY = 9.81
"""`simulators.vehicle.GRAVITY` [m/s^2], here again for the same reason."""
MASS_FACTOR = 3.0
"""How far the believed mass may be from the airframe's, as a factor; a guess, wider than any
payload, narrower than another unit."""
CARRIES = (1.1, 20.0)
"""Smallest and largest plausible thrust over weight [-]."""
LIMITS = {
    "thrust_max": (0.01, 1e4),
    "thrust_curve": (-1e3, 1e3),
    "attitude_lag": (1e-3, 2.0),
    "rotor_lag": (1e-3, 2.0),
    "inertia": (1e-7, 1e2),
    "arm": (5e-3, 5.0),
    "drag": (0.0, 1e2),
}
"""Every key of a data sheet, and the range in which its numbers are taken for one."""
THREE = ("thrust_curve", "inertia", "drag")
"""Keys with three numbers."""


class VehicleText(NamedTuple):
    """What a vehicle.toml without errors says."""

    name: str
    """Free text."""
    drone: str
    """Name of the airframe."""
    mass: float
    """Mass that the operator believes [kg]."""
    airframe: dict[str, Any] | None = None
    """The numbers of `[airframe]` [SI]; tuples where there are three."""


def find_vehicle(path: Path) -> VehicleText:
    """What the vehicle.toml in a folder says.

    Raises:
        LogError: It is not there, or wrong; one line for each thing.
    """
    file = path / "vehicle.toml"
    if not file.is_file():
        hint = f" Did you mean {path.parent}?" if (path.parent / "vehicle.toml").is_file() else ""
        raise LogError(f"{file}: there is no such file; it says name, drone and mass.{hint}")
    try:
        text = file.read_text(encoding="utf-8-sig")
    except OSError as error:
        raise LogError(f"{file} cannot be read: {error.strerror}.") from error
    except UnicodeDecodeError as error:
        raise LogError(f"{file}: this is not TOML: {one_line(error)}.") from error
    return parse_vehicle(text, str(file))


def parse_vehicle(text: str, file: str) -> VehicleText:
    """What the text of a vehicle.toml says; errors name `file`.

    Raises:
        LogError: It is wrong; one line for each thing.
    """
    try:
        given = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise LogError(f"{file}: this is not TOML: {one_line(error)}.") from error
    keys = VehicleText._fields
    wrong = [
        f"unknown key '{key}'.{did_you_mean(key, keys)} Allowed: {', '.join(keys)}."
        for key in given
        if key not in keys
    ]
    wrong += [f"key '{key}' is missing; {_EXPECTED[key]}" for key in _EXPECTED if key not in given]
    wrong += [_wrong_value(key, given) for key in _EXPECTED if key in given]
    airframe = None
    if "airframe" in given:
        airframe, more = _airframe(given["airframe"], given.get("mass"))
        wrong += more
    if any(wrong):
        raise LogError("\n".join(f"{file}: {line}" for line in wrong if line))
    return VehicleText(given["name"], given["drone"], float(given["mass"]), airframe)


_EXPECTED = {
    "name": "a text that says what flew is expected.",
    "drone": f"an airframe is expected: {', '.join(sorted(MASSES))}, or another with a table "
    "[airframe] of its numbers.",
    "mass": "the mass in kg is expected.",
}
"""What each key of vehicle.toml is for."""


def _wrong_value(key: str, given: dict[str, object]) -> str:
    """What is wrong with the value of a key of vehicle.toml; empty if nothing is."""
    value = given[key]
    if key != "mass":
        if not isinstance(value, str):
            return f"key '{key}': got {value!r}; {_EXPECTED[key]}"
        if key == "drone" and "airframe" in given:
            return _wrong_own_name(value)
        if key == "drone" and value not in MASSES:
            return f"key 'drone': got '{value}'.{did_you_mean(value, MASSES)} {_EXPECTED[key]}"
        return ""
    if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) < 1e9:
        return f"key 'mass': got {value!r}; {_EXPECTED[key]}"
    if "airframe" in given:  # its thrust says what mass is plausible
        return "" if value > 0 else f"key 'mass': got {value:g}; {_EXPECTED[key]}"
    known = [mass for name, mass in MASSES.items() if name == given.get("drone")]
    low = min(known or MASSES.values()) / MASS_FACTOR
    high = max(known or MASSES.values()) * MASS_FACTOR
    if not low <= value <= high:
        grams = " Is it in grams?" if low <= value / 1000.0 <= high else ""
        return f"key 'mass': got {value:g}; {low:.3f} to {high:.3f} kg is plausible.{grams}"
    return ""


def _wrong_own_name(name: str) -> str:
    """What is wrong with the name of an airframe that has a table of its own; empty if nothing."""
    if name in MASSES:
        return f"key 'drone': '{name}' is known; leave out [airframe], or give another name."
    if not re.fullmatch(r"\w[\w.-]*", name):
        return f"key 'drone': got '{name}'; letters, digits, '_', '-' and '.' are expected."
    return ""


def _airframe(given: object, mass: object) -> tuple[dict[str, Any] | None, list[str]]:
    """The table `[airframe]` of vehicle.toml, and what is wrong with it, a text for each thing."""
    if not isinstance(given, dict):
        return None, [f"[airframe]: a table is expected, got {given!r}."]
    wrong = [
        f"[airframe]: unknown key '{key}'. Allowed: {', '.join(LIMITS)}."
        for key in given
        if key not in LIMITS
    ]
    if "thrust_max" not in given:
        wrong.append("[airframe]: thrust_max is missing; the largest collective thrust in N.")
    wrong += [_wrong_number(key, value) for key, value in given.items() if key in LIMITS]
    wrong = [text for text in wrong if text]
    if wrong:
        return None, wrong
    found: dict[str, Any] = {k: tuple(v) if k in THREE else v for k, v in given.items()}
    if isinstance(mass, int | float) and not isinstance(mass, bool) and mass > 0:
        carries = found["thrust_max"] / (GRAVITY * mass)
        if not CARRIES[0] <= carries <= CARRIES[1]:
            return None, [
                f"[airframe]: thrust_max is {carries:.3g} times the weight of {mass:g} kg; "
                f"{CARRIES[0]:g} to {CARRIES[1]:g} is plausible. It is the thrust of all rotors "
                "together, in N."
            ]
    return found, []


def _wrong_number(key: str, value: object) -> str:
    """What is wrong with one number, or with three; empty if nothing is."""
    low, high = LIMITS[key]
    numbers = value if key in THREE and isinstance(value, list) else [value]
    right = len(numbers) == (3 if key in THREE else 1) and all(
        isinstance(x, int | float) and not isinstance(x, bool) and low <= x <= high for x in numbers
    )
    if right:
        return ""
    what = "three numbers" if key in THREE else "a number"
    return f"[airframe]: {key} must be {what} from {low:g} to {high:g}, got {value!r}."
