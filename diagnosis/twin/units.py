r"""Two groups of flights compared, with flights as the unit of replication.

Each flight's score h_i and information H_i (`Score`) give, for a group of flights,

    theta = (sum H_i)^-1 sum h_i,      u_i = h_i - H_i theta.

The scatter of u_i between flights, not the noise within them, makes the covariance:

    cov(theta) = (sum H_i)^-1 (sum q_i) Omega (sum H_i)^-1
    Omega      = (d0 phi Hbar + dof * sum u_i u_i' / q_i / dof) / (d0 + dof)

| symbol | name |
|---|---|
| q_i | (m_i + m_i^2) / 2, m_i = the flight's information over the mean: half noise, half its own |
| Hbar | mean information of a flight |
| phi | median over parameters of the scatter over Hbar: how far flights differ beyond noise |
| d0 | flights that the common phi counts for; moderated variance (Smyth 2004, Sec. 3) |

Where each group is a single flight, phi is `DIFFER` times its length.

Parameters are in units of their range, with a prior of that width in every direction.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float
from scipy.stats import f as fisher

from diagnosis.logs.segments import NODE_DT
from diagnosis.twin.twin import Score

PRIOR_FLIGHTS = 4.0
"""d0. Logarithms of single scatters over phi have a standard deviation of 0.8 on
`crazyflie_plain`, as with 4 degrees of freedom."""

DIFFER = 0.65
"""phi over the length of a flight [1/s]: 0.65 (27 and 42 s) over 12 random halves of `nanobench`,
0.65 (3.7 and 5.8 s) of `crazyflie_plain`, medians. It grows with the length, because what differs
between flights stays for a whole flight."""


@dataclasses.dataclass(frozen=True)
class Group:
    """The scores of some flights, parameters in units of their range."""

    H: Float[np.ndarray, "flights params params"]
    """Information."""
    h: Float[np.ndarray, "flights params"]
    """Scores."""
    misfit: Float[np.ndarray, " flights"]
    """Chi-square per number of each."""
    samples: Float[np.ndarray, " flights"]
    """Samples of each that count."""

    def __len__(self) -> int:
        return len(self.h)

    def continued(self, change: Float[np.ndarray, " params"]) -> "Group":
        """Scores that were taken at a change, continued to no change."""
        return dataclasses.replace(self, h=self.h + self.H @ change)

    def without(self, i: int) -> "Group":
        """All flights but one."""
        left = (np.delete(x, i, axis=0) for x in vars(self).values())
        return Group(*left)


def make_group(scores: Sequence[Score], width: Float[np.ndarray, " params"]) -> Group:
    """Scores with parameters in units of `width`."""
    H = np.stack([s.H for s in scores]) * width[:, None] * width
    misfit = np.asarray([s.misfit for s in scores])
    samples = np.asarray([float(s.samples) for s in scores])
    return Group(H, np.stack([s.h for s in scores]) * width, misfit, samples)


@dataclasses.dataclass(frozen=True)
class Estimate:
    """Change of some parameters between two groups, in units of their range."""

    value: Float[np.ndarray, " k"]
    """Target minus reference."""
    cov: Float[np.ndarray, "k k"]
    """Covariance."""
    dof: float
    """Degrees of freedom of the covariance."""

    def p(self, columns: Sequence[int] | None = None) -> float:
        """Probability of values so far from zero, by Hotelling's test, of all or some of them."""
        at = list(range(len(self.value))) if columns is None else list(columns)
        value, cov = self.value[at], self.cov[np.ix_(at, at)]
        return hotelling(float(value @ np.linalg.solve(cov, value)), len(at), self.dof)

    def shrunk(self, width: float) -> Float[np.ndarray, " k"]:
        """The values, if changes are expected to be `width` times the range of their parameter.

        Values that flights hardly tell apart stay small: four gains of an attitude loop, taken as
        they fit best, went to three times their range and back.
        """
        return np.linalg.solve(np.eye(len(self.value)) + self.cov / width**2, self.value)

    @property
    def error(self) -> Float[np.ndarray, " k"]:
        """Standard errors."""
        return np.sqrt(np.diag(self.cov))


