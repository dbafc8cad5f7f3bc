"""Axes, signs and frames of motion columns, each against another column of the same log.

| column | must agree with |
|---|---|
| velocity | how the position moves |
| angular velocity | how the attitude turns |
| specific force | how the position accelerates, seen from the attitude |
| attitude | the direction of the specific force that the path needs |
"""

import dataclasses
import math
from collections.abc import Mapping

import numpy as np
from jaxtyping import Float
from scipy.spatial.transform import Rotation

from diagnosis.interface.readings import (
    AXES,
    RIGHT,
    TURNED,
    Chosen,
    Reading,
    choose,
    choose_signs,
    remainder,
    signed_orders,
)
from diagnosis.interface.windows import Windows


def vectors(windows: Windows) -> dict[str, Chosen | None]:
    """What velocity, angular velocity and specific force hold instead; None without columns."""
    w, spin = windows, "the angular velocity in the world frame"
    force = "the specific force in the world frame"
    return {
        "velocity": _vector(w.path, w.vel, w.turned_vel, "the velocity in the body frame"),
        "angular velocity": _vector(w.turn, w.ang_vel, w.turned_ang_vel, spin),
        "accelerometer": _vector(w.force, w.turned_acc, w.acc, force),
    }


def attitude(windows: Windows) -> Chosen | None:
    """What the attitude, or the path beside it, holds instead.

    A path with a mirrored or exchanged axis and an attitude with a wrong sign look alike.
    """
    upright = Rotation.from_matrix(windows.rotation)
    quat, rpy = upright.as_quat(), upright.as_euler("xyz")
    flip = lambda *signs: Rotation.from_euler("xyz", rpy * np.asarray(signs)).as_matrix()  # noqa: E731
    exchanged = Rotation.from_euler("xyz", rpy[:, [1, 0, 2]]).as_matrix()
    first = Rotation.from_quat(np.roll(quat, -1, axis=1)).as_matrix()
    attitudes = {
        "": (upright.as_matrix(), 0),
        "the attitude from world to body": (upright.inv().as_matrix(), 1),
        "quaternions with the scalar first": (first, 1),
        "roll with the opposite sign": (flip(-1, 1, 1), 1),
        "pitch with the opposite sign": (flip(1, -1, 1), 1),
        "yaw with the opposite sign": (flip(1, 1, -1), 1),
        "roll and pitch with the opposite sign": (flip(-1, -1, 1), 2),
        "roll and pitch exchanged": (exchanged, 1),
    }
    readings = [
        Reading(name, _pointed(windows, R[:, :, 2]), changes)
        for name, (R, changes) in attitudes.items()
    ]
    for words, matrix in PATHS.items():
        axis = upright.as_matrix()[:, :, 2].copy()
        axis[:, :2] = axis[:, :2] @ matrix.T
        readings.append(Reading(words, _pointed(windows, axis), 1))
    across = windows.force[:, :2]
    _, turn, error = path_fitted(*tilt_terms(windows, windows.rotation[:, :, 2]))
    readings.append(Reading(TURNED, error, len(AXES)))
    chosen = choose(readings, _spread(across), across.size)
    if chosen is not None and chosen.names == (TURNED,):
        chosen = dataclasses.replace(chosen, names=())
        if abs(turn) > RIGHT:
            return chosen
    flips = {name: attitudes[name][0][:, :, 2] for name in _FLIPS}
    for words in _MIRRORS:
        flips[words] = flips[""] * np.append(np.diag(PATHS[words]), 1.0)
    return choose_signs(
        chosen,
        {f"the path's {axis} axis": _one_way(windows, flips, i) for i, axis in enumerate("xy")},
    )


_FLIPS = ("", "roll with the opposite sign", "pitch with the opposite sign")
_MIRRORS = ("a path whose x axis points the other way", "a path whose y axis points the other way")


PATHS = {
    "a path whose x axis points the other way": np.diag([-1.0, 1.0]),
    "a path whose y axis points the other way": np.diag([1.0, -1.0]),
    "a path with x and y exchanged": np.asarray([[0.0, 1.0], [1.0, 0.0]]),
    "a path in a frame turned by 90 degrees": np.asarray([[0.0, -1.0], [1.0, 0.0]]),
    "a path in a frame turned by -90 degrees": np.asarray([[0.0, 1.0], [-1.0, 0.0]]),
    "a path in a frame turned by 180 degrees": -np.eye(2),
}
"""Frames of the path, as they turn the horizontal force."""


