"""What `diagnosis.json` holds: schema 1, and `details` for pictures."""

import dataclasses
from collections.abc import Collection, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from diagnosis.decide.advice import next_flight
from diagnosis.decide.study import Study
from diagnosis.decide.verdict import Verdict, intervals, limits, sizes
from diagnosis.fit import gap, shrinkage
from diagnosis.fit.outliers import standing_out
from diagnosis.fit.search import Problem
from diagnosis.logs.flights import FlightLog, FlightSet
from diagnosis.logs.noise import CHANNELS
from diagnosis.replay.library import Library
from simulators import registry
from simulators.effects.card import Input

SCHEMA = 1
"""Version of `diagnosis.json`."""


def content(
    flights: FlightSet,
    simulator: str,
    study: Study,
    reference: FlightSet | None,
    exclude: Collection[str],
) -> dict[str, Any]:
    """The object; `exclude` are effects that were left out by request."""
    problem, verdict, logs = study.problem, study.verdict, study.inputs.flights
    noise = (study.every.sigma, study.every.shake)
    where = gap.where(study.every.tracks(problem.base), *noise)
    found = verdict.chosen.fit
    reported = sorted(found.effects) if verdict.kind == "effect" else []
    seen = limits(problem, found)
    left = gap.where(study.every.tracks(found.total), *noise)
    return {
        "schema": SCHEMA,
        "simulator": simulator,
        "drone": flights.vehicle.drone,
        "flights": {
            "n": len(logs),
            "seconds": float(sum(f.seconds for f in logs)),
            "input": study.inputs.kind,
            "fit": [logs[i].name for i in study.fit_ids],
            "held_out": [logs[i].name for i in study.held] if len(logs) > 1 else [],
            "left_out": _left_out(flights, study, reference),
        },
        "where": where,
        "verdict": verdict.kind,
        "unexplained_share": 0.0 if verdict.kind == "none" else verdict.unexplained_share,
        "effects": [_effect(problem, verdict, name) for name in reported],
        "candidates": _candidates(problem, verdict),
        "shrink": shrinkage.shrink(study.drift, study.every.sigma, study.fit_ids == study.held),
        "next_flight": next_flight(
            verdict.kind,
            {name: verdict.aliases[name] for name in reported},
            _largest_regime(left),
            _blind_to(problem.library, seen),
        ),
        "details": _details(study, seen)
        | {
            "reference": None if reference is None else reference.path.name,
            "excluded": sorted(exclude),
            "not_observable": _not_observable(study, exclude),
            "where_left": left,
            "support": [dataclasses.asdict(x) | {"clear": x.clear} for x in study.support],
            "set_aside": _set_aside(study),
            "windows": _windows(study),
        },
    }


def _left_out(flights: FlightSet, study: Study, reference: FlightSet | None) -> list[dict]:
    """Files and flights that were not used, those of the reference marked."""
    found = [(x.name, x.reason) for x in flights.left_out] + list(study.inputs.left_out)
    if reference is not None and study.compared is not None:
        there = [(x.name, x.reason) for x in reference.left_out] + list(study.compared.left_out)
        found += [(name, f"reference, {reason}") for name, reason in there]
    return [{"name": name, "reason": reason} for name, reason in found]


def _set_aside(study: Study) -> list[dict]:
    """Windows that stand out and did not count, alone or soon after an unknown command."""
    out = standing_out(study.every.aside, study.every.typical)
    if out is None:
        return []
    lines = zip(out.flight, out.t, out.misfit, out.doubtful, strict=True)
    return [
        {
            "flight": study.inputs.flights[i].name,
            "t": float(t),
            "misfit": float(m),
            "after_gap": bool(doubtful),
        }
        for i, t, m, doubtful in lines
    ]


def _windows(study: Study) -> dict[str, int]:
    """How many half seconds there are, and how many of them count nowhere, in no shrink either."""
    aside = 0 if study.every.aside is None else len(study.every.aside.c)
    trusted = 0 if study.every.trusted is None else int(study.every.trusted.sum())
    return {"n": trusted + aside, "aside": aside}


def _effect(problem: Problem, verdict: Verdict, name: str) -> dict[str, Any]:
    free, low, high = intervals(problem, verdict.chosen.fit)
    value, _ = sizes(problem, verdict.chosen.fit)
    slots = problem.library.slots
    parameters = {
        slots[i].parameter: {
            "value": float(x),
            "low": float(a),
            "high": float(b),
            "unit": slots[i].unit,
        }
        for i, x, a, b in zip(free, value, low, high, strict=True)
        if slots[i].effect == name
    }
    return {
        "name": name,
        "probability": verdict.probability[name],
        "aliases": verdict.aliases[name],
        "parameters": parameters,
    }


