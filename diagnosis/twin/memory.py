r"""The memory of a twin: how measured channels follow simulated ones, learned from flights.

    measured = s + sum_k g_k d(t - k) + b_1 v + b_2 v |v| + b_3 d^3 + offset,    d = s - level

| symbol | name | unit |
|---|---|---|
| s | simulated channel | rad, m/s^2 |
| level | mean of s in the flights that the memory is learned from | rad, m/s^2 |
| g | impulse response of what the simulator lacks | - |
| v | velocity along the channel, heading frame | m/s |

Yaw and the vertical acceleration take the climb rate and the squared ground speed in place of v,
v |v| and d^3, and the latter takes the simulated thrust over mass, (s + g) / g, in place of an
offset: hover flights cannot tell the two, but of rotors that are weaker than believed twice the
thrust lacks twice as much. With an offset, `crazyflie_changed` came out as 38 % more mass; what was
changed there is not documented (ten grams, +31 %, is our guess). Roll and pitch share their
numbers, and so do both horizontal accelerations: a quadrotor looks alike after a quarter of a turn.
The model is linear in its numbers. It simulates: no measured value of a channel enters the
prediction of this channel. Its error is that of a whole simulation, not of one step ahead.

The vertical memory has no static gain (sum_k g_k = 0). A pilot or controller that holds height
moves the thrust against whatever disturbs the drone, so that flights say that thrust moves nothing:
on `crazyflie_plain` the sum was -0.9, and a change of thrust came out of the twin as a tenth of
itself. How thrust over mass becomes acceleration is physics and is left to the simulator.

g has the Gaussian prior cov(g_i, g_j) = strength * decay^max(i, j), whose responses are smooth and
die out (the TC kernel: Chen, Ohlsson and Ljung, Automatica 48 (2012), Eq. 17). The prior around
g = 0 is the belief in the simulator. `strength` and `decay` are taken from `GRID` by the error on
left-out flights; where the best of them gains no more than one standard error over flights, g = 0
stays (the one-standard-error rule: Breiman et al. 1984). Reference flights that hardly turn say
nothing of how the heading follows: a memory that 18 flights of `crazyflie_plain` gained 4 % by
missed a full turn by 88 degrees, the simulator by 8.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from diagnosis.twin.channels import Channels, N
from simulators.vehicle import GRAVITY

LENGTH = 40
"""Length of the memory [samples]: 0.8 s. On `crazyflie_plain` 0.3 s left 10 % more of roll."""
GROUPS = ((0, 1), (2,), (3, 4), (5,))
"""Channels that share their numbers."""
ALONG = {0: (1, -1.0), 1: (0, 1.0), 3: (0, 1.0), 4: (1, 1.0)}
"""Axis and sign of the velocity that belongs to a horizontal channel: roll leans to the right."""
UP = 5
"""The vertical acceleration."""
STATIC = {(UP,)}
"""Groups whose static gain is the simulator's."""
RIGID = 1e6
"""Precision with which the sum of such a memory is zero."""
GRID = tuple((strength, decay) for strength in (0.01, 0.1, 1.0) for decay in (0.8, 0.9, 0.95))
"""Priors that left-out flights choose from."""
NONE = (1e-6, 0.8)
"""A prior that leaves no response: the simulator's own."""
OTHERS = 10.0
"""Standard deviation of the prior of b and the offset, in units of a channel's gap; a choice."""
CUBE = 0.1
"""What d over its unit is multiplied by before it is cubed; scales b_3."""


@dataclasses.dataclass(frozen=True)
class Scale:
    """What the channels of some flights are like."""

    unit: Float[np.ndarray, " 6"]
    """Root mean square of each channel's gap; channels of a group have the larger."""
    level: Float[np.ndarray, " 6"]
    """Mean of each simulated channel."""


@dataclasses.dataclass(frozen=True)
class Memory:
    """Numbers of a fitted memory."""

    scale: Scale
    """Of the flights that it was learned from."""
    weights: tuple[Float[np.ndarray, " _"], ...]
    """The numbers of each group of `GROUPS`."""

    @property
    def _per_g(self) -> float:
        """Slope of the feature that stands for thrust over mass."""
        return float(self.scale.unit[UP]) / GRAVITY

    def predict(self, flight: Channels) -> Float[np.ndarray, "time 6"]:
        """What the memory adds to the simulated channels of a flight."""
        added = np.zeros_like(flight.measured)
        for group, weights in zip(GROUPS, self.weights, strict=True):
            for c in group:
                added[:, c] = features(flight, c, self.scale) @ weights
        return added

    def respond(self, flight: Channels) -> Float[np.ndarray, "params time 6"]:
        """The slopes of the twin's channels: those of the simulator through the memory."""
        out = flight.slopes.copy()
        for group, weights in zip(GROUPS, self.weights, strict=True):
            for c in group:
                slopes = flight.slopes[:, :, c].T
                out[:, :, c] += (lagged(slopes) @ weights[:LENGTH]).T
                if c == UP:
                    out[:, :, c] += flight.slopes[:, :, c] * weights[-1] * self._per_g
                if c in ALONG:
                    d = flight.simulated[:, c] - self.scale.level[c]
                    cubed = 3.0 * _cube_scale(self.scale.unit[c]) * d**2 * weights[LENGTH + 2]
                    out[:, :, c] += (cubed[:, None] * slopes).T
        return out


