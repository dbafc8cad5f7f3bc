"""Flights as channels of the nominal simulator, with the slopes by every effect.

A twin has a memory of samples `NODE_DT` apart. Rows of slower logs are therefore filled up
(`filled_up`), and rows that an import interpolated count. Commands are held over the rows of a log:
of two sets that were logged at different rates the slower one seems to follow sooner.
"""

import dataclasses
from collections.abc import Callable, Collection, Sequence

import numpy as np
from jaxtyping import Float

from diagnosis.decide.prepared import cut_in_the_air, nominal_replay, remembered_of
from diagnosis.importing.resample import spline
from diagnosis.logs.flights import DroneLog, FlightLog, FlightSet, LogError
from diagnosis.logs.inputs import Inputs
from diagnosis.logs.segments import HOLE, NODE_DT, REPLAY_WINDOW_S
from diagnosis.replay.early import split_early
from diagnosis.replay.replay import Replay
from diagnosis.twin.channels import ANGLES, Channels, N, make_channels, of_arrays, to_arrays

SLOW_S = 1.1 * NODE_DT
"""Median time between rows from which rows are filled up [s]; clocks jitter, a choice."""
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
    if log.cmd is None or period < SLOW_S:
        return log
    step = np.diff(log.t)
    parts = np.where(step > HOLE * period, 1, np.ceil(step / SLOW_S)).astype(int)
    row = np.append(np.repeat(np.arange(len(parts)), parts), len(parts))
    part = np.arange(len(row)) - np.searchsorted(row, row)
    new = part > 0
    t = log.t[row]
    t[new] += (part / np.append(parts, 1)[row])[new] * step[row[new]]
    cmd, (pos, vel, quat) = log.cmd[row], (x[row] for x in (log.pos, log.vel, log.quat))
    for column in range(measured):
        cmd[:, column] = np.interp(t, log.t, log.cmd[:, column])
    for filled, logged in ((pos, log.pos), (vel, log.vel), (quat, log.quat)):
        filled[new] = spline(t[new], log.t, logged)
    quat /= np.linalg.norm(quat, axis=1, keepdims=True)
    battery = None if log.battery is None else np.interp(t, log.t, log.battery)
    return DroneLog(t=t, pos=pos, vel=vel, quat=quat, cmd=cmd, battery=battery)


def _is_slow(log: DroneLog) -> bool:
    """Whether some samples of its channels will lie between measurements."""
    return _period(log) >= SLOW_S or (log.interpolated is not None and bool(log.interpolated.any()))


def _period(log: DroneLog) -> float:
    """Median time between rows [s]."""
    return float(np.median(np.diff(log.t)))
