r"""Windowed rollout likelihood and its normal equations.

Within a window the measurements y of all nodes are

    y = f(theta) + G x + noise,      noise ~ N(0, diag(sigma^2)),

with f the replayed window from a smoothed start and x the error of that start (position and
velocity, six numbers a drone), which nothing is known of and which is projected out. What is left
is independent from window to window, because windows share no row. In the first windows (`SHOWN`)
after the attitude was set to a measured one, y also holds A z with z ~ N(0, 1), errors of that
attitude, the angular velocity and the rotors (`TURN`); r and J below are multiplied by
(I + A A')^(-1/2), A taken at one vector for all (`Likelihood.settled`). Where all attitudes are
measured ones, the noise of every window's force takes their place (`shaken`): clean flights were
`unexplained` without it. With r the projected, whitened residual, J its derivative, every candidate
set needs

    H = J'J,   g = J'r,   c = r'r,   summed over windows and kept per window and flight.

| symbol | name | unit |
|---|---|---|
| sigma | noise of each channel | m, m/s, rad |
| G | [1, (1 - exp(-d t)) / d; 0, exp(-d t)], d = rate of all drag (`braking`) | -, s |

G belongs to one vector for all, like A. With d of the nominal simulator, a point mass without drag
and a drag of 1 1/s in the flights, 2 of 3 sets of flights came with a small third effect that was
not there.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from diagnosis.fit.replay_cache import Flown, ReplayCache
from diagnosis.fit.windows import Normal, Spoiled, Tracks, counted, tracked
from diagnosis.logs.noise import UNSEEN_ATTITUDE_RAD
from diagnosis.logs.segments import REPLAY_WINDOW_S, Segments
from diagnosis.replay.library import Library
from diagnosis.replay.replay import NARROW, Prediction, Replay, directions_along
from diagnosis.replay.whitening import (
    TURN,
    Turns,
    make_turns,
    projected,
    residual,
    shaken,
    shown,
    unit,
)


@dataclasses.dataclass(frozen=True)
class Likelihood:
    """The likelihood of flights under one library; flights with as many drones make a group."""

    replay: Replay
    """The library, and how its commands are flown."""
    groups: Sequence[Segments]
    """Flights cut into windows."""
    sigma: Float[np.ndarray, " 9"]
    """Noise of each channel [m, m/s, rad]."""
    shake: float = 0.0
    """Noise of a window's mean force [m/s^2] where measured attitudes are prescribed."""
    settled_at: Float[np.ndarray, " params"] | None = None
    """Vector as at which errors of the start act; the nominal simulator's if None."""
    trusted: Bool[np.ndarray, " windows"] | None = None
    """Windows that count; all that hold numbers if None."""
    aside: Normal | None = None
    """Windows that were left out when this was settled."""
    typical: float = 1.0
    """Misfit of the median window that counts."""
    narrow: bool = True
    """Whether replays along few parameters have a program of their own, which must be compiled."""
    cache: ReplayCache = dataclasses.field(default_factory=ReplayCache, repr=False, compare=False)
    """Replays flown so far. A likelihood with another noise or start needs another cache."""

    @property
    def library(self) -> Library:
        """The effects and the simulator."""
        return self.replay.library

    @property
    def n_params(self) -> int:
        """Entries of a vector."""
        return len(self.library.slots)

    @property
    def n_channels(self) -> int:
        """Numbers that a node measures: nine, six without a prescribed attitude's."""
        return int(np.count_nonzero(self.sigma < UNSEEN_ATTITUDE_RAD))

    def noisier(self, factor: Float[np.ndarray, " 9"] | float) -> "Likelihood":
        """The same flights with the noise of each channel multiplied by `factor`."""
        return dataclasses.replace(self, sigma=self.sigma * factor, cache=ReplayCache())

    def settled(
        self, vector: Float[np.ndarray, " params"], spoiled: Spoiled | None = None
    ) -> "Likelihood":
        """With errors of the start as at `vector`, and without the windows `spoiled` there."""
        every = dataclasses.replace(
            self, settled_at=np.array(vector, float), trusted=None, cache=ReplayCache()
        )
        normal = every.normal(vector)
        bad = np.zeros(len(normal.c), bool) if spoiled is None else spoiled(normal)
        whole = np.concatenate([every._dof(group) for group in every.groups]) > 0
        trusted = whole.copy()
        trusted[whole] = ~bad
        return dataclasses.replace(
            every,
            trusted=trusted,
            aside=normal.of(bad),
            typical=float(np.median(normal.misfit[~bad])) if not bad.all() else 1.0,
        )

    def normal(
        self,
        vector: Float[np.ndarray, " params"],
        along: Sequence[int] | None = None,
        others: bool = False,
    ) -> Normal:
        """Normal equations at `vector` of the windows that are trusted.

        Along all parameters, or at least along those at `along`. The entries of others may be zero,
        or, if `others`, have the slopes of the last replay along all parameters.
        """
        equations, _ = self._replayed(vector, along, others)
        whole = Normal(**equations)
        kept = whole.dof > 0 if self.trusted is None else self.trusted
        return whole if kept.all() else whole.of(kept)

    def tracks(self, vectors: Float[np.ndarray, "*flights params"]) -> Tracks:
        """Measured and predicted windows, at one vector or at one for each flight."""
        joined = self._replayed(vectors, ())[1]
        some = joined["valid"].any(axis=1)
        if self.trusted is not None:
            some &= np.concatenate(self._per_line(self.trusted))
        return Tracks(**{key: value[some] for key, value in joined.items()})

    @property
    def _start_vector(self) -> Float[np.ndarray, " params"]:
        return self.library.neutral if self.settled_at is None else self.settled_at

    def _replayed(
        self,
        vectors: Float[np.ndarray, "*flights params"],
        along: Sequence[int] | None = None,
        others: bool = False,
    ) -> Flown:
        """Equations and tracks of all windows; the last few replays are kept."""
        vectors, cache = np.asarray(vectors, float), self.cache
        if not cache.turns and not np.array_equal(vectors, self._start_vector):
            self._replayed(self._start_vector)
        known = cache.turns and (cache.slopes or not others)
        if along is not None and (len(along) > NARROW or not known or not self.narrow):
            along = None
        same = vectors.tobytes()
        key = (same, along if along is None else tuple(along), others and along is not None)
        found = cache.replays.get((same, None, False)) or cache.replays.get(key)
        if found is None:
            found = self._fly(vectors, along, others)
            cache.keep(key, found)
        return found

    # Parameters at which a simulation blows up give NaN, which no comparison prefers.
    @np.errstate(invalid="ignore", over="ignore")
    def _fly(
        self,
        vectors: Float[np.ndarray, "*flights params"],
        along: Sequence[int] | None,
        others: bool,
    ) -> Flown:
        """Equations along all parameters or those at `along`, and tracks."""
        if along is None:
            self.cache.slopes.clear()
        equations, tracks = [], []
        directions = directions_along(self.n_params, along)
        for i, group in enumerate(self.groups):
            n_flights = max(int(group.flight.max()) + 1, len(np.atleast_2d(vectors)))
            each = np.broadcast_to(vectors, (n_flights, self.n_params))
            for chosen, prediction in self.replay(group, each, directions, turns=along is None):
                at = (i, chosen.start)
                if at not in self.cache.turns:
                    self.cache.turns[at] = self._turned(group, chosen, prediction)
                turns = self.cache.turns[at]
                r, J = self._whitened(group, chosen, prediction, turns)
                if along is None:
                    self.cache.keep_slopes(at, J)
                elif others:
                    J = self.cache.merged_slopes(at, along, J)
                found = self._equations(group, chosen, r, J, turns)
                if along is not None and not others:
                    found = self._spread(found, along)
                equations.append(found)
                tracks.append(tracked(group, chosen, prediction, self.replay.dt))
        return _joined(equations), _joined(tracks)

    def _spread(
        self, equations: dict[str, np.ndarray], along: Sequence[int]
    ) -> dict[str, np.ndarray]:
        """Equations along the parameters at `along` as equations along all."""
        n, k, at = len(equations["c"]), len(along), np.asarray(along, int)
        H, g = np.zeros((n, self.n_params, self.n_params)), np.zeros((n, self.n_params))
        H[:, at[:, None], at] = equations["H"][:, :k, :k]
        g[:, at] = equations["g"][:, :k]
        return equations | {"H": H, "g": g}

    def _dof(self, group: Segments) -> Float[np.ndarray, " windows"]:
        return self._numbers(counted(group, slice(None))).reshape(-1).astype(float)

    def _numbers(self, valid: Bool[np.ndarray, "segments windows drones nodes"]) -> np.ndarray:
        """Numbers of each window less those of the start; a prescribed attitude counts none."""
        return np.sum(self.n_channels * valid.sum(axis=3) - 6 * valid.any(axis=3), axis=2)

    def _equations(
        self, group: Segments, chosen: slice, r: np.ndarray, J: np.ndarray, turns: Turns
    ) -> dict[str, np.ndarray]:
        n_windows = r.shape[0] * r.shape[1]
        flat = r.reshape(n_windows, -1)
        J = np.moveaxis(J.reshape(len(J), n_windows, -1), 0, 1)
        dof = self._numbers(counted(group, chosen)).reshape(n_windows)
        index = np.arange(1, r.shape[1] + 1)
        return {
            "H": J @ np.swapaxes(J, 1, 2),
            "g": np.einsum("wpm,wm->wp", J, flat),
            "c": np.sum(flat**2, axis=1),
            "dof": dof - turns.spent.reshape(n_windows, -1).sum(axis=1),
            "flight": np.repeat(group.flight[chosen], r.shape[1]),
            "t": (group.start[chosen][:, None] + REPLAY_WINDOW_S * index).reshape(-1),
            "kind": np.sum(r**2, axis=(2, 3)).reshape(n_windows, 9),
            "doubtful": group.doubtful[chosen, 1:].reshape(-1),
        }

    def _per_line(self, windows: Bool[np.ndarray, " windows"]) -> list[np.ndarray]:
        """Something per window, repeated for every drone, group by group."""
        found, begin = [], 0
        for group in self.groups:
            segments, edges, drones = group.pos.shape[:3]
            count = segments * (edges - 1)
            found.append(np.repeat(windows[begin : begin + count], drones))
            begin += count
        return found

    def _whitened(
        self, group: Segments, chosen: slice, prediction: Prediction, turns: Turns
    ) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
        """Whitened residual and derivative without what the start of each window may explain."""
        scale = self._scale(group, chosen)
        r = residual(group.row[chosen, 1:], prediction.value) * scale
        basis = self._starts(group, chosen)
        r = projected(r[None], basis)
        J = projected(prediction.slope.astype(float) * scale, basis)
        return turns.taken(r)[0], turns.taken(J)

    def _scale(self, group: Segments, chosen: slice) -> Float[np.ndarray, "..."]:
        return counted(group, chosen)[..., None] / self.sigma

    def _turned(self, group: Segments, chosen: slice, prediction: Prediction) -> Turns:
        turned = shown(group.fresh[chosen])
        A = prediction.turn.astype(float) * TURN.reshape(-1, *[1] * 5)
        if self.shake:
            t = group.place[chosen, 1:][..., None] * self.replay.dt
            A, turned = shaken(t, REPLAY_WINDOW_S, self.shake), np.ones_like(turned)
        A = projected(A * self._scale(group, chosen), self._starts(group, chosen))
        return make_turns(A[:, turned], turned)

    def _starts(self, group: Segments, chosen: slice) -> Float[np.ndarray, "..."]:
        """Basis of what starts can change [2, pos/vel, segments, windows, drones, nodes, axes]."""
        dt, valid = self.replay.dt, counted(group, chosen)
        t = group.place[chosen, 1:][..., None] * dt
        nodes = np.maximum(valid.sum(axis=3), 1)[..., None]
        vel = np.sum(group.row[chosen, 1:, ..., 3:6] * valid[..., None], axis=3) / nodes
        rate = self.replay.library.braking(self._start_vector, vel)[..., None, :]
        rate = np.where(np.abs(rate) > 1e-6, rate, 1e-6)
        fade, reach = np.exp(-rate * t), -np.expm1(-rate * t) / rate
        on = valid[..., None] * np.ones(3)
        at_pos, at_vel = self.sigma[:3], self.sigma[3:6]
        columns = [
            np.stack([on / at_pos, np.zeros_like(on)]),
            np.stack([on * reach / at_pos, on * fade / at_vel]),
        ]
        design = np.stack(columns)  # 2, pos/vel, segments, windows, drones, nodes, axes
        first = unit(design[0])
        second = design[1] - first * np.sum(first * design[1], axis=(0, 4), keepdims=True)
        return np.stack([first, unit(second)])


def _joined(parts: Sequence[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
