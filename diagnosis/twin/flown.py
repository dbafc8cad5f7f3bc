"""Flights as channels of the nominal simulator, with the slopes by every effect."""

import functools
from collections.abc import Callable, Collection, Sequence

import numpy as np
from jaxtyping import Float

from diagnosis.logs.flights import FlightLog, FlightSet, LogError
from diagnosis.logs.inputs import Inputs, choose_inputs, on_ground
from diagnosis.logs.segments import NODE_DT, WINDOW, cut
from diagnosis.replay.believed import nominal_simulator
from diagnosis.replay.library import make_library, with_aliases
from diagnosis.replay.replay import Replay, make_replay
from diagnosis.twin.channels import ANGLES, Channels, N, make_channels
from simulators.contract import replayable_class

Fly = Callable[[Float[np.ndarray, " params"]], tuple[Channels, ...]]
"""The channels of some flights, simulated at a vector of the library."""


def driven_alike(flights: FlightSet, reference: FlightSet) -> tuple[Inputs, Inputs]:
    """Both sets, driven by one kind of input.

    Raises:
        LogError: They are not, or one of them has none.
    """
    inputs = choose_inputs(flights, beside=reference)
    before = choose_inputs(reference, beside=flights)
    if inputs.kind != before.kind:
        raise LogError(
            f"{flights.path} is replayed by {inputs.kind}, the reference by {before.kind}; "
            "both must log the same kind of input."
        )
    return inputs, before


def seen(replay: Replay) -> tuple[int, ...]:
    """Channels that say something: a prescribed attitude does not."""
    return tuple(range(ANGLES if replay.prescribed else 0, N))


def twin_replay(
    flights: FlightSet, inputs: Inputs, simulator: str, exclude: Collection[str] = ()
) -> Replay:
    """The replay of the nominal simulator with every effect that these inputs can show."""
    nominal = nominal_simulator(simulator, flights, limited=inputs.follows_commands)
    library = make_library(
        nominal,
        with_aliases(exclude),
        prescribed=inputs.prescribed,
        referenced=True,
        produced=inputs.produced,
        mapped=inputs.mapped,
        twin=True,
    )
    return make_replay(library, replayable_class(simulator).replay_dt, inputs.measured)


def flight_of(replay: Replay, logs: Sequence[FlightLog]) -> Fly:
    """What simulates some logs, which are cut once.

    Raises:
        LogError: A flight has several drones; or, when it is called, none has enough samples.
    """
    several = [log.name for log in logs if len(log.drones) > 1]
    if several:
        raise LogError(f"flights/{several[0]}: a twin takes flights of one drone, got several.")
    mass = replay.library.simulator.spec.mass
    ground = functools.partial(on_ground, mass=mass, turning=replay.measured > 0)
    (segments,) = cut(logs, replay.dt, replay.measured, ground)

    def fly(vector: Float[np.ndarray, " params"]) -> tuple[Channels, ...]:
        made = make_channels(replay, logs, segments, vector)
        if not made:
            raise LogError(
                f"no flight holds a second of rows every {NODE_DT:g} s in the air, in windows of "
                f"{WINDOW:g} s without unknown commands; log faster, or fly longer."
            )
        return made

    return fly