def lagged(x: Float[np.ndarray, "..."]) -> Float[np.ndarray, "..."]:
    """`x` now and up to `LENGTH` samples ago (last axis); before its start it stood still."""
    padded = np.concatenate([np.repeat(x[:1], LENGTH - 1, axis=0), x])
    windows = np.lib.stride_tricks.sliding_window_view(padded, LENGTH, axis=0)
    return windows[..., ::-1]


def features(flight: Channels, channel: int, scale: Scale) -> Float[np.ndarray, "time features"]:
    """What a channel's prediction is linear in."""
    unit, vel = scale.unit[channel], flight.vel
    d = flight.simulated[:, channel] - scale.level[channel]
    group = next(g for g in GROUPS if channel in g)
    if channel in ALONG:
        axis, sign = ALONG[channel]
        v = sign * vel[:, axis]
        more = [v * unit, v * np.abs(v) * unit, _cube_scale(unit) * d**3]
    else:
        more = [vel[:, 2] * unit, (vel[:, 0] ** 2 + vel[:, 1] ** 2) * unit]
    offsets = [np.full(len(d), unit * (other == channel)) for other in group]
    if channel == UP:
        offsets = [unit * (flight.simulated[:, UP] + GRAVITY) / GRAVITY]
    return np.concatenate([lagged(d), np.stack([*more, *offsets], axis=1)], axis=1)


def _cube_scale(unit: float) -> float:
    """Factor of d^3: (d CUBE / unit)^3 in units of the channel."""
    return CUBE**3 / unit**2


@dataclasses.dataclass(frozen=True)
class Gram:
    """Normal equations of a flight's memory, one entry a group."""

    A: tuple[Float[np.ndarray, "_ _"], ...]
    """Features by features."""
    b: tuple[Float[np.ndarray, " _"], ...]
    """Features by gap."""


def scale_of(flights: Sequence[Channels]) -> Scale:
    """The scale of some flights."""
    gap = np.concatenate([f.gap[f.valid] for f in flights])
    level = np.concatenate([f.simulated[f.valid] for f in flights]).mean(axis=0)
    each = np.sqrt(np.mean(gap**2, axis=0)) + 1e-6
    unit = np.zeros(N)
    for group in GROUPS:
        unit[list(group)] = max(each[c] for c in group)
    return Scale(unit, level)


def gram(flight: Channels, scale: Scale) -> Gram:
    """The normal equations of a flight, in units of the gap."""
    A, b = [], []
    for group in GROUPS:
        size = len(features(flight, group[0], scale)[0])
        square, right = np.zeros((size, size)), np.zeros(size)
        for channel in group:
            x = features(flight, channel, scale)[flight.valid] / scale.unit[channel]
            y = flight.gap[flight.valid, channel] / scale.unit[channel]
            square, right = square + x.T @ x, right + x.T @ y
        A.append(square)
        b.append(right)
    return Gram(tuple(A), tuple(b))


def _precision(
    group: tuple[int, ...], size: int, strength: float, decay: float
) -> Float[np.ndarray, "features features"]:
    """Inverse covariance of the prior."""
    i = np.arange(LENGTH)
    kernel = strength * decay ** np.maximum.outer(i, i) + 1e-9 * strength * np.eye(LENGTH)
    precision = np.eye(size) / OTHERS**2
    precision[:LENGTH, :LENGTH] = np.linalg.inv(kernel) + RIGID * (group in STATIC)
    return precision


def fit_memories(grams: Sequence[Gram], scale: Scale) -> tuple[Memory, tuple[Memory, ...]]:
    """The memory of all flights, and for each flight that of all others.

    The prior of each group is the one under which left-out flights are predicted best.
    """
    whole, without = [], []
    for g, group in enumerate(GROUPS):
        A, b = np.stack([x.A[g] for x in grams]), np.stack([x.b[g] for x in grams])
        tried = []
        for strength, decay in (NONE, *GRID):
            prior = _precision(group, len(b[0]), strength, decay)
            others = np.linalg.solve(A.sum(0) - A + prior, (b.sum(0) - b)[..., None])[..., 0]
            quadratic = np.einsum("fi,fij,fj->f", others, A, others)
            error = quadratic - 2.0 * np.sum(b * others, axis=1)
            tried.append((error, np.linalg.solve(A.sum(0) + prior, b.sum(0)), others))
        best = min(tried, key=lambda one: float(one[0].sum()))
        gain = tried[0][0] - best[0]
        if gain.mean() <= np.std(gain, ddof=1) / np.sqrt(len(gain)):
            best = tried[0]
        whole.append(best[1])
        without.append(best[2])
    left_out = tuple(Memory(scale, tuple(w[i] for w in without)) for i in range(len(grams)))
    return Memory(scale, tuple(whole)), left_out


def rms(
    errors: Sequence[np.ndarray], valid: Sequence[Bool[np.ndarray, " _"]]
) -> Float[np.ndarray, " 6"]:
    """Root mean square of each channel over all flights."""
    joined = np.concatenate([e[v] for e, v in zip(errors, valid, strict=True)])
    return np.sqrt(np.mean(joined**2, axis=0))
