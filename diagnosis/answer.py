"""From a finished study to the typed `Diagnosis`."""

import math
from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from diagnosis.decide.advice import blind_to, largest_regime, next_flight
from diagnosis.decide.blame import blame
from diagnosis.decide.prepared import Prepared, Question
from diagnosis.decide.study import Study
from diagnosis.decide.verdict import Verdict, at_bounds, intervals, limits, sizes
from diagnosis.fit import gap, shrinkage
from diagnosis.fit.evidence import Evidence
from diagnosis.fit.outliers import standing_out
from diagnosis.fit.search import Fits
from diagnosis.logs.flights import FlightLog
from diagnosis.logs.noise import CHANNELS, UNITS
from diagnosis.recorded import MOST_CANDIDATES, flights_used, limits_of, settings_of, this_program
from diagnosis.result import (
    Candidate,
    Details,
    Diagnosis,
    Doubt,
    Effect,
    Parameter,
    Remainder,
)
from diagnosis.result_parts import (
    ChannelGap,
    ChannelNoise,
    DriftAlong,
    Misfit,
    NotObservable,
    SetAside,
    Shrink,
    Windows,
)
from diagnosis.statements import (
    answer_probability,
    mostly_explained,
    noteworthy,
    use_of,
)
from simulators import registry
from simulators.effects.card import Input


def answer(question: Question, study: Study) -> Diagnosis:
    """The diagnosis that answers a question, from the study of its flights."""
    fits, judged, prepared = study.fits, study.verdict, study.prepared
    evidence, reference = fits.evidence, question.reference
    shrink = _shrink(study)
    found = blame(study, shrink)
    verdict, named = found.verdict, found.named
    effects = tuple(
        _effect(evidence, judged, n, verdict, n in found.blamed)
        for n in sorted(judged.chosen.effects)
    )
    stated = [effect.probability for effect in effects]
    seen = limits(evidence, judged.chosen.fit)
    remainder = _remainder(study)
    settings = settings_of(question)
    return Diagnosis(
        verdict=verdict,
        probability=None
        if named is None
        else answer_probability(judged.chosen.probability, stated),
        effects=effects,
        remainder=remainder,
        doubt=_doubt(judged) if verdict == "effect" else None,
        where=_where(study, evidence.base),
        candidates=_candidates(fits, judged, named),
        support=study.support,
        shrink=shrink,
        next_flight=next_flight(
            verdict,
            {effect.name: list(effect.aliases) for effect in effects} if named else {},
            largest_regime(remainder.where, _regime_noise(study), question.decision),
            blind_to(evidence.library.slots, seen, question.decision),
            len(prepared.inputs.flights),
            decision=question.decision,
        ),
        flights=flights_used(question.flights, prepared.inputs, lambda i: _use(prepared, i)),
        reference=None
        if reference is None or prepared.compared is None
        else flights_used(reference, prepared.compared, lambda _: "reference"),
        settings=settings,
        program=this_program(),
        details=_details(study, seen, settings.withheld),
    )


def _where(study: Study, vector: Float[np.ndarray, " params"]) -> tuple[ChannelGap, ...]:
    """Where the gap lies at a vector."""
    every, decision = study.every, study.prepared.decision
    return gap.where(every.tracks(vector), every.sigma, every.shake, decision=decision)


def _shrink(study: Study) -> Shrink:
    """How far the gap shrinks on flights that were left out."""
    prepared = study.prepared
    return shrinkage.shrink(study.drift, study.every.sigma, prepared.in_turn, prepared.decision)


def _use(prepared: Prepared, i: int) -> Any:
    """What flight `i` was used for."""
    if prepared.in_turn:
        return "fit, and held out in turn" if len(prepared.inputs.flights) > 1 else "fit"
    return "held out" if i in prepared.held else "fit"


def _known(value: float | None) -> float | None:
    """A finite number, or None."""
    return float(value) if value is not None and math.isfinite(value) else None


