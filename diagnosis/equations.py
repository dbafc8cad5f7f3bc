"""Linear algebra on normal equations: steps within bounds, shifts, onsets, dispersion."""

import dataclasses

import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear

from diagnosis.likelihood import Normal
from diagnosis.segments import WINDOW


def moved(normal: Normal, by: Float[np.ndarray, " params"]) -> Normal:
    """Normal equations `by` ahead, to first order in the prediction."""
    pushed = np.einsum("wij,j->wi", normal.H, by)
    c = normal.c - 2.0 * normal.g @ by + pushed @ by
    return dataclasses.replace(normal, g=normal.g - pushed, c=c)


def bounded_step(
    H: Float[np.ndarray, "free free"],
    g: Float[np.ndarray, " free"],
    low: Float[np.ndarray, " free"],
    high: Float[np.ndarray, " free"],
) -> Float[np.ndarray, " free"]:
    """The step that solves H step = g as well as `low` and `high` allow; zero is allowed."""
    scale = scale_of(H)
    values, vectors = np.linalg.eigh(H / np.outer(scale, scale))
    kept = values > 1e-9 * max(values.max(), 1e-9)
    if not kept.any():
        return np.zeros(len(g))
    root = np.sqrt(values[kept])[:, None] * vectors[:, kept].T
    target = vectors[:, kept].T @ (g / scale) / np.sqrt(values[kept])
    low, high = scale * np.minimum(low, 0.0) - 1e-12, scale * np.maximum(high, 0.0) + 1e-12
    return np.asarray(lsq_linear(root, target, (low, high)).x) / scale


def scale_of(H: np.ndarray) -> np.ndarray:
    """Square roots of the diagonal, one where it vanishes."""
    root = np.sqrt(np.clip(np.diag(H), 0.0, None))
    return np.where(root > 0, root, 1.0)


def scaled(H: np.ndarray, g: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations with a unit diagonal."""
    scale = scale_of(H)
    return H / np.outer(scale, scale), g / scale


def switched(normal: Normal, columns: list[int], onset: float) -> Normal:
    """Normal equations in which some parameters act only in windows from `onset` on."""
    on = (normal.t >= onset - WINDOW / 2).astype(float)
    mask = np.ones((len(normal.t), normal.H.shape[1]))
    mask[:, columns] = on[:, None]
    return dataclasses.replace(
        normal, H=normal.H * mask[:, :, None] * mask[:, None, :], g=normal.g * mask
    )


def dispersion(normal: Normal, n_flights: int) -> float:
    """Variance of the flights' scores over what independent samples would give, at least 1.

    Computed after the step that the whole library would take, so that an effect which is merely
    missing does not count as dispersion. With fewer than three flights, blocks of time stand in.
    """
    groups = normal.flight if n_flights >= 3 else np.arange(len(normal.t)) * 8 // len(normal.t)
    H, g = normal.H.sum(axis=0), normal.g.sum(axis=0)
    seen = np.diag(H) > 1e-9 * np.max(np.diag(H))
    H, g = H[np.ix_(seen, seen)], g[seen]
    values, vectors = np.linalg.eigh(scaled(H, g)[0])
    kept = values > 1e-6
    whiten = (vectors[:, kept] / np.sqrt(values[kept])).T / scale_of(H)
    step = whiten.T @ (whiten @ g)
    scores = []
    for group in np.unique(groups):
        rows = groups == group
        left = (
            normal.g[rows][:, seen].sum(axis=0) - normal.H[rows][:, seen][:, :, seen].sum(0) @ step
        )
        scores.append(whiten @ left)
    n = len(scores)
    return max(1.0, float(np.sum(np.square(scores)) / kept.sum() / (1.0 - 1.0 / n)))
