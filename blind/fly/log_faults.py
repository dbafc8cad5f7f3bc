"""Faults made in logs: each function returns what a changed vehicle would have logged.

A fault F of the inputs means that a vehicle answers an input u as the vehicle of the log answers
F(u). The flown path stays, so the input that led to it is F^-1(u). Faults of clocks, frames, units
and order change what a column says and nothing else. All of it is arithmetic on columns: no
simulator takes part, so that a diagnosis is not checked with its own equations.
"""

import dataclasses

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from diagnosis.logs.flights import DroneLog
from diagnosis.logs.inputs import VOLTS
from simulators.vehicle import VehicleSpec

SLACK = 1e-3
"""Share of a row's period by which times may be off; stamps of an epoch have steps of 0.2 us."""
INPUTS = ("cmd", "thrust", "pwm")
"""Columns that a vehicle is told; rotor speeds are what it does."""


def more_thrust(log: DroneLog, e: float, spec: VehicleSpec) -> DroneLog:
    """The log of a vehicle whose rotors give 1 + `e` times the thrust that they are believed to.

    Raises:
        ValueError: No input that the vehicle could be given makes the thrust that it then needs.
    """
    changed = {}
    if log.cmd is not None:
        changed["cmd"] = _with(log.cmd, 3, log.cmd[:, 3] / (1.0 + e))
    if log.thrust is not None:
        changed["thrust"] = log.thrust / (1.0 + e)
    c0, c1, c2 = spec.rpm2thrust
    if log.rotor_vel is not None and c2:
        n = log.rotor_vel * 60.0 / (2.0 * np.pi)
        thrust = (c0 + c1 * n + c2 * n * n) / (1.0 + e)
        n = (-c1 + np.sqrt(np.maximum(c1**2 - 4.0 * c2 * (c0 - thrust), 0.0))) / (2.0 * c2)
        changed["rotor_vel"] = n * 2.0 * np.pi / 60.0
    if log.pwm is not None and log.battery is not None:
        linear, square = VOLTS
        top = -(linear**2) / (4.0 * square)
        volts = np.minimum(log.pwm * log.battery[:, None], top)
        grams = (linear - np.sqrt(linear**2 + 4.0 * square * volts)) / (-2.0 * square * (1.0 + e))
        duty = (linear * grams + square * grams**2) / log.battery[:, None]
        # Beyond its top the map's voltage falls again.
        if grams.max() > -linear / (2.0 * square) or duty.max() > max(1.0, log.pwm.max()):
            raise ValueError("no duty makes the thrust that this vehicle would need.")
        changed["pwm"] = duty
    if not changed:
        raise ValueError("nothing in the log says how much thrust was asked for.")
    return dataclasses.replace(log, **changed)


def more_duty(log: DroneLog, scale: float) -> DroneLog:
    """The log of motors that get 1 + `scale` times the duty that is logged."""
    return dataclasses.replace(log, pwm=_there(log.pwm) / (1.0 + scale))


def shifted(log: DroneLog, seconds: float, drift: float = 0.0) -> DroneLog:
    """Inputs that act `seconds` after their stamp, and `drift` seconds a second more.

    Rows whose input would lie beyond either end of the log are dropped.
    """
    wanted = log.t + seconds + drift * (log.t - log.t[0])
    kept = (wanted >= log.t[0]) & (wanted <= log.t[-1])
    # Inputs are held until the next row, and what is written into a row is held as long. So the
    # middle of that time decides: by its start, 20 ms early would be 24 where rows are 4 ms apart.
    t, middle = log.t - log.t[0], (0.5 + SLACK) * float(np.median(np.diff(log.t)))
    held = np.searchsorted(t, wanted[kept] - log.t[0] + middle, side="right") - 1
    columns = {
        field.name: None if value is None else value[held if field.name in INPUTS else kept]
        for field in dataclasses.fields(log)
        for value in [getattr(log, field.name)]
    }
    return DroneLog(**columns)  # pyright: ignore[reportArgumentType]


def off_trim(log: DroneLog, roll: float, pitch: float, yaw: float = 0.0) -> DroneLog:
    """The log of a vehicle that adds angles [rad] to those that it is commanded."""
    return dataclasses.replace(log, cmd=_there(log.cmd) - np.asarray([roll, pitch, yaw, 0.0]))


def more_tilt(log: DroneLog, g: float) -> DroneLog:
    """The log of a vehicle that tilts 1 + `g` times as far as it is commanded."""
    return dataclasses.replace(log, cmd=_there(log.cmd) / np.asarray([1.0 + g, 1.0 + g, 1.0, 1.0]))


def turned_tilt(log: DroneLog, angle: float) -> DroneLog:
    """The log of a vehicle that takes roll and pitch for those of axes turned by `angle` [rad]."""
    cmd = _there(log.cmd)
    turned = cmd[:, :2] @ _turn(-angle).T
    return dataclasses.replace(log, cmd=np.concatenate([turned, cmd[:, 2:]], axis=1))


def turned_path(log: DroneLog, angle: float) -> DroneLog:
    """Position and velocity in a world frame that is turned by `angle` [rad] about z."""
    turn = np.eye(3)
    turn[:2, :2] = _turn(angle)
    return dataclasses.replace(log, pos=log.pos @ turn.T, vel=log.vel @ turn.T)


def body_velocity(log: DroneLog) -> DroneLog:
    """Velocity in the body frame."""
    return dataclasses.replace(log, vel=Rotation.from_quat(log.quat).apply(log.vel, inverse=True))


def _there(x: np.ndarray | None) -> np.ndarray:
    assert x is not None  # a fault is drawn only for logs that have its columns
    return x


def _with(cmd: np.ndarray, column: int, values: np.ndarray) -> np.ndarray:
    changed = cmd.copy()
    changed[:, column] = values
    return changed


def _turn(angle: float) -> Float[np.ndarray, "2 2"]:
    c, s = np.cos(angle), np.sin(angle)
    return np.asarray([[c, -s], [s, c]])