def tilt_terms(
    windows: Windows, axis: Float[np.ndarray, "windows 3"], weight: float | None = None
) -> tuple[Float[np.ndarray, "rows 5"], Float[np.ndarray, " rows"]]:
    """Regressors of the horizontal force, x rows before y rows, and that force [m/s^2].

    The thrust axis times the force, or times a `weight` [m/s^2], the same turned by 90 degrees,
    drag, and then a bias of each axis, which a trim or an inclined frame makes.
    """
    force = np.linalg.norm(windows.force, axis=1, keepdims=True)
    along = (force if weight is None else weight) * axis[:, :2]
    turned = np.stack([-along[:, 1], along[:, 0]], axis=1)
    columns = [along, turned, -windows.path[:, :2]]
    terms = np.stack([c.T.ravel() for c in columns], axis=1)
    n = len(windows)
    bias = np.zeros((2 * n, 2))
    bias[:n, 0] = bias[n:, 1] = 1.0
    return np.concatenate([terms, bias], axis=1), windows.force[:, :2].T.ravel()


def _one_way(
    windows: Windows, axes: Mapping[str, Float[np.ndarray, "windows 3"]], i: int
) -> tuple[list[Reading], float, int]:
    """The horizontal force along x or y by itself, with each thrust axis of `axes`.

    The other component may act in any proportion, as a path that is turned in yaw makes it.
    """
    force = windows.force[:, i]
    size = np.linalg.norm(windows.force, axis=1)
    other = size * axes[""][:, 1 - i]
    free = np.column_stack([other, -windows.path[:, i], np.ones(len(windows))])
    return _signed(force, free, {name: size * axis[:, i] for name, axis in axes.items()})


def path_fitted(
    terms: Float[np.ndarray, "rows 5"], force: Float[np.ndarray, " rows"]
) -> tuple[float, float, float]:
    """Scale [-] and turn in yaw [rad] of a path, by some rows of `tilt_terms`, and what is left."""
    fit, *_ = np.linalg.lstsq(terms, force, rcond=None)
    left = float(np.sum((force - terms @ fit) ** 2))
    return math.hypot(fit[0], fit[1]), math.atan2(fit[1], fit[0]), left


def _pointed(windows: Windows, axis: Float[np.ndarray, "windows 3"]) -> float:
    """Squared error of the horizontal force along an axis, drag and a bias allowed for."""
    terms, force = tilt_terms(windows, axis)
    return remainder(force, terms[:, 2:], terms[:, 0])


def _vector(
    truth: Float[np.ndarray, "windows 3"],
    asked: Float[np.ndarray, "windows 3 ..."] | None,
    in_other: Float[np.ndarray, "windows 3 ..."] | None,
    other: str,
) -> Chosen | None:
    """The reading of a vector in the frame asked for or the other one, in any order and sign.

    One of the two is turned, by a matrix that depends on order and sign.
    """
    if asked is None or in_other is None:
        return None
    readings = []
    for frame, seen in (("", asked), (other, in_other)):
        for words, changes, matrix in signed_orders(3):
            turned = seen.ndim > 2
            predicted = np.einsum("nijk,jk->ni", seen, matrix) if turned else seen @ matrix.T
            readings.append(
                Reading(
                    ", ".join(filter(None, (frame, words))),
                    float(np.sum((truth - predicted) ** 2)),
                    changes + bool(frame),
                )
            )
    chosen = choose(readings, _spread(truth), truth.size)
    if asked.ndim > 2:  # gravity is most of it
        return chosen
    return choose_signs(chosen, {axis: _same_way(truth, asked, i) for i, axis in enumerate(AXES)})


def _same_way(
    truth: Float[np.ndarray, "windows 3"], logged: Float[np.ndarray, "windows 3"], i: int
) -> tuple[list[Reading], float, int]:
    """One component of a vector by itself; the others may leak into it, as a turned frame makes."""
    free = np.column_stack([np.delete(logged, i, axis=1), np.ones(len(truth))])
    signs = {"": logged[:, i], f"{AXES[i]} with the opposite sign": -logged[:, i]}
    return _signed(truth[:, i], free, signs)


def _signed(
    y: Float[np.ndarray, " rows"],
    free: Float[np.ndarray, "rows free"],
    along: Mapping[str, Float[np.ndarray, " rows"]],
) -> tuple[list[Reading], float, int]:
    """One column of a vector read in several ways, as `choose_signs` takes them."""
    readings = [Reading(name, remainder(y, free, x), int(bool(name))) for name, x in along.items()]
    return readings, remainder(y, free), len(y)


def _spread(truth: np.ndarray) -> float:
    return float(np.sum((truth - truth.mean(axis=0)) ** 2))
