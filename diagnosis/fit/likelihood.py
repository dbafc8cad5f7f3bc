r"""Windowed rollout likelihood and its normal equations.

Within a window the measurements y of all nodes are

    y = f(theta) + G x + noise,      noise ~ N(0, diag(sigma^2)),

with f the replayed window from a smoothed start and x the error of that start (position and
velocity, six numbers a drone), which nothing is known of and which is projected out. What is left
is independent from window to window, because windows share no row. In the first windows (`SHOWN`)
after the attitude was set to a measured one, y also holds A z with z ~ N(0, 1), errors of that
attitude, the angular velocity and the rotors (`TURN`); r and J below are multiplied by
(I + A A')^(-1/2), A taken at one vector for all (`settle`). Where all attitudes are measured ones,
the noise of every window's force takes their place (`shaken`): clean flights were `unexplained`
without it. With r the projected, whitened residual, J its derivative, every candidate set needs

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
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int

from diagnosis.logs.noise import UNSEEN
from diagnosis.logs.segments import WINDOW, Segments, enough
from diagnosis.replay.replay import Prediction, Replay
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

KEPT = 2**29
"""Bytes of replays that are kept, so that scoring a fit does not fly it again; two at least."""
NARROW = 8
"""Directions of a replay along some parameters only; all of them cost several times as much."""
SLOPES = 2**28
"""Most bytes of slopes that are kept for replays along few parameters."""


@dataclasses.dataclass(frozen=True)
class Normal:
    """Normal equations at one parameter vector, per window (of all drones together)."""

    vector: Float[np.ndarray, " params"]
    """Where the simulator was linearised."""
    H: Float[np.ndarray, "windows params params"]
    """J'J."""
    g: Float[np.ndarray, "windows params"]
    """J'r."""
    c: Float[np.ndarray, " windows"]
    """r'r, the window's chi-square."""
    dof: Float[np.ndarray, " windows"]
    """Numbers in r less the numbers of the start."""
    flight: Int[np.ndarray, " windows"]
    """Flight of each window."""
    t: Float[np.ndarray, " windows"]
    """Start of each window since the flight's first row [s]."""
    kind: Float[np.ndarray, "windows 9"]
    """chi-square of each channel."""
    doubtful: Bool[np.ndarray, " windows"]
    """Windows in which an unknown command may still show."""

    @property
    def chi2(self) -> float:
        """Chi-square of all windows."""
        return float(self.c.sum())

    @property
    def misfit(self) -> Float[np.ndarray, " windows"]:
        """Chi-square of each window over its numbers."""
        return self.c / np.maximum(self.dof, 1.0)

    def of(self, chosen: np.ndarray) -> "Normal":
        """The windows that are chosen, by a mask or by their indices."""
        per_window = {
            field.name: getattr(self, field.name)[chosen]
            for field in dataclasses.fields(self)
            if field.name != "vector"
        }
        return dataclasses.replace(self, **per_window)

    def by_flight(self) -> list["Normal"]:
        """Those of every flight."""
        return [self.of(self.flight == flight) for flight in np.unique(self.flight)]


Spoiled = Callable[[Normal], Bool[np.ndarray, " windows"]]
"""Which windows are not to count (`outliers.py`)."""


@dataclasses.dataclass(frozen=True)
class Tracks:
    """Windows as they were measured and predicted, one line a drone and window."""

    row: Float[np.ndarray, "lines nodes 9"]
    """Measured position [m], velocity [m/s], roll, pitch, yaw [rad]."""
    residual: Float[np.ndarray, "lines nodes 9"]
    """Measured minus predicted."""
    time: Float[np.ndarray, "lines nodes"]
    """Time of each node since the start of its window [s]."""
    valid: Bool[np.ndarray, "lines nodes"]
    """Which nodes count."""
    thrust: Float[np.ndarray, " lines"]
    """Mean commanded thrust [N]."""
    distance: Float[np.ndarray, " lines"]
    """Smallest distance to another drone [m]; infinite for a drone alone."""
    battery: Float[np.ndarray, " lines"]
    """Mean voltage of the battery [V]; NaN where it is not known."""
    flight: Int[np.ndarray, " lines"]
    """Flight of each line."""
    t: Float[np.ndarray, " lines"]
    """Start of the window since the flight's first row [s]."""


