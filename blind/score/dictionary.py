r"""Residuals of a static model of a flight, and one signature per effect, for the baselines.

Acceleration, world frame, from central differences of the logged velocity, and attitude:

    r_a = dv/dt - (T_cmd / m) b + g e_z + R D R' v / m,   r_q = rpy - H(s) rpy_cmd

with the commanded thrust T_cmd, the measured body axis b and attitude R, and H the attitude loop of
the airframe (second order: 12.5 rad/s, damping 0.65). Rotors are not modelled. To first order,

| effect | residual | signature |
|---|---|---|
| mass, thrust gain | r_a | T b / m |
| battery | r_a | -t T b / m |
| motor lag | r_a | -T' b / m |
| drag, quadratic drag | r_a | -v, -\|v\| v |
| rotor drag | r_a | -(v . b) b; across the axis it is linear drag here |
| translational lift | r_a | \|v - (v . b) b\|^2 b |
| wind, gust | r_a | a constant, one from an onset on |
| ground effect | r_a | (r / 4 h)^2 T b / m |
| downwash | r_a | -exp(-d^2 / 2 (0.1 m)^2) e_z below another drone |
| attitude gain | r_q | H rpy_cmd |
| trim, centre of mass | r_q | a constant roll or pitch |
| yaw misalignment | r_q | a constant yaw |
| delay, attitude lag | r_q | -(H rpy_cmd)' |
| inertia | r_q | -(H rpy_cmd)'' |
"""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float
from scipy import signal
from scipy.spatial.transform import Rotation

from diagnosis.logs.flights import DroneLog, FlightSet
from simulators.vehicle import GRAVITY, VehicleSpec

FREQ, DAMPING = 12.5, 0.65
"""Attitude loop of cf21B_500, from its step response [rad/s, -]."""
ONSETS = np.linspace(0.15, 0.85, 15)
"""Onsets of a gust that are tried, over the duration of a flight [-]."""
_ROTOR = 0.0231
_WIDTH = 0.1
_GRID = 0.002
_LONGEST_GAP = 0.05
"""Rows further apart are not differentiated [s]."""

Array = np.ndarray


@dataclasses.dataclass(frozen=True)
class Signature:
    """One column of the dictionary."""

    effect: str
    """Effect that it stands for."""
    parameter: str
    """Parameter of which it is the coefficient, to first order."""
    unit: str
    """Unit of the parameter."""
    aliases: tuple[str, ...] = ()
    """Effects with the same column."""


SIGNATURES = (
    Signature("thrust_gain", "e", "-", ("mass",)),
    Signature("battery", "rate", "1/s"),
    Signature("motor_lag", "seconds", "s"),
    Signature("drag", "c", "1/s", ("rotor_drag",)),
    Signature("quadratic_drag", "k", "1/m"),
    Signature("rotor_drag", "axial", "1/s"),
    Signature("translational_lift", "k", "1/m"),
    Signature("wind", "x", "m/s^2"),
    Signature("wind", "y", "m/s^2"),
    Signature("gust", "x", "m/s^2"),
    Signature("gust", "y", "m/s^2"),
    Signature("ground_effect", "c", "-"),
    Signature("downwash", "strength", "m/s^2"),
    Signature("attitude_gain", "g", "-"),
    Signature("trim", "roll", "rad", ("center_of_mass",)),
    Signature("trim", "pitch", "rad", ("center_of_mass",)),
    Signature("yaw_misalignment", "angle", "rad"),
    Signature("delay", "seconds", "s", ("attitude_lag",)),
    Signature("inertia", "seconds^2", "s^2"),
)
"""The columns in order."""


@dataclasses.dataclass(frozen=True)
class Regression:
    """Residuals of all rows and axes, acceleration and then attitude, with the dictionary there."""

    residual: Float[Array, " values"]
    """Acceleration [m/s^2] and attitude [rad]."""
    columns: Float[Array, "values signatures"]
    """Signatures in the order of `SIGNATURES`."""
    attitude: Bool[Array, " values"]
    """Whether a value belongs to the attitude."""
    phase: Float[Array, " values"]
    """Time since the start of the flight over its duration [-]."""


def regression(flights: FlightSet) -> Regression:
    """The regression problem of a flight set; the gust is there from the start, see `gust_from`.

    Raises:
        ValueError: A flight has no commands.
    """
    spec = flights.vehicle.spec
    parts = []
    for flight in flights.flights:
        for i, log in enumerate(flight.drones):
            others = [other for j, other in enumerate(flight.drones) if j != i]
            parts.append(_of_drone(log, others, spec, flights.vehicle.mass))
    acc, acc_columns, acc_phase, att, att_columns, att_phase = (
        np.concatenate(x) for x in zip(*parts, strict=True)
    )
    n_acc, n_att = acc_columns.shape[1], att_columns.shape[1]
    columns = np.zeros((len(acc) + len(att), n_acc + n_att))
    columns[: len(acc), :n_acc] = acc_columns
    columns[len(acc) :, n_acc:] = att_columns
    attitude = np.arange(len(columns)) >= len(acc)
    phase = np.concatenate([acc_phase, att_phase])
    return Regression(np.concatenate([acc, att]), columns, attitude, phase)


