r"""Evidence for sets of effects, in the few directions in which flights say anything.

The mean information H of a flight, scaled to a unit diagonal, R = D^(-1/2) H D^(-1/2), has
eigenvectors v_j with eigenvalues lambda_j. Only parameters count whose information reaches
`VISIBLE` times the scatter of all flights. Along the first `MOST` of them a flight's scores are
z_ij = v_j' D^(-1/2) h_i / sqrt(lambda_j), and a set of effects with values theta shifts their mean
over a group by M theta. The unit diagonal lets every parameter ask for its direction, however
precisely others are seen. The difference of both groups' means is then

    delta = M theta + noise,     noise ~ multivariate t(C, nu),

C from the scatter of the reference flights (as in `units.py`). A change is expected to be s times
the range of its parameter, theta ~ N(0, s^2), with s one of `WIDTHS`:

    T^2 = min over theta of (delta - M theta)' C^-1 (delta - M theta) / b + theta' theta / s^2,
    log evidence = log mean over s of exp(-(nu + K) / 2 log(1 + T^2 / nu) - Occam),
    Occam = 1/2 log det(1 + s^2 M' C^-1 M / b),

theta within the range of each effect. b = 1 unless the best effects leave more than chance
(`Hypothesis.ratio`). Without the term in theta, large sizes that nearly cancel cost nothing: four
gains of the attitude loop were worth 26 nats where commands came 20 ms early, a delay 17.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.optimize import lsq_linear

from diagnosis.twin.units import PRIOR_FLIGHTS, Comparison, Group, hotelling

WIDTHS = (0.03, 0.1, 0.3, 1.0)
"""Standard deviations that a change may have, over the range of its parameter; a choice."""
MOST = 12
"""Most directions. With 8, a loss of thrust was taken for a battery that fades on
`crazyflie_plain`: the trend within a flight, which tells the two apart, was not among them."""
VISIBLE = 4.0
"""Information of all flights over their scatter from which a parameter counts; a choice."""
LEAST = 0.02
"""Least eigenvalue of a direction, over the mean one; a choice."""


@dataclasses.dataclass(frozen=True)
class Evidence:
    """The difference between two groups in the directions that they show."""

    delta: Float[np.ndarray, " K"]
    """Whitened difference: identity covariance without any change."""
    M: Float[np.ndarray, "K params"]
    """Its derivative by the parameters, in units of their range."""
    dof: float
    """Degrees of freedom of its covariance."""
    unchanged: float
    """T^2 of no change at all."""
    basis: Float[np.ndarray, "params K"]
    """The directions."""
    at: Float[np.ndarray, " params"]
    """The change at which the difference is taken."""
    scale: float = 1.0
    """What T^2 is divided by (`Hypothesis.scaled`)."""

    def left(self, columns: Sequence[int]) -> float:
        """T^2 that the best values of some parameters within their range leave."""
        return self.beyond(self._without_others(columns), columns)

    def _without_others(self, columns: Sequence[int]) -> Float[np.ndarray, " K"]:
        """The difference, continued to no change of all other parameters."""
        change = self.at.copy()
        change[list(columns)] = 0.0
        return self.delta + self.M @ change

    def beyond(self, shift: Float[np.ndarray, " K"], columns: Sequence[int]) -> float:
        """Square of what the best values of some parameters within their range leave of a shift."""
        at = list(columns)
        if not at:
            return float(shift @ shift)
        bounds = (-np.ones(len(at)), np.ones(len(at)))
        return float(2.0 * lsq_linear(self.M[:, at], shift, bounds).cost)

    def log_evidence(self, columns: Sequence[int]) -> float:
        """Log evidence of a set of parameters against no change [nats]."""
        each = [self._log_evidence(list(columns), width) for width in WIDTHS]
        return float(np.logaddexp.reduce(each) - np.log(len(each)))

    def width(self, columns: Sequence[int]) -> float:
        """The likeliest of the sizes that a change of some parameters may be expected to have."""
        return max(WIDTHS, key=lambda width: self._log_evidence(list(columns), width))

    def _log_evidence(self, at: list[int], width: float) -> float:
        """The same if changes are expected to be `width` times their range."""
        root = np.sqrt(self.scale)
        m, start, unit = self.M[:, at] / root, self.at[at], np.eye(len(at))
        delta = self._without_others(at) / root
        left = float(delta @ delta)
        if at:
            slopes, shift = np.vstack([m, unit / width]), [*delta, *-start / width]
            ends = (-1.0 - start, 1.0 - start)
            left = float(2.0 * lsq_linear(slopes, np.asarray(shift), ends).cost)
        without = np.log1p(self.unchanged / self.scale / self.dof)
        power = -(self.dof + len(self.delta)) / 2.0
        occam = 0.5 * np.linalg.slogdet(unit + width**2 * m.T @ m)[1]
        return float(power * (np.log1p(left / self.dof) - without) - occam)

    def p(self, columns: Sequence[int]) -> float:
        """Probability of what some parameters leave, if nothing else changed."""
        k = max(len(self.delta) - len(columns), 1)
        return hotelling(self.left(columns), k, self.dof)


def weigh(comparison: Comparison) -> Evidence:
    """The evidence of two groups, with directions among the parameters that are compared."""
    found = _along(comparison, _basis(comparison))
    return dataclasses.replace(found, unchanged=float(found.delta @ found.delta))


def weigh_at(
    evidence: Evidence, comparison: Comparison, change: Float[np.ndarray, " params"]
) -> Evidence:
    """The same evidence where the target is compared with what a change predicts.

    The scores of the target in `comparison` are those at the change.
    """
    found = _along(comparison, evidence.basis)
    return dataclasses.replace(found, unchanged=evidence.unchanged, at=change)


def _basis(comparison: Comparison) -> Float[np.ndarray, "params K"]:
    """The directions in which two groups say most."""
    reference, target, columns = comparison.reference, comparison.target, comparison.columns
    mean = np.concatenate([reference.H, target.H]).mean(axis=0)
    n = 1.0 / (1.0 / len(reference) + 1.0 / len(target))
    at = [i for i in columns if mean[i, i] * n > VISIBLE * comparison.phi] or list(columns)
    scale = np.sqrt(np.maximum(np.diag(mean)[at], 1e-300))
    values, vectors = np.linalg.eigh(mean[np.ix_(at, at)] / np.outer(scale, scale))
    kept = np.flatnonzero(values > LEAST * values.mean())[::-1][:MOST]
    basis = np.zeros((len(mean), len(kept)))
    basis[at] = vectors[:, kept] / scale[:, None] / np.sqrt(values[kept])
    return basis


def _along(comparison: Comparison, basis: Float[np.ndarray, "params K"]) -> Evidence:
    """The difference of two groups along some directions."""
    reference, target = comparison.reference, comparison.target
    z, weight = _directions(reference, basis)
    beside, other = _directions(target, basis)
    first, second = z.sum(axis=0) / weight.sum(), beside.sum(axis=0) / other.sum()
    q, q_other = ((w + w * w) / 2.0 for w in (weight, other))
    u = (z - weight[:, None] * first) / np.sqrt(q)[:, None]
    dof = len(reference) - 1.0 + PRIOR_FLIGHTS
    c = (PRIOR_FLIGHTS * comparison.phi * np.eye(basis.shape[1]) + u.T @ u) / dof
    c = c * (q.sum() / weight.sum() ** 2 + q_other.sum() / other.sum() ** 2)
    root = np.linalg.inv(np.linalg.cholesky(c))
    M = basis.T @ target.H.sum(axis=0) / other.sum()
    return Evidence(root @ (second - first), root @ M, dof, np.nan, basis, np.zeros(len(basis)))


def _directions(
    group: Group, basis: Float[np.ndarray, "params K"]
) -> tuple[Float[np.ndarray, "flights K"], Float[np.ndarray, " flights"]]:
    """Z of every flight, and its information over that of the mean flight."""
    weight = np.einsum("ik,fij,jk->f", basis, group.H, basis) / max(basis.shape[1], 1)
    return group.h @ basis, np.maximum(weight, 1e-9)
