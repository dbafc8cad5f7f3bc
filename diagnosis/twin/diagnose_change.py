"""`diagnose_change(question)`: what changed since the reference flew, beside its twin."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from diagnosis.decide.prepared import Progress, Question, silent
from diagnosis.decision import Decision
from diagnosis.logs.inputs import Inputs, driven_alike
from diagnosis.result_parts import Followed
from diagnosis.twin.answer import TwinAnswer
from diagnosis.twin.channels import CHANNELS, UNITS, Channels
from diagnosis.twin.drift import (
    Scored,
    drift_shrink,
    excess_of,
    left_share,
    misfit,
    misfit_ratios,
    score_flights,
)
from diagnosis.twin.flown import Fly, flight_of, reference_channels, seen, twin_replay
from diagnosis.twin.naming import name_change
from diagnosis.twin.twin import Twin, make_twin, standing_out
from diagnosis.twin.units import Group, make_group


@dataclasses.dataclass(frozen=True)
class ChangeStudy:
    """What came of two sets of flights beside a twin."""

    inputs: Inputs
    """The changed flights as they are driven."""
    compared: Inputs
    """The reference flights, likewise."""
    twin: Twin
    """The vehicle of the reference flights."""
    answer: TwinAnswer
    """What changed."""
    scored: tuple[Scored, ...]
    """The changed flights without and with the named effects."""
    aside: tuple[Channels, ...]
    """Changed flights that do not count (`TwinAnswer.set_aside`)."""
    reference_aside: tuple[Channels, ...]
    """Reference flights that do not count."""


def diagnose_change(question: Question, progress: Progress = silent) -> ChangeStudy:
    """What changed between the reference and the flights, flown by one airframe.

    Each set is replayed with the mass that its vehicle.toml believes.

    Raises:
        LogError: The two sets are not driven by the same input, a flight has several drones, or
            too few flights are usable.
    """
    flights, reference, decision = question.flights, question.reference, question.decision
    assert reference is not None
    inputs, before = driven_alike(flights, reference)
    replay = twin_replay(flights, inputs, question.simulator, question.exclude)
    beside = replay
    if reference.vehicle.mass != flights.vehicle.mass:
        beside = twin_replay(reference, before, question.simulator, question.exclude)
    neutral = replay.library.neutral
    fly = flight_of(replay, inputs.flights)
    progress("learning how the reference flies", 0.3)
    known = reference_channels(beside, before.flights)
    twin = make_twin(known, replay.library, seen(replay), decision)
    progress("looking for what changed", 0.6)
    flown = fly(neutral, None)
    answer, scored = answer_change(twin, flown, decision, fly)
    aside = tuple(f for f in flown if f.name in answer.set_aside)
    beside_aside = tuple(f for f in known if f.name in twin.set_aside)
    return ChangeStudy(inputs, before, twin, answer, scored, aside, beside_aside)


def answer_change(
    twin: Twin,
    flights: Sequence[Channels],
    decision: Decision = Decision(),
    fly: Fly | None = None,
) -> tuple[TwinAnswer, tuple[Scored, ...]]:
    """What changed, by the changed flights' channels at the library's neutral vector.

    With `fly`, which simulates them elsewhere, large changes are found in their right size.
    """
    # By what no candidate explains: a change shows more in some flights than in others.
    scores = [twin.score(f) for f in flights]
    odd = standing_out([score.alone for score in scores], decision)
    aside = tuple(f.name for f, out in zip(flights, odd, strict=True) if out)
    library = twin.library
    width = library.high - library.low
    kept = tuple(f for f in flights if f.name not in aside)

    def flown_at(
        change: Float[np.ndarray, " params"], along: Sequence[int]
    ) -> tuple[Channels, ...]:
        if fly is None or not change.any():
            return kept
        there = (f for f in fly(library.neutral + change * width, along) if f.name not in aside)
        pairs = zip(there, kept, strict=True)
        return tuple(flight.with_slopes_of(plain, along) for flight, plain in pairs)

    def refly(change: Float[np.ndarray, " params"], along: Sequence[int]) -> Group:
        return make_group([twin.score(f) for f in flown_at(change, along)], width)

    reference = make_group(twin.scores, width)
    target = make_group([s for s, out in zip(scores, odd, strict=True) if not out], width)
    named = name_change(library, reference, target, decision, refly if fly else None)
    # Of effects that look alike, one may explain most of what is seen where the first does not.
    for one in (named, *named.instead):
        scored = score_flights(twin, kept, flown_at(one.at.change, one.at.columns), one.at)
        if not one.effects or helps(twin, scored, decision):
            named = one
            break
    else:
        named = named.unexplained()
        scored = score_flights(twin, kept, kept, named.at)
    fields = {field.name for field in dataclasses.fields(TwinAnswer)}
    own = {name: value for name, value in vars(named).items() if name in fields}
    followed = (
        Followed(channel=CHANNELS[c], unit=UNITS[c], simulator=float(gap), twin=float(error))
        for c, gap, error in zip(range(len(CHANNELS)), twin.gap, twin.error, strict=True)
        if c in twin.colour.seen
    )
    answer = TwinAnswer(
        **own,
        followed=tuple(followed),
        misfit=misfit(twin, scored),
        set_aside=aside,
    )
    return answer, scored


def helps(twin: Twin, scored: Sequence[Scored], decision: Decision) -> bool:
    """Whether effects that were fitted to other flights explain them.

    They lower the misfit, no drift grows, and they do not leave most of a gap that is larger than
    what the twin itself misses: of two sets that differ in some other way, something small is
    always like some effect. The misfit is compared flight by flight, and the mean flight decides:
    pooled over samples, one flight that fits far better would outweigh several that fit worse.
    Without the effects means in the sizes that the reference flights show (`Scored.usual`).
    """
    if all(one.after is one.before for one in scored):
        return True  # there is no other flight, and no other part of the flight
    shrink = drift_shrink(scored, (), decision)
    grows = shrink.high is not None and shrink.high < 0.0
    left = excess_of(twin, scored, [one.after for one in scored])[list(twin.colour.seen)]
    other = float(left.mean()) > 1.0 and left_share(twin, scored) > decision.most_left
    return float(misfit_ratios(twin, scored).mean()) < 0.0 and not grows and not other
