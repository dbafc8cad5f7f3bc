"""Flights cut into segments of equal shape: what one compiled replay takes.

A segment is a run of windows. At the start of every window position and velocity are set to
smoothed measurements, attitude and rotors run on under the commands, because those forget their
past within a fraction of a second while position never does. A window before the first one only
brings attitude and rotors up to date. Nodes are the log rows at which prediction and measurement
are compared, at most one per `NODE_DT`.

A missing row hides a command. Where the commands around it agree, the missing one is interpolated;
where they do not, or more rows are missing, the commands are held, the attitude is set to the
measured one at the next window, and no node counts until the rotors have followed (`FORGET`). The
time before a flight's first row is such a stretch, too.
"""

import dataclasses
import math
from collections.abc import Callable, Sequence

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy.spatial.transform import Rotation

from diagnosis.logs import noise
from diagnosis.logs.flights import DroneLog, FlightLog

REPLAY_WINDOW_S = 0.5
"""Length of a window [s]."""
N_WINDOWS = 20
"""Scored windows of a segment; one more comes before them."""
NODE_DT = 0.02
"""Shortest time between two nodes [s]."""
FORGET = 0.2
"""Time until rotors have forgotten an unknown command [s]: three time constants of `cf21B_500`, one
and a half of `cf2x_L250`, whose windows `DOUBT` covers."""
DOUBT = 1.5
"""Time after an unknown command in which a slow rotor may still show it [s]; a choice."""
HOLE = 1.6
"""Time between rows, in median ones, from which a row is missing."""
LARGEST_FILL = 0.07
"""Longest time between rows that is filled by interpolating commands [s]."""
FILL_ANGLE = 0.03
"""Largest change of a commanded angle that is filled [rad]."""
FILL_THRUST = 0.03
"""Largest relative change of commanded thrust that is filled."""
N_NODES = round(REPLAY_WINDOW_S / NODE_DT)
"""Places for nodes in a window."""


@dataclasses.dataclass(frozen=True)
class Segments:
    """Windows in order of flight and time. Axes: segments, windows, drones, then steps or nodes."""

    flight: Int[np.ndarray, " segments"]
    """Index of the flight that a segment belongs to."""
    start: Float[np.ndarray, " segments"]
    """Time at the start of the window before the first [s], since the flight's first row."""
    pos: Float[np.ndarray, "segments windows drones 3"]
    """Position at the start of each window, first the one before, smoothed [m]."""
    vel: Float[np.ndarray, "segments windows drones 3"]
    """Velocity there, smoothed [m/s]."""
    quat: Float[np.ndarray, "segments windows drones 4"]
    """Measured attitude at the start of each window, smoothed."""
    ang_vel: Float[np.ndarray, "segments windows drones 3"]
    """Angular velocity there, body frame [rad/s]."""
    fresh: Bool[np.ndarray, "segments windows drones"]
    """Where the attitude is set to the measured one, because a command before was unknown."""
    doubtful: Bool[np.ndarray, "segments windows"]
    """Windows less than `DOUBT` after an unknown command."""
    cmd: Float[np.ndarray, "segments steps drones 4"]
    """Command of every integration step: roll, pitch, yaw [rad], thrust [N]."""
    voltage: Float[np.ndarray, "segments steps"]
    """Battery voltage of the first drone [V]; zero where it was not logged."""
    row: Float[np.ndarray, "segments windows drones nodes 9"]
    """Measured position [m], velocity [m/s] and attitude as roll, pitch, yaw [rad]."""
    place: Float[np.ndarray, "segments windows drones nodes"]
    """Time of each node in integration steps since the start of its window."""
    valid: Bool[np.ndarray, "segments windows drones nodes"]
    """Which nodes there are."""

    def __len__(self) -> int:
        return len(self.flight)


FEWEST_NODES = 5
"""A drone's window with fewer nodes is left out: its start alone takes two per axis."""


