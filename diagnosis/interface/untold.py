"""`untold(flights)`: which checks of the interface these flights do not allow, and what to fly."""

from diagnosis.interface.fault import Untold
from diagnosis.interface.faults import Checks
from diagnosis.interface.position import points_down
from diagnosis.logs.flights import FlightSet

_ASKED = {
    "velocity": ("order and signs of the velocity", ("x", "y", "z")),
    "angular velocity": ("order and signs of the angular velocity", ("x", "y", "yaw")),
    "accelerometer": ("order and signs of the accelerometer", ("x", "y", "z")),
    "attitude": ("order and signs of the attitude against the path", ("x", "y")),
    "attitude command": ("order and signs of commanded roll and pitch", ("x", "y")),
}
"""What a part's check says as a whole, and the motions that it needs."""
_TOLD_BY = {
    "velocity": {"x": "x", "y": "y", "z": "z"},
    "angular velocity": {"x": "y", "y": "x", "z": "yaw"},
    "attitude": {"the path's x axis": "x", "the path's y axis": "y"},
    "attitude command": {"roll": "y", "pitch": "x"},
}
"""The motion that tells the sign of an axis: a drone rolls to fly along y, and pitches along x."""


def untold(flights: FlightSet, made: Checks) -> tuple[Untold, ...]:
    """Every check that these flights do not allow by `made`, though their columns would."""
    has_acc = made.windows is not None and made.windows.acc is not None
    has_gyro = made.windows is not None and made.windows.ang_vel is not None
    drones = [drone for flight in flights.flights for drone in flight.drones]
    commanded = any(drone.cmd is not None for drone in drones)
    inputs = ("cmd", "thrust", "rotor_vel", "pwm")
    powered = all(any(getattr(drone, name) is not None for name in inputs) for drone in drones)
    there = {"velocity": True, "attitude": True, "attitude command": commanded}
    there |= {"accelerometer": has_acc, "angular velocity": has_gyro}
    found = [one for part in _ASKED if there[part] for one in _of_part(part, made)]
    height = made.rise
    if powered and not points_down(height) and not (height and height.low > 0.0):
        up = "whether the path's z axis points up"
        found.append(Untold(part="position", what=up, fly=("z",)))
    return tuple(found)


def _of_part(part: str, made: Checks) -> list[Untold]:
    chosen, (what, fly) = made.compared.get(part), _ASKED[part]
    if chosen is None:
        return [Untold(part=part, what=what, fly=fly)]
    return [
        Untold(part=part, what=_sign(part, axis), fly=(_TOLD_BY[part][axis],))
        for axis in chosen.untold
    ]


def _sign(part: str, axis: str) -> str:
    if part == "attitude command":
        return f"sign of commanded {axis}"
    return f"sign of {axis}" if part == "attitude" else f"sign of the {part}'s {axis} axis"
