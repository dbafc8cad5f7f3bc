"""Flights as channels of the nominal simulator, with the slopes by every effect.

A twin has a memory of samples `NODE_DT` apart. Rows of slower logs are therefore filled up
(`filled_up`), and rows that an import interpolated count. Commands are held over the rows of a log:
of two sets that were logged at different rates the slower one seems to follow sooner.
"""

import dataclasses
import itertools
from collections.abc import Callable, Collection, Sequence

import numpy as np
from jaxtyping import Float
from scipy.interpolate import CubicSpline

from diagnosis.decide.prepared import cut_in_the_air, nominal_replay, remembered_of
from diagnosis.logs.flights import DroneLog, FlightLog, FlightSet, LogError
from diagnosis.logs.inputs import Inputs
from diagnosis.logs.segments import NODE_DT, REPLAY_WINDOW_S
from diagnosis.replay.early import split_early
from diagnosis.replay.replay import Replay
from diagnosis.twin.channels import ANGLES, Channels, N, make_channels, of_arrays, to_arrays

SLOW_S = 1.1 * NODE_DT
"""Median time between rows from which rows are filled up [s]; clocks jitter, a choice."""
HOLE = 1.6
"""Distance of rows, in median ones, from which there is a hole, which is not filled; that from
which `diagnosis.logs.segments` looks for missing commands."""
FEWEST_ROWS = 4
"""Fewest rows between two holes that are filled up: those of a cubic."""
Fly = Callable[[Float[np.ndarray, " params"], Sequence[int] | None], tuple[Channels, ...]]
"""The channels of some flights, simulated at a vector of the library, with slopes along some
parameters or, if None, along all."""


def seen(replay: Replay) -> tuple[int, ...]:
    """Channels that say something: a prescribed attitude does not."""
    return tuple(range(ANGLES if replay.prescribed else 0, N))


def twin_replay(
    flights: FlightSet, inputs: Inputs, simulator: str, exclude: Collection[str] = ()
) -> Replay:
    """The replay of the nominal simulator with every effect that these inputs can show."""
    return nominal_replay(flights, inputs, simulator, exclude, referenced=True, twin=True)


def flight_of(replay: Replay, logs: Sequence[FlightLog]) -> Fly:
    """What simulates some logs, which are cut once.

    Raises:
        LogError: A flight has several drones; or, when it is called, none has enough samples.
    """
    several = [log.name for log in logs if len(log.drones) > 1]
    if several:
        raise LogError(f"flights/{several[0]}: a twin takes flights of one drone, got several.")
    mass = replay.library.simulator.spec.mass
    slow = {log.name for log in logs if _is_slow(log.drones[0])}
    logs = [
        dataclasses.replace(log, drones=(filled_up(log.drones[0], replay.measured),))
        for log in logs
    ]
    (plain,) = cut_in_the_air(logs, replay.dt, replay.measured, mass)

    def fly(
        vector: Float[np.ndarray, " params"], along: Sequence[int] | None
    ) -> tuple[Channels, ...]:
        vector, early = split_early(replay.library, vector)
        segments = plain
        if early is not None:
            (segments,) = cut_in_the_air(logs, replay.dt, replay.measured, mass, early)
        made = make_channels(replay, logs, segments, vector, along)
        if not made:
            raise LogError(
                f"no flight holds a second of rows every {NODE_DT:g} s in the air, in windows of "
                f"{REPLAY_WINDOW_S:g} s without unknown commands; log faster, or fly longer."
            )
        return tuple(dataclasses.replace(one, filled=one.name in slow) for one in made)

    return fly


def reference_channels(replay: Replay, logs: Sequence[FlightLog]) -> tuple[Channels, ...]:
    """The channels of reference flights at the neutral vector; remembered where programs are.

    Raises:
        LogError: As `flight_of`.
    """

    def fly() -> dict[str, np.ndarray]:
        return to_arrays(flight_of(replay, logs)(replay.library.neutral, None), names)

    names = [log.name for log in logs]
    return of_arrays(remembered_of("channels", fly, replay, logs), names)


def filled_up(log: DroneLog, measured: int) -> DroneLog:
    """The log with rows at least every `NODE_DT` between holes, all of which count.

    Position, velocity and attitude follow cubic splines. Commands are held, but for the first
    `measured` of their columns, which were measured and are joined by straight lines.
    """
    log, period = dataclasses.replace(log, interpolated=None), _period(log)
    if period < SLOW_S:
        return log
    holes = np.flatnonzero(np.diff(log.t) > HOLE * period) + 1
    runs = [
        _filled_run(_rows(log, slice(low, high)), measured)
        for low, high in itertools.pairwise([0, *holes, len(log.t)])
    ]
    return DroneLog(**{name: np.concatenate([run[name] for run in runs]) for name in runs[0]})


def _is_slow(log: DroneLog) -> bool:
    """Whether some samples of its channels will lie between measurements."""
    return _period(log) >= SLOW_S or (log.interpolated is not None and bool(log.interpolated.any()))


def _period(log: DroneLog) -> float:
    """Median time between rows [s]."""
    return float(np.median(np.diff(log.t)))


def _rows(log: DroneLog, rows: slice) -> dict[str, np.ndarray]:
    """What a replay needs of some rows."""
    needed = ("t", "pos", "vel", "quat", "cmd", "battery")
    return {n: x[rows] for n in needed if (x := getattr(log, n)) is not None}


def _filled_run(run: dict[str, np.ndarray], measured: int) -> dict[str, np.ndarray]:
    if len(run["t"]) < FEWEST_ROWS:
        return run
    parts = np.maximum(np.ceil(np.diff(run["t"]) / SLOW_S), 1.0).astype(int)
    row = np.repeat(np.arange(len(parts)), parts)
    place = np.arange(len(row)) - np.repeat(np.cumsum(parts) - parts, parts)
    t = np.append(run["t"][row] + place / parts[row] * np.diff(run["t"])[row], run["t"][-1])
    held = np.append(row, len(parts))
    filled = {"t": t, "cmd": run["cmd"][held]}
    for column in range(measured):
        filled["cmd"][:, column] = np.interp(t, run["t"], run["cmd"][:, column])
    for name in ("pos", "vel", "quat"):
        filled[name] = CubicSpline(run["t"], run[name])(t)
    filled["quat"] /= np.linalg.norm(filled["quat"], axis=1, keepdims=True)
    if "battery" in run:
        filled["battery"] = np.interp(t, run["t"], run["battery"])
    return filled
