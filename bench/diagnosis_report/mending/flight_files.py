"""The next flight as files: polynomials for a Crazyflie, setpoints and a mission for PX4."""

import io
import json
import math
from typing import Any

import numpy as np

from diagnosis.remedies.trajectory import Geofence, Trajectory

EARTH = 6378137.0
"""Radius of the Earth at the equator [m] (WGS 84)."""
SETPOINT_DT = 0.02
"""Time between two setpoints [s]; PX4 asks for more than two a second."""
APART = 1.0
"""Least distance between two way points of a mission [m]."""
TAKE_OFF, WAY_POINT, LAND, RELATIVE = 22, 16, 21, 3
"""MAV_CMD_NAV_TAKEOFF, _WAYPOINT, _LAND; MAV_FRAME_GLOBAL_RELATIVE_ALT (MAVLink)."""


def polynomial_csv(trajectory: Trajectory) -> str:
    """A row a piece, as `Trajectory.loadcsv` of crazyswarm2 reads: duration, x^0 to yaw^7."""
    axes = ("x", "y", "z", "yaw")
    names = ["Duration", *(f"{axis}^{power}" for axis in axes for power in range(8))]
    table = np.column_stack([trajectory.durations, trajectory.coefficients.reshape(-1, 32)])
    return _csv(names, table, "%.9g")


def setpoint_csv(trajectory: Trajectory) -> str:
    """A row every 20 ms for PX4's offboard mode: time [s], north, east, down [m], yaw [rad]."""
    t, values = trajectory.sampled(SETPOINT_DT)
    x, y, z, yaw = values.T
    heading = np.angle(np.exp(1j * (0.5 * np.pi - yaw)))
    return _csv(["t", "x", "y", "z", "yaw"], np.column_stack([t, y, x, -z, heading]), "%.5f")


def way_points(trajectory: Trajectory) -> list[np.ndarray]:
    """Places of the path `APART` from each other at least: x, y, z [m] and yaw [rad]."""
    _, values = trajectory.sampled(SETPOINT_DT)
    points = [values[0]]
    for value in values[1:]:
        if np.linalg.norm((value - points[-1])[:3]) >= APART:
            points.append(value)
    return points


def mission(trajectory: Trajectory, geofence: Geofence, home: tuple[float, float]) -> str:
    """A plan of QGroundControl: take off, the path's way points, land; and the geofence.

    `home` is latitude and longitude [degrees] of the origin. A mission has places and no times, so
    that PX4 chooses the speed; setpoints keep both.
    """
    points = way_points(trajectory)
    ends = [
        (TAKE_OFF, points[0]),
        *((WAY_POINT, p) for p in points),
        (LAND, points[0] * [1, 1, 0, 1]),
    ]
    half_x, half_y = 0.5 * geofence.length, 0.5 * geofence.width
    corners = ((-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y))
    polygon = [list(_place(home, x, y)) for x, y in corners]
    content = {
        "fileType": "Plan",
        "version": 1,
        "groundStation": "fidelity-bench",
        "geoFence": {
            "version": 2,
            "circles": [],
            "polygons": [{"inclusion": True, "polygon": polygon, "version": 1}],
        },
        "rallyPoints": {"version": 2, "points": []},
        "mission": {
            "version": 2,
            "firmwareType": 12,
            "vehicleType": 2,
            "cruiseSpeed": 5,
            "hoverSpeed": round(max(0.5, trajectory.top_speed), 2),
            "globalPlanAltitudeMode": 1,
            "plannedHomePosition": [*home, 0],
            "items": [_item(i, what, place, home) for i, (what, place) in enumerate(ends, 1)],
        },
    }
    return json.dumps(content, indent=1) + "\n"


def _item(
    number: int, command: int, value: np.ndarray, home: tuple[float, float]
) -> dict[str, Any]:
    x, y, z, yaw = (float(v) for v in value)
    heading = math.degrees(0.5 * math.pi - yaw) % 360.0
    place = _place(home, x, y)
    return {
        "type": "SimpleItem",
        "autoContinue": True,
        "command": command,
        "doJumpId": number,
        "frame": RELATIVE,
        "params": [0, 0.3, 0, round(heading, 2), *place, round(z, 3)],
    }


def _place(home: tuple[float, float], x: float, y: float) -> tuple[float, float]:
    """Latitude and longitude [degrees] of a place `x` [m] to the east, `y` to the north."""
    latitude = home[0] + math.degrees(y / EARTH)
    longitude = home[1] + math.degrees(x / (EARTH * math.cos(math.radians(home[0]))))
    return round(latitude, 8), round(longitude, 8)


def _csv(names: list[str], table: np.ndarray, form: str) -> str:
    text = io.StringIO()
    np.savetxt(text, table, form, ",", header=",".join(names), comments="")
    return text.getvalue()