def gust_from(problem: Regression, onset: float) -> Float[Array, "values signatures"]:
    """The dictionary with a gust from `onset` on, over each flight's duration."""
    after = problem.phase >= onset
    gust = np.asarray([signature.effect == "gust" for signature in SIGNATURES])
    return np.where(gust & ~after[:, None], 0.0, problem.columns)


def _of_drone(
    log: DroneLog, others: list[DroneLog], spec: VehicleSpec, mass: float
) -> tuple[Array, ...]:
    """Residuals, columns and phases of acceleration, then of attitude, axis after axis."""
    if log.cmd is None:
        raise ValueError("The baselines need commanded attitude and thrust, which are missing.")
    t = log.t
    middle = np.flatnonzero(t[2:] - t[:-2] < 2 * _LONGEST_GAP) + 1
    span = (t[middle + 1] - t[middle - 1])[:, None]
    acc = (log.vel[middle + 1] - log.vel[middle - 1]) / span
    body = Rotation.from_quat(log.quat[middle]).as_matrix()
    held = np.diff(t)[:, None] * log.cmd[:-1, 3:]
    thrust = (held[middle - 1] + held[middle]) / span / mass  # mean over the difference's span
    rise = (log.cmd[middle, 3:] - log.cmd[middle - 1, 3:]) / np.diff(t)[middle - 1, None] / mass
    vel = log.vel[middle]
    lift, up = thrust * body[:, :, 2], np.asarray([0.0, 0.0, 1.0])
    drag = np.einsum("nij,j,nkj,nk->ni", body, np.asarray(spec.drag) / mass, body, vel)
    climb = np.sum(vel * body[:, :, 2], axis=1, keepdims=True) * body[:, :, 2]
    height = np.maximum(log.pos[middle, 2:], _ROTOR)
    ones = np.ones((len(middle), 1))
    columns = [
        lift,
        -t[middle, None] * lift,
        -rise * body[:, :, 2],
        -vel,
        -np.linalg.norm(vel, axis=1, keepdims=True) * vel,
        -climb,
        np.sum((vel - climb) ** 2, axis=1, keepdims=True) * body[:, :, 2],
        ones * np.eye(3)[0],
        ones * np.eye(3)[1],
        ones * np.eye(3)[0],
        ones * np.eye(3)[1],
        (_ROTOR / (4.0 * height)) ** 2 * lift,
        -_below(t[middle], log.pos[middle], others) * up,
    ]
    residual = acc - lift + GRAVITY * up + drag
    acc_columns = np.stack([np.ravel(column) for column in columns], axis=1)
    phase = np.repeat((t - t[0]) / (t[-1] - t[0]), 3).reshape(-1, 3)
    return residual.ravel(), acc_columns, phase[middle].ravel(), *_attitude(log), phase.ravel()


def _below(t: Array, pos: Array, others: list[DroneLog]) -> Array:
    """How far in another drone's wake each row is, 1 right below it."""
    wake = np.zeros(len(t))
    for other in others:
        there = np.stack([np.interp(t, other.t, other.pos[:, i]) for i in range(3)], axis=1)
        apart = there - pos
        bell = np.exp(-0.5 * np.sum(apart[:, :2] ** 2, axis=1) / _WIDTH**2)
        wake += np.where(apart[:, 2] > 0, bell, 0.0)
    return wake[:, None]


def _attitude(log: DroneLog) -> tuple[Array, Array]:
    """Residual and columns of roll, pitch and yaw."""
    assert log.cmd is not None
    rpy = Rotation.from_quat(log.quat).as_euler("xyz")
    rpy[:, 2] = np.unwrap(rpy[:, 2])
    grid = np.arange(log.t[0], log.t[-1] + _GRID, _GRID)
    held = log.cmd[np.searchsorted(log.t, grid, side="right") - 1, :3]
    held = np.unwrap(held, axis=0)
    # The loop with its poles mapped exactly to the grid, its gain kept at one.
    poles = FREQ * np.roots([1.0, 2 * DAMPING, 1.0])
    a = np.real(np.poly(np.exp(poles * _GRID)))
    smooth = held[0] + signal.lfilter([np.sum(a)], a, held - held[0], axis=0)
    slope = np.gradient(smooth, _GRID, axis=0)
    bend = np.gradient(slope, _GRID, axis=0)
    model, slope, bend = (
        np.stack([np.interp(log.t, grid, x[:, i]) for i in range(3)], axis=1)
        for x in (smooth, slope, bend)
    )
    tilt = np.asarray([1.0, 1.0, 0.0])
    ones = np.ones((len(log.t), 1))
    columns = [model * tilt, *(ones * np.eye(3)[i] for i in range(3)), -slope, -bend]
    residual = rpy - model
    return residual.ravel(), np.stack([np.ravel(column) for column in columns], axis=1)