def _candidates(problem: Problem, verdict: Verdict) -> list[dict[str, Any]]:
    """The likeliest sets; their shrinks are on the flights that they were fitted to."""
    nominal = problem.nominal()
    before, alone = _drift(problem, problem.base), len(np.unique(nominal.normal.flight)) < 2
    return [
        {
            "effects": sorted(ranked.effects),
            "probability": ranked.probability,
            "evidence": None if alone else shrinkage.evidence(problem, ranked.fit),
            "shrink_percent": 100.0 * (1.0 - _drift(problem, ranked.fit.total) / before)
            if before > 0
            else None,
        }
        for ranked in verdict.ranked[:8]
    ]


def _drift(problem: Problem, vector: Float[np.ndarray, " params"]) -> float:
    """RMS position drift of the fitted flights [m]."""
    return _rms(gap.drifts(problem.likelihood.tracks(vector))[:, :3])


def _rms(vectors: Float[np.ndarray, "lines 3"]) -> float:
    lengths = np.sum(vectors**2, axis=1)
    return float(np.sqrt(np.nanmean(lengths))) if np.isfinite(lengths).any() else 0.0


def _largest_regime(where: Sequence[dict]) -> str | None:
    """The bin in which the channel with the largest share has its largest gap."""
    if not where:
        return None
    channel = max(where, key=lambda c: c["share"])
    best, text = 0.0, None
    for regime in channel["regimes"]:
        gaps = [g or 0.0 for g in regime["gap"]]
        contrast = max(gaps) / max(float(np.mean(gaps)), 1e-12) if gaps else 0.0
        if contrast > best:
            i, best = int(np.argmax(gaps)), contrast
            low, high = regime["edges"][i], regime["edges"][i + 1]
            text = f"{regime['variable']} {low:.2g} to {high:.2g} {regime['unit']}"
    return text


def _blind_to(library: Library, seen: Sequence[tuple[int, float]]) -> list[str]:
    """Effects whose smallest visible size is a fifth of the allowed range or more."""
    slots = library.slots
    return [slots[i].effect for i, size in seen if size > 0.2 * (slots[i].high - slots[i].low)]


def _details(study: Study, seen: Sequence[tuple[int, float]]) -> dict[str, Any]:
    problem, verdict, every = study.problem, study.verdict, study.every
    logs = study.inputs.flights
    nominal, chosen = problem.nominal().normal, verdict.chosen.fit.normal
    slots = problem.library.slots
    return {
        "flights_seconds": {f.name: float(f.seconds) for f in logs},
        "before_after": _along(study.drift, [logs[i] for i in study.held]) if len(logs) > 1 else [],
        "gap_in_time": gap.in_time(every.tracks(problem.base), every.sigma),
        "chi2_per_dof": {
            "before": nominal.chi2 / float(nominal.dof.sum()),
            "after": chosen.chi2 / float(chosen.dof.sum()),
        },
        "structure": {
            "before": verdict.found.value,
            "after": verdict.structure.value,
        },
        "dispersion": problem.phi,
        "noise": {
            name: None if study.inputs.prescribed and i >= 6 else float(study.noise[i])
            for i, name in enumerate(CHANNELS)
        },
        "limits": [
            {
                "effect": slots[i].effect,
                "parameter": slots[i].parameter,
                "unit": slots[i].unit,
                "smallest": size,
            }
            for i, size in seen
        ],
        "shared": study.base.shared(problem.library) if study.base else [],
        "best_set": sorted(verdict.chosen.effects),
    }


def _along(drift: shrinkage.Drift, logs: Sequence[FlightLog]) -> list[dict[str, Any]]:
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
        rms = [np.sqrt(np.bincount(at, x) / np.bincount(at)).tolist() for x in square[:, mine]]
        found.append(
            {"flight": logs[flight].name, "t": t.tolist(), "before": rms[0], "after": rms[1]}
        )
    return found


def _not_observable(study: Study, exclude: Collection[str]) -> list[dict[str, str]]:
    """Registered effects that are no candidates, and why."""
    library = study.problem.library
    found = []
    for name, kind in sorted(registry.load_all("effect").items()):
        if name in library.candidates:
            continue
        why = library.why_out(name, kind)
        if name in exclude:
            why = "excluded by request, or cannot be told from what was"
        elif why == Input.ATTITUDE_CMD.value:
            why += f" ({study.inputs.kind})"
        found.append({"effect": name, "why": why})
    return found