def enough(valid: Bool[np.ndarray, "*n nodes"]) -> Bool[np.ndarray, "*n nodes"]:
    """The nodes of windows that have `FEWEST_NODES` at least."""
    return valid & (valid.sum(axis=-1, keepdims=True) >= FEWEST_NODES)


def uncounted(groups: Sequence[Segments]) -> set[int]:
    """Flights of which no window counts."""
    every, counted = set[int](), set[int]()
    for group in groups:
        every.update(group.flight.tolist())
        some = enough(group.valid[:, 1:]).any(axis=(1, 2, 3))
        counted.update(group.flight[some].tolist())
    return every - counted


Stretches = Callable[[DroneLog], Sequence[tuple[float, float]]]
"""Stretches [s] of a log that must not count, besides those after an unknown command."""


Early = Callable[[Float[np.ndarray, "*n"]], Float[np.ndarray, "*n"]]
"""How long before its row a command acts [s], by the time since the flight's start [s]."""


def cut(
    flights: Sequence[FlightLog],
    dt: float,
    measured: int = 0,
    ignored: Stretches = lambda _: (),
    early: Early = np.zeros_like,
) -> list[Segments]:
    """Segments for steps of `dt` [s], one group for each number of drones in a flight.

    Commands are held between rows; the first `measured` of their four columns, which were measured
    instead, are joined by straight lines.
    """
    parts = [_cut_flight(i, one, dt, measured, ignored, early) for i, one in enumerate(flights)]
    return [
        _joined([part for part in parts if part.pos.shape[2] == size])
        for size in sorted({part.pos.shape[2] for part in parts})
    ]


def _joined(parts: Sequence[Segments]) -> Segments:
    names = [field.name for field in dataclasses.fields(Segments)]
    return Segments(**{n: np.concatenate([getattr(part, n) for part in parts]) for n in names})


def _cut_flight(
    index: int, flight: FlightLog, dt: float, measured: int, ignored: Stretches, early: Early
) -> Segments:
    zero = min(drone.t[0] for drone in flight.drones)
    seconds = max(drone.t[-1] for drone in flight.drones) - zero
    n_segments = max(1, math.ceil((seconds - REPLAY_WINDOW_S / 2) / (N_WINDOWS * REPLAY_WINDOW_S)))
    start = np.arange(n_segments) * N_WINDOWS * REPLAY_WINDOW_S - REPLAY_WINDOW_S
    drones = [_Drone(drone, zero, measured, ignored(drone), early) for drone in flight.drones]
    edges = start[:, None] + REPLAY_WINDOW_S * np.arange(N_WINDOWS + 1)
    n_steps = round(REPLAY_WINDOW_S / dt)
    steps = start[:, None] + dt * (np.arange((N_WINDOWS + 1) * n_steps) + 0.5)
    starts = [drone.smoothed(edges) for drone in drones]
    nodes = [drone.nodes(edges, dt) for drone in drones]
    return Segments(
        flight=np.full(n_segments, index),
        start=start,
        pos=np.stack([s[0] for s in starts], axis=2),
        vel=np.stack([s[1] for s in starts], axis=2),
        quat=np.stack([s[2] for s in starts], axis=2),
        ang_vel=np.stack([s[3] for s in starts], axis=2),
        fresh=np.stack([drone.fresh(edges) for drone in drones], axis=2),
        doubtful=np.any([drone.doubtful(edges) for drone in drones], axis=0),
        cmd=np.stack([drone.command(steps) for drone in drones], axis=2),
        voltage=drones[0].voltage(steps),
        row=np.stack([n[0] for n in nodes], axis=2),
        place=np.stack([n[1] for n in nodes], axis=2),
        valid=np.stack([n[2] for n in nodes], axis=2),
    )


