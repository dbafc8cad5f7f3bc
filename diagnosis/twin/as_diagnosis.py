"""What a twin says of changed flights, as the typed `Diagnosis`."""

import dataclasses
import math
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Float

from diagnosis.decide.advice import blind_to, next_flight
from diagnosis.decide.prepared import Progress, Question, silent
from diagnosis.decide.support import supported
from diagnosis.decision import Decision
from diagnosis.fit.gap import rms_interval
from diagnosis.fit.shrinkage import unknown_shrink
from diagnosis.logs.flights import LeftOut
from diagnosis.recorded import MOST_CANDIDATES, flights_used, limits_of, settings_of, this_program
from diagnosis.replay.library import Library
from diagnosis.result import (
    Candidate,
    Details,
    Diagnosis,
    Effect,
    Parameter,
    Remainder,
    Support,
)
from diagnosis.result_parts import (
    ChannelGap,
    ChannelShrink,
    DriftAlong,
    Flights,
    Misfit,
    NotObservable,
    Shrink,
)
from diagnosis.statements import (
    answer_probability,
    beyond_noise,
    main_channels,
    mostly_explained,
    noteworthy,
    use_of,
)
from diagnosis.twin.answer import ChangedParameter
from diagnosis.twin.channels import CHANNELS, FEWEST_SAMPLES, UNITS, Channels
from diagnosis.twin.diagnose_change import ChangeStudy, diagnose_change
from diagnosis.twin.drift import Scored, allowed, drift_shrink, excess_of, left_share, misfit_ratios
from diagnosis.twin.memory import rms
from diagnosis.twin.twin import FEWEST_REFERENCES


def alone(question: Question) -> bool:
    """Whether every flight is of one drone, as a twin takes them."""
    sets = [question.flights, *([question.reference] if question.reference else [])]
    return all(len(flight.drones) == 1 for one in sets for flight in one.flights)


def weighed_anew(question: Question) -> bool:
    """Whether both vehicles are believed to have different masses, which a twin takes out."""
    flights, reference = question.flights, question.reference
    if reference is None or reference.vehicle.mass == flights.vehicle.mass:
        return False
    return alone(question)


def beside_twin(question: Question, progress: Progress = silent) -> Diagnosis:
    """The diagnosis beside a twin of the reference.

    Raises:
        LogError: As `diagnose_change`.
    """
    return as_diagnosis(question, diagnose_change(question, progress))


def as_diagnosis(question: Question, study: ChangeStudy) -> Diagnosis:
    """The diagnosis that answers a question beside a reference."""
    found, decision = study.answer, question.decision
    assert question.reference is not None
    verdict = found.change
    effects = _effects(study, verdict, decision)
    seen = _limits(study)
    slots = study.twin.library.slots
    remainder = _remainder(study, verdict, decision)
    where = _where(study, [one.before for one in study.scored], decision)
    others = rms([one.before for one in study.scored], [one.valid for one in study.scored])
    return Diagnosis(
        verdict=verdict,
        probability=answer_probability(None, (e.probability for e in effects if e.blamed)),
        effects=effects,
        remainder=remainder,
        doubt=None,
        where=where,
        candidates=_candidates(study),
        support=_support(study, decision),
        shrink=_shrink(study, where, remainder.where, decision),
        next_flight=next_flight(
            verdict,
            {e.name: list(e.aliases) for e in effects if e.blamed},
            None,
            blind_to(slots, seen, decision),
            len(study.scored),
            len(study.twin.scores),
            decision,
        ),
        flights=_used(
            flights_used(question.flights, study.inputs, lambda _: "fit, and held out in turn"),
            [one.name for one in study.scored],
            _missed(study, study.aside, others),
        ),
        reference=_used(
            flights_used(question.reference, study.compared, lambda _: "reference"),
            [score.name for score in study.twin.scores],
            _missed(study, study.reference_aside, study.twin.error),
        ),
        settings=settings_of(question),
        program=this_program(),
        details=_details(study, seen),
    )