def _effect(evidence: Evidence, judged: Verdict, name: str, verdict: str, blamed: bool) -> Effect:
    return Effect(
        name=name,
        blamed=blamed,
        # Beside something that no candidate describes, odds among candidates say nothing: none of
        # the effects that `partly` blamed in two blind draws was true (`reports/blind_notes.md`).
        probability=judged.probability[name] if blamed and verdict == "effect" else None,
        aliases=tuple(judged.aliases[name]),
        parameters=_parameters(evidence, judged, name, verdict),
    )


def _parameters(
    evidence: Evidence, judged: Verdict, name: str, verdict: str
) -> tuple[Parameter, ...]:
    """Sizes of an effect of the likeliest set, each with what it may be used for."""
    fit = judged.chosen.fit
    free, low, high = intervals(evidence, fit)
    value, _ = sizes(evidence, fit)
    found, slots = [], evidence.library.slots
    for i, x, a, b, end in zip(free, value, low, high, at_bounds(evidence, fit), strict=True):
        if slots[i].effect == name:
            known = math.isfinite(a) and math.isfinite(b)
            found.append(
                Parameter(
                    name=slots[i].parameter,
                    value=float(x),
                    low=_known(a),
                    high=_known(b),
                    unit=slots[i].unit,
                    at_bound=end,
                    use=use_of(verdict, end, known),
                )
            )
    return tuple(found)


def _remainder(study: Study) -> Remainder:
    judged, decision = study.verdict, study.prepared.decision
    share = 0.0 if judged.kind == "none" else judged.unexplained_share
    return Remainder(
        share=share,
        noteworthy=noteworthy(share, decision),
        mostly_explained=mostly_explained(share, decision),
        structure_before=_known(judged.found.value),
        structure=_known(judged.structure.value),
        where=_where(study, judged.chosen.fit.total),
    )


def _doubt(judged: Verdict) -> Doubt | None:
    """Why effects are less probable than their evidence says."""
    if not judged.doubted:
        return None
    return Doubt(structure=judged.structure.value, true_share=judged.true_share)


def _candidates(fits: Fits, judged: Verdict, named: frozenset[str] | None) -> tuple[Candidate, ...]:
    """The likeliest sets; their shrinks are on the flights that they were fitted to."""
    evidence, alone = fits.evidence, len(np.unique(fits.nominal.normal.flight)) < 2
    before = _drift(evidence, evidence.base)
    return tuple(
        Candidate(
            effects=tuple(sorted(ranked.effects)),
            posterior=ranked.probability,
            evidence=None if alone else _known(shrinkage.left_out_gain(fits, ranked.fit)),
            shrink_percent=_known(100.0 * (1.0 - _drift(evidence, ranked.fit.total) / before))
            if before > 0
            else None,
            named=ranked.effects == named,
        )
        for ranked in judged.ranked[:MOST_CANDIDATES]
    )


def _drift(evidence: Evidence, vector: Float[np.ndarray, " params"]) -> float:
    """RMS position drift of the fitted flights [m]."""
    lengths = np.linalg.norm(gap.drifts(evidence.likelihood.tracks(vector))[:, :3], axis=1)
    return gap.rms(lengths)


def _regime_noise(study: Study) -> dict[str, float | None]:
    """Noise of the measured conditions of flight (`gap.regimes`), in their units.

    None where the attitude is prescribed, so that its noise is not known.
    """
    pos, vel, angle = study.prepared.noise.reshape(3, 3)
    return {
        "speed": float(vel.max()),
        "climb rate": float(vel[2]),
        "height": float(pos[2]),
        "tilt": None if study.prepared.inputs.prescribed else float(angle[:2].max()),
        "distance to a neighbour": float(math.sqrt(2.0) * pos.max()),
    }


