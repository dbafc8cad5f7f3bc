r"""Aerospace frames turned into ours.

World: north, east, down becomes east, north, up. Body: forward, right, down becomes forward, left,
up. With the matrices W (world) and B (body), both their own inverses,

    v' = W v,   w' = B w,   R' = W R B

so that roll stays, pitch changes its sign, and a heading of 0 (north) becomes a yaw of 90 degrees.

A row that holds no attitude becomes NaN, so that it is dropped and counted like any other row
without a number (`diagnosis.importing.resample`).
"""

import numpy as np
from jaxtyping import Bool, Float
from scipy.spatial.transform import Rotation

WORLD = np.asarray([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])
"""North, east, down to east, north, up."""
BODY = np.diag([1.0, -1.0, -1.0])
"""Forward, right, down to forward, left, up."""
NED = "NED to ENU"
"""How the report calls the change of world vectors."""
FRD = "FRD to FLU"
"""How the report calls the change of body vectors."""


def enu(ned: Float[np.ndarray, "rows 3"]) -> Float[np.ndarray, "rows 3"]:
    """World vectors given as north, east, down."""
    return ned @ WORLD.T


def flu(frd: Float[np.ndarray, "rows 3"]) -> Float[np.ndarray, "rows 3"]:
    """Body vectors given as forward, right, down."""
    return frd @ BODY.T


def is_attitude(quat: Float[np.ndarray, "rows 4"]) -> Bool[np.ndarray, " rows"]:
    """Rows whose norm is finite and not 0; autopilots log NaN or zeros where they know none."""
    with np.errstate(over="ignore"):
        norm = np.linalg.norm(quat, axis=1)
    return np.isfinite(norm) & (norm > 0.0)


def quat_of(
    quat: Float[np.ndarray, "rows 4"], *, ned: bool = True, frd: bool = True
) -> Float[np.ndarray, "rows 4"]:
    """Attitudes (scalar last) from a body that is FRD, in a world that is NED; norms are kept."""
    world = Rotation.from_matrix(WORLD) if ned else Rotation.identity()
    body = Rotation.from_matrix(BODY) if frd else Rotation.identity()
    known, out = is_attitude(quat), np.full(quat.shape, np.nan)
    out[known] = (world * Rotation.from_quat(quat[known]) * body).as_quat()
    return out * np.linalg.norm(quat, axis=1, keepdims=True)


def quat_of_rpy(rpy: Float[np.ndarray, "rows 3"]) -> Float[np.ndarray, "rows 4"]:
    """Attitudes of roll, pitch, yaw [rad], extrinsic about x, y, z."""
    return Rotation.from_euler("xyz", rpy).as_quat()


def rpy_of(quat: Float[np.ndarray, "rows 4"]) -> Float[np.ndarray, "rows 3"]:
    """Roll, pitch, yaw [rad] of attitudes, extrinsic about x, y, z."""
    known, out = is_attitude(quat), np.full((len(quat), 3), np.nan)
    out[known] = Rotation.from_quat(quat[known]).as_euler("xyz")
    return out


def to_world(
    quat: Float[np.ndarray, "rows 4"], body: Float[np.ndarray, "rows 3"]
) -> Float[np.ndarray, "rows 3"]:
    """Body vectors turned into the world by attitudes."""
    known, out = is_attitude(quat), np.full(body.shape, np.nan)
    out[known] = Rotation.from_quat(quat[known]).apply(body[known])
    return out