def _missed(
    study: ChangeStudy, aside: Sequence[Channels], others: Float[np.ndarray, " 6"]
) -> dict[str, str]:
    """Why flights were set aside, by their names: where the twin misses each most.

    `others` is the root mean square error of each channel in the flights that count.
    """
    found = {}
    for flight in aside:
        error = rms([study.twin.errors(flight)], [flight.valid])
        c = max(study.twin.colour.seen, key=lambda c: error[c] / max(others[c], 1e-12))
        found[flight.name] = (
            "the twin misses it by far more than it misses the other flights: "
            f"{CHANNELS[c]} off by {_size(error[c], c)} (other flights: {_size(others[c], c)})"
        )
    return found


def _size(value: float, channel: int) -> str:
    """An error of a channel with two significant digits; angles in degrees."""
    angle = UNITS[channel] == "rad"
    shown = math.degrees(value) if angle else value
    return f"{float(f'{shown:.2g}'):g} {'degrees' if angle else UNITS[channel]}"


def _used(flights: Flights, counted: Sequence[str], odd: Mapping[str, str]) -> Flights:
    """`flights` with those left out that did not count, each with its reason.

    `odd` says it of those that were set aside.
    """
    gone = []
    for flight in flights.used:
        if flight.name in odd:
            gone.append(LeftOut(flight.name, f"flights/{flight.name}: {odd[flight.name]}"))
        elif flight.name not in counted:
            why = f"it holds less than {FEWEST_SAMPLES} samples of 20 ms that can be compared"
            gone.append(LeftOut(flight.name, f"flights/{flight.name}: {why}"))
    return dataclasses.replace(
        flights,
        used=tuple(flight for flight in flights.used if flight.name in counted),
        left_out=(*flights.left_out, *gone),
    )


def _effects(study: ChangeStudy, verdict: str, decision: Decision) -> tuple[Effect, ...]:
    """The named effects; where none is named and something shows, the best candidate, unblamed."""
    found, library = study.answer, study.twin.library
    if found.effects:
        # Of the effect or what looks like it. No name is surer than that undisturbed flights show
        # none.
        return tuple(
            Effect(
                name=name,
                blamed=True,
                probability=found.probabilities[name] * (1.0 - decision.alarm_chance),
                aliases=found.aliases[name],
                parameters=_parameters(found.parameters, name, verdict, library),
            )
            for name in found.effects
        )
    if found.change == "none" or not found.candidates:
        return ()
    best = found.candidates[0]
    if found.change == "too_few" and not (best.p < decision.alarm_chance and best.log_evidence > 0):
        return ()
    shown = _parameters(best.parameters, best.effect, verdict, library)
    if len(study.twin.scores) < FEWEST_REFERENCES:
        shown = tuple(dataclasses.replace(one, low=None, high=None) for one in shown)
    return (Effect(name=best.effect, blamed=False, probability=None, aliases=(), parameters=shown),)


def _parameters(
    changed: Sequence[ChangedParameter], effect: str, verdict: str, library: Library
) -> tuple[Parameter, ...]:
    """What a simulator of the reference needs, in which every parameter is neutral."""
    neutral = {slot.parameter: slot.neutral for slot in library.slots if slot.effect == effect}
    return tuple(
        Parameter(
            name=one.parameter,
            value=neutral[one.parameter] + one.value,
            low=neutral[one.parameter] + one.low,
            high=neutral[one.parameter] + one.high,
            unit=one.unit,
            at_bound=one.beyond,
            use=use_of(verdict, one.beyond, True),
        )
        for one in changed
        if one.effect == effect
    )


def _where(
    study: ChangeStudy, errors: Sequence[Float[np.ndarray, "_ 6"]], decision: Decision
) -> tuple[ChannelGap, ...]:
    """What is left beside the twin, channel by channel."""
    excess = excess_of(study.twin, study.scored, errors)
    shares = (excess / max(float(excess.sum()), 1e-300)).tolist()
    main = main_channels(shares, decision)
    each = np.stack([rms([e], [one.valid]) for one, e in zip(study.scored, errors, strict=True)])
    floors, found = allowed(study.twin, study.scored), []
    for c in study.twin.colour.seen:
        gap, floor = float(np.sqrt(np.mean(each[:, c] ** 2))), float(floors[c])
        low, high = rms_interval(each[:, c] ** 2, np.ones(len(each)), decision)
        found.append(
            ChannelGap(
                channel=CHANNELS[c],
                unit=UNITS[c],
                gap_rms=gap,
                noise_floor=floor,
                share=shares[c],
                low=low,
                high=high,
                regimes=(),
                onset_s=None,
                beyond_noise=beyond_noise(gap, low, floor),
                main=main[c],
            )
        )
    return tuple(found)


