"""Flights as channels of the nominal simulator, with the slopes by every effect."""

from collections.abc import Callable, Collection, Sequence

import numpy as np
from jaxtyping import Float

from diagnosis.decide.prepared import cut_in_the_air, nominal_replay, remembered_of
from diagnosis.logs.flights import FlightLog, FlightSet, LogError
from diagnosis.logs.inputs import Inputs
from diagnosis.logs.segments import NODE_DT, REPLAY_WINDOW_S
from diagnosis.replay.early import split_early
from diagnosis.replay.replay import Replay
from diagnosis.twin.channels import ANGLES, Channels, N, make_channels, of_arrays, to_arrays

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
        return made

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
