"""`diagnose_change(flights, reference)`: what changed since the reference flew, beside its twin."""

import functools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from diagnosis.decide.prepared import nominal_simulator
from diagnosis.decision import Decision
from diagnosis.logs.flights import FlightLog, FlightSet, LogError
from diagnosis.logs.inputs import Inputs, choose_inputs, on_ground
from diagnosis.logs.segments import NODE_DT, WINDOW, cut
from diagnosis.replay.library import make_library, with_aliases
from diagnosis.replay.replay import Replay, make_replay
from diagnosis.twin.answer import Drift, TwinAnswer, followed
from diagnosis.twin.channels import ANGLES, Channels, N, make_channels
from diagnosis.twin.naming import Named, name_change
from diagnosis.twin.twin import Score, Twin, make_twin, standing_out
from diagnosis.twin.units import compare, make_group
from simulators.contract import replayable_class


def diagnose_change(
    flights: FlightSet,
    reference: FlightSet,
    *,
    simulator: str = "crazyflow",
    decision: Decision = Decision(),
) -> TwinAnswer:
    """What changed between `reference` and `flights`, both flown by one airframe.

    Raises:
        LogError: The two sets are not driven by the same input, or too few flights are usable.
    """
    inputs = choose_inputs(flights, beside=reference)
    before = choose_inputs(reference, beside=flights)
    if inputs.kind != before.kind:
        raise LogError(
            f"{flights.path} is replayed by {inputs.kind}, the reference by {before.kind}; "
            "both must log the same kind of input."
        )
    replay = twin_replay(flights, inputs, simulator)
    neutral = replay.library.neutral
    twin = make_twin(flown(replay, before.flights, neutral), replay.library, seen(replay))
    return answer(twin, flown(replay, inputs.flights, neutral), decision)


def seen(replay: Replay) -> tuple[int, ...]:
    """Channels that say something: a prescribed attitude does not."""
    return tuple(range(ANGLES if replay.prescribed else 0, N))


def twin_replay(flights: FlightSet, inputs: Inputs, simulator: str) -> Replay:
    """The replay of the nominal simulator with every effect that these inputs can show."""
    nominal = nominal_simulator(simulator, flights, limited=inputs.follows_commands)
    library = make_library(
        nominal,
        with_aliases(()),
        prescribed=inputs.prescribed,
        referenced=True,
        produced=inputs.produced,
        mapped=inputs.mapped,
        twin=True,
    )
    return make_replay(library, replayable_class(simulator).replay_dt, inputs.measured)


def flown(
    replay: Replay, logs: Sequence[FlightLog], vector: Float[np.ndarray, " params"]
) -> tuple[Channels, ...]:
    """The channels of logs, simulated at `vector`.

    Raises:
        LogError: No flight has enough samples.
    """
    mass = replay.library.simulator.spec.mass
    ground = functools.partial(on_ground, mass=mass, turning=replay.measured > 0)
    made = [
        channels
        for segments in cut(logs, replay.dt, replay.measured, ground)
        for channels in make_channels(replay, logs, segments, vector)
    ]
    if not made:
        raise LogError(
            f"no flight holds a second of rows every {NODE_DT:g} s in the air, in windows of "
            f"{WINDOW:g} s without unknown commands; log faster, or fly longer."
        )
    return tuple(made)


def answer(twin: Twin, flights: Sequence[Channels], decision: Decision = Decision()) -> TwinAnswer:
    """What changed, by the target flights' channels at the library's neutral vector."""
    scores = [twin.score(f) for f in flights]
    odd = standing_out([s.misfit for s in scores])
    aside = tuple(s.name for s, out in zip(scores, odd, strict=True) if out)
    kept = [f for f, out in zip(flights, odd, strict=True) if not out]
    scores = [s for s, out in zip(scores, odd, strict=True) if not out]
    width = twin.library.high - twin.library.low
    reference, target = make_group(twin.scores, width), make_group(scores, width)
    named = name_change(twin.library, reference, target, decision)
    return TwinAnswer(
        **vars(named),
        followed=followed(twin.gap, twin.error, twin.colour.seen),
        drift=_drift(twin, kept, scores, named) if named.effects else None,
        set_aside=(*twin.set_aside, *aside),
        reference_flights=len(reference),
        target_flights=len(target),
    )


def _drift(
    twin: Twin, flights: Sequence[Channels], scores: Sequence[Score], named: Named
) -> Drift | None:
    """The drift of every target flight with the named effects as the others show them."""
    if len(flights) < 2:
        return None
    library, width = twin.library, twin.library.high - twin.library.low
    columns = [i for e in named.effects for i in library.indices(e)]
    reference, target = make_group(twin.scores, width), make_group(scores, width)
    before, after = [], []
    for i, flight in enumerate(flights):
        others = compare(reference, target.without(i), columns).estimate(columns)
        errors, slopes = twin.errors(flight), twin.memory.respond(flight)[columns]
        values = others.value * width[columns]
        before.append(drift_of(errors, flight))
        after.append(drift_of(errors - np.tensordot(values, slopes, axes=1), flight))
    return Drift(float(np.mean(before)), float(np.mean(after)))


def drift_of(errors: Float[np.ndarray, "time 6"], flight: Channels) -> float:
    """Root mean square of the position error after each whole window of valid samples [m]."""
    n = round(WINDOW / NODE_DT)
    whole = len(errors) // n * n
    acc = errors[:whole, ANGLES:].reshape(-1, n, 3)
    good = flight.valid[:whole].reshape(-1, n).all(axis=1)
    to_go = (n - np.arange(n) - 0.5) * NODE_DT**2
    moved = np.einsum("wni,n->wi", acc[good], to_go)
    return float(np.sqrt(np.mean(np.sum(moved**2, axis=1)))) if good.any() else 0.0