def hotelling(t2: float, k: int, dof: float) -> float:
    """Probability of a larger T^2 in `k` dimensions."""
    left = max(dof - k + 1.0, 1.0)
    return float(fisher.sf(t2 * left / (dof * k), k, left))


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Reference flights, left out in turn, beside target flights."""

    reference: Group
    """Undisturbed."""
    target: Group
    """Perhaps changed."""
    columns: tuple[int, ...]
    """The parameters that are compared."""
    phi: float
    """How far flights differ beyond noise, common to all of these."""

    @property
    def dof(self) -> float:
        """Degrees of freedom of every scatter."""
        return len(self.reference) + len(self.target) - 2.0 + PRIOR_FLIGHTS

    def level(self, group: Group, columns: Sequence[int]) -> Float[np.ndarray, " k"]:
        """The parameters at `columns` as one group shows them, estimated together.

        Of the reference flights, which nobody changed, that is what the twin misses in all flights
        that it does not know, as far as it resembles these effects.
        """
        part = _part(group, list(columns))
        return self._inverse(part) @ part.h.sum(axis=0)

    def _inverse(self, part: Group) -> Float[np.ndarray, "k k"]:
        """Inverse of a group's information."""
        return np.linalg.inv(part.H.sum(axis=0) + self.phi * np.eye(part.h.shape[1]))

    def estimate(self, columns: Sequence[int]) -> Estimate:
        """The change of the parameters at `columns`, estimated together."""
        groups = [_part(g, list(columns)) for g in (self.reference, self.target)]
        inverse = [self._inverse(g) for g in groups]
        theta = [i @ g.h.sum(axis=0) for i, g in zip(inverse, groups, strict=True)]
        scatter, dof, mean = _scatter(groups, theta)
        moderated = (PRIOR_FLIGHTS * self.phi * mean + scatter) / (PRIOR_FLIGHTS + dof)
        cov = sum(
            i @ moderated @ i * _weights(g, mean).sum()
            for i, g in zip(inverse, groups, strict=True)
        )
        return Estimate(theta[1] - theta[0], np.asarray(cov), self.dof)


def compare(reference: Group, target: Group, columns: Sequence[int]) -> Comparison:
    """Both groups with the common phi of the parameters at `columns`."""
    columns = tuple(columns)
    if len(reference) + len(target) == 2:
        length = float(np.mean([*reference.samples, *target.samples])) * NODE_DT
        return Comparison(reference, target, columns, max(1.0, DIFFER * length))
    ratios = []
    for k in columns:
        groups = [_part(g, [k]) for g in (reference, target)]
        if min(g.H.sum() for g in groups) <= 0.0:
            continue
        theta = [g.h.sum(axis=0) / (g.H.sum(axis=(0, 1)) + 1.0) for g in groups]
        scatter, dof, mean = _scatter(groups, theta)
        ratios.append(float(scatter[0, 0] / max(dof, 1.0) / mean[0, 0]))
    phi = max(1.0, float(np.median(ratios or [1.0])))
    return Comparison(reference, target, columns, phi)


def _part(group: Group, at: Sequence[int]) -> Group:
    return Group(group.H[:, at][:, :, at], group.h[:, at], group.misfit, group.samples)


def _weights(group: Group, mean: Float[np.ndarray, "k k"]) -> Float[np.ndarray, " flights"]:
    """q_i."""
    scale = np.maximum(np.diag(mean), 1e-300)
    m = np.mean(np.diagonal(group.H, axis1=1, axis2=2) / scale, axis=1)
    return np.maximum((m + m * m) / 2.0, 1e-12)


def _scatter(
    groups: Sequence[Group], theta: Sequence[Float[np.ndarray, " k"]]
) -> tuple[Float[np.ndarray, "k k"], float, Float[np.ndarray, "k k"]]:
    """Sum of u u' / q within both groups, its degrees of freedom, and the mean information."""
    mean = np.concatenate([g.H for g in groups]).mean(axis=0)
    total = np.zeros_like(mean)
    for group, at in zip(groups, theta, strict=True):
        u = (group.h - group.H @ at) / np.sqrt(_weights(group, mean))[:, None]
        total += u.T @ u
    return total, float(sum(len(g) - 1 for g in groups)), mean