def _details(study: Study, seen: Sequence[tuple[int, float]], withheld: Collection[str]) -> Details:
    evidence, every, prepared = study.fits.evidence, study.every, study.prepared
    nominal, chosen = study.fits.nominal.normal, study.verdict.chosen.fit.normal
    slots, logs = evidence.library.slots, prepared.inputs.flights
    scored = [logs[i] for i in prepared.held]
    return Details(
        misfit=Misfit(
            before=_known(nominal.chi2 / float(nominal.dof.sum())),
            after=_known(chosen.chi2 / float(chosen.dof.sum())),
        ),
        dispersion=evidence.phi,
        noise=_channel_noise(study),
        windows=_windows(study),
        set_aside=_set_aside(study),
        limits=limits_of(slots, seen),
        not_observable=_not_observable(study, withheld),
        shared=prepared.base.shared(evidence.library, prepared.decision) if prepared.base else (),
        before_after=_along(study.drift, scored) if len(logs) > 1 else (),
        gap_in_time=gap.in_time(every.tracks(evidence.base), every.sigma),
    )


def _channel_noise(study: Study) -> tuple[ChannelNoise, ...]:
    """Noise of every channel; none of a prescribed attitude."""
    noise, prescribed = study.prepared.noise, study.prepared.inputs.prescribed
    return tuple(
        ChannelNoise(
            channel=name,
            sigma=None if prescribed and i >= 6 else float(noise[i]),
            unit=unit,
        )
        for i, (name, unit) in enumerate(zip(CHANNELS, UNITS, strict=True))
    )


def _set_aside(study: Study) -> tuple[SetAside, ...]:
    """Windows that stand out and did not count, alone or soon after an unknown command."""
    out = standing_out(study.every.aside, study.every.typical, study.prepared.decision)
    if out is None:
        return ()
    lines = zip(out.flight, out.t, out.misfit, out.doubtful, strict=True)
    return tuple(
        SetAside(
            flight=study.prepared.inputs.flights[i].name,
            t=float(t),
            misfit=float(misfit),
            after_gap=bool(doubtful),
        )
        for i, t, misfit, doubtful in lines
    )


def _windows(study: Study) -> Windows:
    """How many half seconds there are, and how many of them count nowhere, in no shrink either."""
    aside = 0 if study.every.aside is None else len(study.every.aside.c)
    trusted = 0 if study.every.trusted is None else int(study.every.trusted.sum())
    return Windows(n=trusted + aside, aside=aside)


def _along(drift: shrinkage.Drift, logs: Sequence[FlightLog]) -> tuple[DriftAlong, ...]:
    """Drift before and after along the flights that were scored, which `logs` are.

    That of several drones is their RMS at each time.
    """
    square = np.stack(
        [np.sum(gap.drifts(t)[:, :3] ** 2, axis=1) for t in (drift.before, drift.after)]
    )
    found = []
    for flight in np.unique(drift.before.flight):
        mine = (drift.before.flight == flight) & np.isfinite(square).all(axis=0)
        t, at = np.unique(drift.before.t[mine], return_inverse=True)
        before, after = (
            tuple(np.sqrt(np.bincount(at, x) / np.bincount(at)).tolist()) for x in square[:, mine]
        )
        name = logs[flight].name
        found.append(DriftAlong(flight=name, t=tuple(t.tolist()), before=before, after=after))
    return tuple(found)


def _not_observable(study: Study, withheld: Collection[str]) -> tuple[NotObservable, ...]:
    """Registered effects that are no candidates, and why."""
    library, found = study.fits.evidence.library, []
    for name, kind in sorted(registry.load_all("effect").items()):
        if name in library.candidates:
            continue
        why = library.why_out(name, kind)
        if name in withheld:
            why = "excluded by request, or cannot be told from what was"
        elif why == Input.ATTITUDE_CMD.value:
            why += f" ({study.prepared.inputs.kind})"
        found.append(NotObservable(effect=name, why=why))
    return tuple(found)