def _remainder(study: ChangeStudy, verdict: str, decision: Decision) -> Remainder:
    share = 0.0
    if verdict not in ("none", "too_few"):
        share = left_share(study.twin, study.scored) if study.answer.effects else 1.0
    return Remainder(
        share=share,
        noteworthy=noteworthy(share, decision),
        mostly_explained=mostly_explained(share, decision),
        where=_where(study, [one.after for one in study.scored], decision),
    )


def _candidates(study: ChangeStudy) -> tuple[Candidate, ...]:
    """Every effect with those that it was tried with; the latter are no rivals of it."""
    found = study.answer
    rivals = [one for one in found.candidates if one.effect not in found.beside]
    return tuple(
        Candidate(
            effects=(one.effect, *found.beside),
            posterior=one.share,
            evidence=None,
            shrink_percent=None,
            named=set(found.effects) == {one.effect, *found.beside},
        )
        for one in rivals[:MOST_CANDIDATES]
    )


def _support(study: ChangeStudy, decision: Decision) -> tuple[Support, ...]:
    """What a single named effect does for flights that it was not fitted to."""
    scored, effects = study.scored, study.answer.effects
    if len(effects) != 1 or len(scored) < decision.fewest_flights:
        return ()
    return (supported(effects[0], misfit_ratios(study.twin, scored)),)


def _shrink(
    study: ChangeStudy,
    where: Sequence[ChannelGap],
    after: Sequence[ChannelGap],
    decision: Decision,
) -> Shrink:
    """How far the drift shrinks; `where` and `after`: the gap without and with what is named."""
    scored = study.scored
    if not study.answer.effects:
        return unknown_shrink(len(scored), "no effect was found")
    by_channel = tuple(
        ChannelShrink(
            channel=a.channel,
            before=a.gap_rms,
            after=b.gap_rms,
            percent=100.0 * (1.0 - b.gap_rms / a.gap_rms) if a.gap_rms > 0.0 else None,
            unit=a.unit,
        )
        for a, b in zip(where, after, strict=True)
    )
    return drift_shrink(scored, by_channel, decision)


def _limits(study: ChangeStudy) -> list[tuple[int, float]]:
    """The smallest visible change of every parameter that was not named; none if none can be."""
    library, found = study.twin.library, study.answer
    if len(study.twin.scores) < FEWEST_REFERENCES:
        return []
    by_name = {(s.effect, s.parameter): i for i, s in enumerate(library.slots)}
    return [
        (by_name[one.effect, one.parameter], one.limit)
        for candidate in found.candidates
        if candidate.effect not in found.effects
        for one in candidate.parameters
    ]


def _details(study: ChangeStudy, seen: Sequence[tuple[int, float]]) -> Details:
    found, slots = study.answer, study.twin.library.slots
    silent = "flights differ from each other by more than this effect could cause"
    return Details(
        misfit=Misfit(before=found.misfit[0], after=found.misfit[1]),
        limits=limits_of(slots, seen),
        not_observable=tuple(NotObservable(effect=name, why=silent) for name in found.unseen),
        before_after=tuple(_along(one) for one in study.scored) if found.effects else (),
        followed=found.followed,
    )


def _along(one: Scored) -> DriftAlong:
    """The drift along one flight, in windows of half a second."""
    before, after = one.drift(one.before), one.drift(one.after)
    kept = np.flatnonzero(np.isfinite(before))
    return DriftAlong(
        flight=one.name,
        t=tuple((0.5 * kept).tolist()),
        before=tuple(before[kept].tolist()),
        after=tuple(after[kept].tolist()),
    )
