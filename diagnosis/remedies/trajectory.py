"""A flight within a geofence as polynomials of degree 7, as a Crazyflie's memory holds them.

Positions and headings of a path and their first three derivatives are met at the ends of every
piece, so that commands are smooth. A path that does not fit is made smaller by a factor s and
slower by sqrt(s): accelerations, and with them tilts and thrusts, stay what they were; speeds
become smaller by sqrt(s).
"""

import dataclasses

import numpy as np
from jaxtyping import Float
from scipy.interpolate import BPoly, PPoly, make_interp_spline

from diagnosis.remedies.flight_paths import PATHS, smooth
from simulators.vehicle import GRAVITY

PIECES = 31
"""Polynomials that the trajectory memory of a Crazyflie holds: 4,096 bytes, 132 bytes each
(crazyflie-firmware, docs/functional-areas/trajectory_formats.md)."""
MARGIN = 0.2
"""Distance that the targets keep from the geofence [m]; a guess at how far a drone overshoots."""
LOWEST = 0.04
"""Height above the floor that targets keep [m]."""
STOP = 2.0
"""Time in which the flight comes to rest at its end [s]."""
_FINE = 0.005
"""Step of the samples that derivatives are taken from [s]."""


@dataclasses.dataclass(frozen=True)
class Geofence:
    """A box on the floor, the origin amid its floor, edges along the world's axes."""

    length: float = 3.0
    """Along x [m]."""
    width: float = 3.0
    """Along y [m]."""
    height: float = 2.0
    """Along z [m]."""


@dataclasses.dataclass(frozen=True)
class Trajectory:
    """A flight in pieces."""

    path: str
    """Name of the path in `PATHS`."""
    scale: float
    """Its size over that of the path."""
    durations: Float[np.ndarray, " pieces"]
    """Of each piece [s]."""
    coefficients: Float[np.ndarray, "pieces 4 8"]
    """Of x, y, z [m] and yaw [rad], by powers of the time since the piece began [s]."""

    def sampled(
        self, dt: float
    ) -> tuple[Float[np.ndarray, " steps"], Float[np.ndarray, "steps 4"]]:
        """Times since the start [s], and x, y, z [m] and yaw [rad] then."""
        breaks = np.concatenate([[0.0], np.cumsum(self.durations)])
        t = np.arange(round(breaks[-1] / dt) + 1) * dt
        curve = PPoly(np.moveaxis(self.coefficients[:, :, ::-1], 2, 0), breaks)
        return t, curve(np.minimum(t, breaks[-1]))

    @property
    def top_speed(self) -> float:
        """Largest speed [m/s]."""
        t, values = self.sampled(_FINE)
        return float(np.linalg.norm(np.gradient(values[:, :3], t, axis=0), axis=1).max())

    @property
    def top_thrust(self) -> float:
        """Largest thrust over the weight that the accelerations ask for, without drag."""
        t, values = self.sampled(_FINE)
        velocity = np.gradient(values[:, :3], t, axis=0)
        force = np.gradient(velocity, t, axis=0) + np.asarray([0.0, 0.0, GRAVITY])
        return float(np.linalg.norm(force, axis=1).max() / GRAVITY)


def plan(path: str, geofence: Geofence = Geofence()) -> Trajectory:
    """The flight along a path within a geofence, at rest at its start and at its end.

    Raises:
        KeyError: There is no such path.
    """
    targets, seconds = PATHS[path]
    t = np.arange(round(seconds / _FINE) + 1) * _FINE
    flown = targets(t)
    values = np.concatenate([flown.pos, flown.yaw[:, None]], axis=1)
    steps = np.diff(values, axis=0) * smooth((seconds - t[1:]) / STOP)[:, None]
    away = np.concatenate([np.zeros((1, 4)), np.cumsum(steps, axis=0)])
    scale, start = _placed(away[:, :3], values[0, :3], geofence)
    away[:, :3] *= scale
    values = away + np.asarray([*start, values[0, 3]])
    slow = np.sqrt(scale)
    spline = make_interp_spline(t * slow, values, k=7)
    breaks = np.linspace(0.0, seconds * slow, PIECES + 1)
    at_breaks = [spline.derivative(n)(breaks) if n else spline(breaks) for n in range(4)]
    at_breaks[0][[0, -1]] = [values[0], values[-1]]
    for derivative in at_breaks[1:]:
        derivative[[0, -1]] = 0.0
    curve = PPoly.from_bernstein_basis(BPoly.from_derivatives(breaks, np.stack(at_breaks, axis=1)))
    coefficients = np.moveaxis(curve.c[::-1], 0, 2)
    return Trajectory(path, scale, np.diff(breaks), coefficients)


def _placed(
    away: Float[np.ndarray, "steps 3"], first: Float[np.ndarray, " 3"], geofence: Geofence
) -> tuple[float, Float[np.ndarray, " 3"]]:
    """Factor of the way from the first position that fits, at most 1, and where to begin [m].

    Sideways the flight lies amid the geofence; its height is that of the path where that fits.
    """
    most, least = away.max(axis=0), away.min(axis=0)
    low, high = LOWEST, geofence.height - MARGIN
    room = [geofence.length - 2.0 * MARGIN, geofence.width - 2.0 * MARGIN, high - low]
    scale = float(min(1.0, (np.asarray(room) / np.maximum(most - least, 1e-9)).min()))
    amid = -0.5 * scale * (most + least)
    height = np.clip(first[2], low - scale * least[2], high - scale * most[2])
    return scale, np.asarray([amid[0], amid[1], height])