class _Drone:
    """One drone's log with commands filled, time from the flight's start."""

    def __init__(
        self,
        log: DroneLog,
        zero: float,
        measured: int,
        ignored: Sequence[tuple[float, float]],
        early: Early,
    ) -> None:
        if log.cmd is None:
            raise ValueError("The log has no commands.")
        self.t, self.measured, self.early = log.t - zero, measured, early
        self.rows, self.battery = noise.measured(log), log.battery
        between = log.interpolated
        self.interpolated = np.zeros(len(log.t), bool) if between is None else between
        cmd = np.column_stack([log.cmd[:, :2], np.unwrap(log.cmd[:, 2]), log.cmd[:, 3]])
        self.cmd_t, self.cmd, unknown = filled(self.t, cmd)
        unknown = [(a - float(early(np.asarray(a))), b) for a, b in unknown]
        shift = log.t[0] - zero
        unknown = [*unknown, *((a + shift, b + shift) for a, b in ignored)]
        ends = [
            (begin, end, REPLAY_WINDOW_S * math.ceil(end / REPLAY_WINDOW_S - 1e-9))
            for begin, end in unknown
        ]
        begin = float(self.t[0])
        again = REPLAY_WINDOW_S * math.ceil(begin / REPLAY_WINDOW_S - 1e-9)
        self.unknown = [(-math.inf, begin, again), *ends]

    def command(self, t: Float[np.ndarray, "segments steps"]) -> Float[np.ndarray, "..."]:
        """The command that is held at each time."""
        at = np.searchsorted(self.cmd_t, t + self.early(t) + 1e-9, side="right") - 1
        held = self.cmd[np.clip(at, 0, None)]
        joined = [np.interp(t, self.cmd_t, self.cmd[:, i]) for i in range(self.measured)]
        return np.stack([*joined, *np.moveaxis(held[..., self.measured :], -1, 0)], axis=-1)

    def voltage(self, t: Float[np.ndarray, "segments steps"]) -> Float[np.ndarray, "..."]:
        """The battery's voltage [V], joined by straight lines; zero without a log of it."""
        return np.zeros_like(t) if self.battery is None else np.interp(t, self.t, self.battery)

    def fresh(self, edges: Float[np.ndarray, "segments windows"]) -> Bool[np.ndarray, "..."]:
        """Windows at whose start the attitude is set to the measured one."""
        fresh = np.zeros(edges.shape, bool)
        for _, _, again in self.unknown:
            fresh |= np.abs(edges - again) < 1e-6
        return fresh

    def doubtful(self, edges: Float[np.ndarray, "segments windows"]) -> Bool[np.ndarray, "..."]:
        """Windows that start soon after an unknown command, or hold one."""
        doubtful = np.zeros(edges.shape, bool)
        for begin, end, _ in self.unknown:
            doubtful |= (edges + REPLAY_WINDOW_S > begin) & (edges < end + DOUBT)
        return doubtful

    def smoothed(
        self, edges: Float[np.ndarray, "segments windows"]
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Position, velocity, attitude and angular velocity at each edge, by local fits."""
        fits = np.stack([self._fit(t) for t in edges.ravel()])
        pos, vel, rpy, rate = np.moveaxis(fits.reshape(*edges.shape, 4, 3), -2, 0)
        quat = Rotation.from_euler("xyz", rpy.reshape(-1, 3)).as_quat()
        return pos, vel, quat.reshape(*edges.shape, 4), body_rate(rpy, rate)

    def _fit(self, t: float) -> Float[np.ndarray, "4 3"]:
        """Position, velocity, Euler angles and their rates: steady motion within 0.06 s."""
        t = min(max(t, self.t[0]), self.t[-1])
        low, high = np.searchsorted(self.t, (t - 0.06, t + 0.06))
        if high - low < 3:
            near = int(_nearest(self.t, np.asarray(t)))
            low, high = max(near - 1, 0), near + 2
        s, rows = self.t[low:high] - t, self.rows[low:high]
        one, zero = np.ones_like(s), np.zeros_like(s)
        # A position counts ten times a velocity: 1 mm against 1 cm/s.
        upper = np.stack([one, s, s * s / 2], axis=1) * 10.0
        design = np.concatenate([upper, np.stack([zero, one, s], axis=1)])
        target = np.concatenate([rows[:, :3] * 10.0, rows[:, 3:6]])
        moved = np.linalg.lstsq(design, target, rcond=None)[0]
        turned = np.linalg.lstsq(np.stack([one, s], axis=1), rows[:, 6:], rcond=None)[0]
        return np.stack([moved[0], moved[1], turned[0], turned[1]])

    def nodes(
        self, edges: Float[np.ndarray, "segments windows"], dt: float
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Rows nearest to every `NODE_DT`, each used once, with their place and validity."""
        wanted = edges[:, :, None] + NODE_DT * (np.arange(N_NODES) + 1.0)
        at = _nearest(self.t, wanted)
        t = self.t[at]
        inside = (np.abs(t - wanted) <= NODE_DT * 0.5) & (wanted > 0)
        inside[:, 0] = False
        inside &= ~self._forgetting(t, edges[:, :, None]) & ~self.interpolated[at]
        return self.rows[at], (t - edges[:, :, None]) / dt, inside

    def _forgetting(self, t: np.ndarray, edge: np.ndarray) -> np.ndarray:
        """Whether an unknown command still shows at `t`, in the window that starts at `edge`.

        Attitude and rotors forget it `FORGET` after the attitude was set anew, position and
        velocity not before the next window.
        """
        bad = np.zeros(t.shape, bool)
        for begin, _, again in self.unknown:
            bad |= (t > begin) & ((t < again + FORGET) | (edge <= begin))
        return bad


def body_rate(
    rpy: Float[np.ndarray, "*n 3"], rate: Float[np.ndarray, "*n 3"]
) -> Float[np.ndarray, "*n 3"]:
    """Angular velocity, body frame [rad/s], of Euler angles [rad] and their rates [rad/s]."""
    sr, sp, _ = np.moveaxis(np.sin(rpy), -1, 0)
    cr, cp, _ = np.moveaxis(np.cos(rpy), -1, 0)
    roll, pitch, yaw = np.moveaxis(rate, -1, 0)
    turn = [roll - yaw * sp, pitch * cr + yaw * sr * cp, -pitch * sr + yaw * cr * cp]
    return np.stack(turn, axis=-1)


def filled(
    t: Float[np.ndarray, " rows"], cmd: Float[np.ndarray, "rows 4"]
) -> tuple[np.ndarray, np.ndarray, list[tuple[float, float]]]:
    """Commands with missing rows interpolated, and the stretches [s] that stay unknown."""
    period = float(np.median(np.diff(t)))
    unknown, times, cmds = [], [t], [cmd]
    for i in np.flatnonzero(np.diff(t) > HOLE * period):
        begin, end = t[i], t[i + 1]
        change = np.abs(cmd[i + 1] - cmd[i])
        small = max(change[:3]) < FILL_ANGLE and change[3] < FILL_THRUST * abs(cmd[i, 3])
        if end - begin > max(LARGEST_FILL, HOLE * period) or not small:
            unknown.append((float(begin + period), float(end)))
            continue
        n = round((end - begin) / period)
        part = np.arange(1, n) / n
        times.append(begin + part * (end - begin))
        cmds.append(cmd[i] + part[:, None] * (cmd[i + 1] - cmd[i]))
    order = np.argsort(np.concatenate(times), kind="stable")
    return np.concatenate(times)[order], np.concatenate(cmds)[order], unknown


def _nearest(grid: Float[np.ndarray, " rows"], t: np.ndarray) -> np.ndarray:
    """Index of the row nearest in time."""
    right = np.clip(np.searchsorted(grid, t), 1, len(grid) - 1)
    return np.asarray(right - (t - grid[right - 1] < grid[right] - t))