class Likelihood:
    """The likelihood of flights under one library; flights with as many drones make a group.

    `shake` is the noise of a window's mean force [m/s^2] where measured attitudes are prescribed.
    `aside` are the windows that do not count, `typical` is the misfit of those that do.
    """

    def __init__(
        self,
        replay: Replay,
        groups: Sequence[Segments],
        sigma: Float[np.ndarray, " 9"],
        shake: float = 0.0,
    ) -> None:
        self.replay, self.groups, self.sigma, self.shake = replay, list(groups), sigma, shake
        self.n_params = len(replay.library.slots)
        self.trusted: Bool[np.ndarray, " windows"] | None = None
        self.aside: Normal | None = None
        self.typical = 1.0
        self._replays: dict[tuple, tuple[dict, dict]] = {}
        self._settled = np.array(replay.library.neutral, float)
        self._turns: dict[tuple[int, int], Turns] = {}
        self._slopes: dict[tuple[int, int], np.ndarray] = {}

    @property
    def n_channels(self) -> int:
        """Numbers that a node measures: nine, six without a prescribed attitude's."""
        return int(np.count_nonzero(self.sigma < UNSEEN))

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
        whole = Normal(vector=np.array(vector, float), **equations)
        counted = whole.dof > 0 if self.trusted is None else self.trusted
        return whole if counted.all() else whole.of(counted)

    def _replayed(
        self,
        vectors: Float[np.ndarray, "*flights params"],
        along: Sequence[int] | None = None,
        others: bool = False,
    ) -> tuple[dict, dict]:
        """Equations and tracks of all windows; the last few replays are kept."""
        vectors = np.asarray(vectors, float)
        if not self._turns and not np.array_equal(vectors, self._settled):
            self._replayed(self._settled)
        known = self._turns and (self._slopes or not others)
        if along is not None and (len(along) > NARROW or not known):
            along = None
        same = vectors.tobytes() + self.sigma.tobytes()
        key = (same, along if along is None else tuple(along), others and along is not None)
        found = self._replays.get((same, None, False)) or self._replays.get(key)
        if found is None:
            found = self._fly(vectors, along, others)
            self._forget(_bytes(found))
            self._replays[key] = found
        return found

    # Parameters at which a simulation blows up give NaN, which no comparison prefers.
    @np.errstate(invalid="ignore", over="ignore")
    def _fly(
        self,
        vectors: Float[np.ndarray, "*flights params"],
        along: Sequence[int] | None,
        others: bool,
    ) -> tuple[dict, dict]:
        """Equations along all parameters or those at `along`, and tracks."""
        if along is None:
            self._slopes.clear()
        equations, tracks = [], []
        chosen_params = range(self.n_params) if along is None else along
        directions = np.zeros((self.n_params if along is None else NARROW, self.n_params))
        directions[np.arange(len(chosen_params)), list(chosen_params)] = 1.0
        for i, group in enumerate(self.groups):
            n_flights = max(int(group.flight.max()) + 1, len(np.atleast_2d(vectors)))
            each = np.broadcast_to(vectors, (n_flights, self.n_params))
            for chosen, prediction in self.replay(group, each, directions, turns=along is None):
                at = (i, chosen.start)
                if at not in self._turns:
                    self._turns[at] = self._turned(group, chosen, prediction)
                r, J = self.whitened(group, chosen, prediction, self._turns[at])
                if along is None:
                    self._keep(at, J)
                elif others:
                    J = np.concatenate([J[: len(along)], self._slopes[at]])
                    J = J[self._merged(along)]
                found = self._equations(group, chosen, r, J, self._turns[at])
                if along is not None and not others:
                    found = self._spread(found, along)
                equations.append(found)
                tracks.append(self._tracks(group, chosen, prediction))
        return _joined(equations), _joined(tracks)

    def _keep(self, at: tuple[int, int], slopes: np.ndarray) -> None:
        """Remembers the slopes of a batch; none at all if they are too many or not finite."""
        slopes = slopes.astype(np.float32)
        kept = sum(x.nbytes for x in self._slopes.values()) + slopes.nbytes
        first = at == (0, 0)
        if (first or self._slopes) and kept <= SLOPES and np.isfinite(slopes).all():
            self._slopes[at] = slopes
        else:
            self._slopes.clear()

    def _merged(self, along: Sequence[int]) -> Int[np.ndarray, " params"]:
        """Where each parameter's slope stands among those at `along`, followed by those of all."""
        places = len(along) + np.arange(self.n_params)
        places[list(along)] = np.arange(len(along))
        return places

    def _spread(
        self, equations: dict[str, np.ndarray], along: Sequence[int]
    ) -> dict[str, np.ndarray]:
        """Equations along the parameters at `along` as equations along all."""
        n, k, at = len(equations["c"]), len(along), np.asarray(along, int)
        H, g = np.zeros((n, self.n_params, self.n_params)), np.zeros((n, self.n_params))
        H[:, at[:, None], at] = equations["H"][:, :k, :k]
        g[:, at] = equations["g"][:, :k]
        return equations | {"H": H, "g": g}

    def _forget(self, room: int) -> None:
        """Drops the oldest replays until there is room for another of so many bytes."""
        sizes = {key: _bytes(found) for key, found in self._replays.items()}
        for key in list(sizes):
            if len(self._replays) < 2 or sum(sizes.values()) + room <= KEPT:
                return
            del self._replays[key], sizes[key]

    def settle(self, vector: Float[np.ndarray, " params"], spoiled: Spoiled | None = None) -> None:
        """Takes errors of the start to act as at `vector`; windows `spoiled` there do not count."""
        self._settled, self.trusted = np.array(vector, float), None
        self._turns.clear()
        self._slopes.clear()
        self._replays.clear()
        normal = self.normal(vector)
        bad = np.zeros(len(normal.c), bool) if spoiled is None else spoiled(normal)
        self.aside = normal.of(bad)
        self.typical = float(np.median(normal.misfit[~bad])) if not bad.all() else 1.0
        counted = np.concatenate([self._dof(group) for group in self.groups]) > 0
        trusted = counted.copy()
        trusted[counted] = ~bad
        self.trusted = trusted

    def _dof(self, group: Segments) -> Float[np.ndarray, " windows"]:
        return self._numbers(self._valid(group, slice(None))).reshape(-1).astype(float)

    def _numbers(self, valid: Bool[np.ndarray, "segments windows drones nodes"]) -> np.ndarray:
        """Numbers of each window less those of the start; a prescribed attitude counts none."""
        return np.sum(self.n_channels * valid.sum(axis=3) - 6 * valid.any(axis=3), axis=2)

    def _equations(
        self, group: Segments, chosen: slice, r: np.ndarray, J: np.ndarray, turns: Turns
    ) -> dict[str, np.ndarray]:
        n_windows = r.shape[0] * r.shape[1]
        flat = r.reshape(n_windows, -1)
        J = np.moveaxis(J.reshape(len(J), n_windows, -1), 0, 1)
        dof = self._numbers(self._valid(group, chosen)).reshape(n_windows)
        index = np.arange(1, r.shape[1] + 1)
        return {
            "H": J @ np.swapaxes(J, 1, 2),
            "g": np.einsum("wpm,wm->wp", J, flat),
            "c": np.sum(flat**2, axis=1),
            "dof": dof - turns.spent.reshape(n_windows, -1).sum(axis=1),
            "flight": np.repeat(group.flight[chosen], r.shape[1]),
            "t": (group.start[chosen][:, None] + WINDOW * index).reshape(-1),
            "kind": np.sum(r**2, axis=(2, 3)).reshape(n_windows, 9),
            "doubtful": group.doubtful[chosen, 1:].reshape(-1),
        }

    def tracks(self, vectors: Float[np.ndarray, "*flights params"]) -> Tracks:
        """Measured and predicted windows, at one vector or at one for each flight."""
        joined = self._replayed(vectors, ())[1]
        some = joined["valid"].any(axis=1)
        if self.trusted is not None:
            some &= np.concatenate(self._per_line(self.trusted))
        return Tracks(**{key: value[some] for key, value in joined.items()})

    def _per_line(self, windows: Bool[np.ndarray, " windows"]) -> list[np.ndarray]:
        """Something per window, repeated for every drone, group by group."""
        found, begin = [], 0
        for group in self.groups:
            segments, edges, drones = group.pos.shape[:3]
            count = segments * (edges - 1)
            found.append(np.repeat(windows[begin : begin + count], drones))
            begin += count
        return found

    def _tracks(
        self, group: Segments, chosen: slice, prediction: Prediction
    ) -> dict[str, np.ndarray]:
        valid = self._valid(group, chosen)
        shape = valid.shape[:3]
        lines = int(np.prod(shape))
        row = group.row[chosen, 1:]
        thrust = group.cmd[chosen].reshape(shape[0], shape[1] + 1, -1, shape[2], 4)[..., 3]
        pos = group.pos[chosen, 1:]
        apart = np.linalg.norm(pos[:, :, :, None] - pos[:, :, None], axis=-1)
        apart = np.where(np.eye(shape[2], dtype=bool), np.inf, apart).min(axis=-1)
        nodes = valid.shape[3]
        battery = np.full(shape, np.nan)
        volts = group.voltage[chosen].reshape(shape[0], shape[1] + 1, -1)[:, 1:].mean(axis=2)
        battery[..., 0] = np.where(volts > 0.0, volts, np.nan)
        start = group.start[chosen][:, None] + WINDOW * np.arange(1, shape[1] + 1)
        per_drone = lambda x: np.broadcast_to(x[..., None], shape).reshape(lines)  # noqa: E731
        return {
            "row": row.reshape(lines, nodes, 9),
            "residual": residual(row, prediction.value).reshape(lines, nodes, 9),
            "time": (group.place[chosen, 1:] * self.replay.dt).reshape(lines, nodes),
            "valid": valid.reshape(lines, nodes),
            "thrust": thrust[:, 1:].mean(axis=2).reshape(lines),
            "distance": apart.reshape(lines),
            "battery": battery.reshape(lines),
            "flight": per_drone(np.repeat(group.flight[chosen][:, None], shape[1], axis=1)),
            "t": per_drone(start),
        }

    def _valid(
        self, group: Segments, chosen: slice
    ) -> Bool[np.ndarray, "segments windows drones nodes"]:
        return enough(group.valid[chosen, 1:])

    def whitened(
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
        return self._valid(group, chosen)[..., None] / self.sigma

    def _turned(self, group: Segments, chosen: slice, prediction: Prediction) -> Turns:
        turned = shown(group.fresh[chosen])
        A = prediction.turn.astype(float) * TURN.reshape(-1, *[1] * 5)
        if self.shake:
            t = group.place[chosen, 1:][..., None] * self.replay.dt
            A, turned = shaken(t, WINDOW, self.shake), np.ones_like(turned)
        A = projected(A * self._scale(group, chosen), self._starts(group, chosen))
        return make_turns(A[:, turned], turned)

    def _starts(self, group: Segments, chosen: slice) -> Float[np.ndarray, "..."]:
        """Basis of what starts can change [2, pos/vel, segments, windows, drones, nodes, axes]."""
        dt, valid = self.replay.dt, self._valid(group, chosen)
        t = group.place[chosen, 1:][..., None] * dt
        counted = np.maximum(valid.sum(axis=3), 1)[..., None]
        vel = np.sum(group.row[chosen, 1:, ..., 3:6] * valid[..., None], axis=3) / counted
        rate = self.replay.library.braking(self._settled, vel)[..., None, :]
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


def _bytes(found: tuple[dict, dict]) -> int:
    return sum(array.nbytes for part in found for array in part.values())


def _joined(parts: Sequence[dict[str, np.ndarray]]) -> dict[str, np.ndarray]:
    return {key: np.concatenate([part[key] for part in parts]) for key in parts[0]}
