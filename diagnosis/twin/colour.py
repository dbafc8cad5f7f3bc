r"""The colour of a twin's errors: how an error now predicts the next, channel by channel.

    e(t) = sum_k a_k e(t - k) + w(t),     w ~ N(0, C),  C over the six channels.

Whitened errors and slopes, (x(t) - sum_k a_k x(t - k)) by the Cholesky factor of C, make the
likelihood whose covariance is that of the left-out errors. Runs of valid samples start anew.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from diagnosis.twin.channels import N

ORDERS = (0, 1, 2, 4)
"""Orders that reference flights choose from (`diagnosis.twin.twin`)."""


@dataclasses.dataclass(frozen=True)
class Colour:
    """Autoregression of each channel and covariance of what it leaves."""

    a: Float[np.ndarray, "order 6"]
    """Coefficients by lag."""
    root: Float[np.ndarray, "seen seen"]
    """Inverse Cholesky factor of the covariance of w among the channels that are seen."""
    seen: tuple[int, ...]
    """Channels that say something: without a trusted attitude command, angles do not."""

    def whiten(
        self, x: Float[np.ndarray, "*n time 6"], valid: Bool[np.ndarray, " time"]
    ) -> Float[np.ndarray, "*n numbers"]:
        """Independent numbers of unit variance, if `x` is such an error."""
        white = _innovation(x, self.a)[..., usable(valid, len(self.a)), :][..., list(self.seen)]
        return (white @ self.root.T).reshape(*x.shape[:-2], -1)


def usable(valid: Bool[np.ndarray, " time"], order: int) -> Bool[np.ndarray, " time"]:
    """Samples before which `order` samples in a row are valid, too."""
    good = valid.copy()
    for k in range(1, order + 1):
        good[k:] &= valid[:-k]
        good[:k] = False
    return good


def _innovation(x: Float[np.ndarray, "*n time 6"], a: Float[np.ndarray, "order 6"]) -> np.ndarray:
    out = x.copy()
    for k, row in enumerate(a, start=1):
        out[..., k:, :] -= row * x[..., :-k, :]
    return out


def fit_colour(
    errors: Sequence[Float[np.ndarray, "time 6"]],
    valid: Sequence[Bool[np.ndarray, " time"]],
    order: int,
    seen: tuple[int, ...],
) -> Colour:
    """The colour of left-out errors, by least squares over all runs of valid samples."""
    a = np.zeros((order, N))
    for c in range(N) if order else ():
        now, past = [], []
        for e, v in zip(errors, valid, strict=True):
            at = np.flatnonzero(usable(v, order))
            now.append(e[at, c])
            past.append(np.stack([e[at - k, c] for k in range(1, order + 1)], axis=1))
        x, y = np.concatenate(past), np.concatenate(now)
        square = x.T @ x
        ridge = 1e-6 * np.trace(square) / order + 1e-12
        a[:, c] = np.linalg.solve(square + ridge * np.eye(order), x.T @ y)
    left = [_innovation(e, a)[usable(v, order)] for e, v in zip(errors, valid, strict=True)]
    w = np.concatenate(left)[:, list(seen)]
    covariance = w.T @ w / len(w) + np.diag(1e-12 + 1e-6 * np.mean(w**2, axis=0))
    return Colour(a, np.linalg.inv(np.linalg.cholesky(covariance)), seen)
