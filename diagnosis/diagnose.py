"""`diagnose(flights) -> Diagnosis`: where the gap lies, which effect causes it, how far it shrinks."""

import dataclasses
from collections.abc import Callable, Collection, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from diagnosis import gap, shrinkage
from diagnosis.advice import next_flight
from diagnosis.library import LEFT_OUT, Library, make_library, with_aliases
from diagnosis.likelihood import Likelihood, Normal
from diagnosis.logs import FlightLog, FlightSet, LogError
from diagnosis.noise import CHANNELS, estimate_noise
from diagnosis.reference import Reference, fit_reference
from diagnosis.replay import make_replay
from diagnosis.search import Fit, Problem, dispersion
from diagnosis.segments import cut
from diagnosis.verdict import Verdict, intervals, judge, limits, structure
from simulators import registry
from simulators.contract import AbstractSimulator
from simulators.vehicle import VEHICLES

SCHEMA = 1
"""Version of `diagnosis.json`."""
STEPS = {"crazyflow": 0.002, "point_mass": 0.005}
"""Integration step of each simulator's replay [s]; others take the point mass's."""
DISTRUST = 4.0
"""Sigmas beyond which a window soon after an unknown command is left out."""

Progress = Callable[[str, float], None]
"""Called with a stage's name and the share of the work that is done."""


def silent(stage: str, share: float) -> None:
    """A `Progress` that shows nothing."""


@dataclasses.dataclass(frozen=True)
class Diagnosis:
    """What was found, as it stands in `diagnosis.json`."""

    content: dict[str, Any]
    """Schema 1 and `details` for pictures."""

    def to_json(self) -> dict[str, Any]:
        """The object that `diagnosis.json` holds."""
        return self.content


def diagnose(
    flights: FlightSet,
    *,
    simulator: str = "crazyflow",
    reference: FlightSet | None = None,
    exclude: Collection[str] = (),
    progress: Progress = silent,
) -> Diagnosis:
    """The diagnosis of `flights` against a registered simulator.

    Raises:
        LogError: No flight has an input that can be replayed.
    """
    logs, left_out = _usable(flights)
    nominal = nominal_simulator(simulator, flights)
    several = any(len(f.drones) > 1 for s in (flights, reference) if s for f in s.flights)
    library = make_library(nominal, with_aliases(exclude), several)
    replay = make_replay(library, STEPS.get(simulator, STEPS["point_mass"]))
    fit_ids, held = shrinkage.split(len(logs))
    progress("cutting flights into windows", 0.02)
    sigma = estimate_noise(logs)
    every = Likelihood(replay, cut(logs, replay.dt), sigma)
    progress("compiling the simulator", 0.05)
    base = None
    if reference is not None:
        base = fit_reference(replay, _usable(reference)[0], sigma)
        every = Likelihood(replay, every.groups, base.sigma)
    lofo = fit_ids == held
    likelihood = every if lofo else _part(every, logs, fit_ids)
    problem, fits = attribute(likelihood, len(fit_ids), base, progress)
    floor = base.structure if base else 1.0
    verdict = judge(problem, fits, floor)
    progress("scoring held-out flights", 0.9)
    scored = every if lofo else _part(every, logs, held)
    if not lofo:
        for other in (every, scored):
            other.distrust(verdict.chosen.fit.vector, DISTRUST)
    drift = shrinkage.score(problem, verdict.chosen.fit, scored, len(logs), lofo)
    content = _content(
        flights, simulator, library, problem, verdict, every, drift, logs, (fit_ids, held)
    )
    content["flights"]["left_out"] += left_out
    content["details"]["shared"] = base.shared(library) if base else []
    progress("done", 1.0)
    return Diagnosis(content)


def _part(every: Likelihood, logs: Sequence[FlightLog], chosen: Sequence[int]) -> Likelihood:
    """The likelihood of some of the flights."""
    return Likelihood(every.replay, cut([logs[i] for i in chosen], every.replay.dt), every.sigma)


def nominal_simulator(name: str, flights: FlightSet) -> AbstractSimulator:
    """The simulator as the operator believes it: her airframe, her mass."""
    spec = VEHICLES[flights.vehicle.drone]
    spec = dataclasses.replace(spec, mass=flights.vehicle.mass)
    return registry.load("simulator", name)(spec=spec)


def _usable(flights: FlightSet) -> tuple[tuple[FlightLog, ...], list[dict[str, str]]]:
    """Flights that can be replayed, and why the others cannot."""
    left_out = [{"name": x.name, "reason": x.reason} for x in flights.left_out]
    usable = []
    for flight in flights.flights:
        if all(drone.cmd is not None for drone in flight.drones):
            usable.append(flight)
        else:
            reason = f"flights/{flight.name}: no attitude and thrust commands (cmd_*) to replay"
            left_out.append({"name": flight.name, "reason": reason})
    if not usable:
        raise LogError("\n".join(f"{flights.path}: {x['reason']}" for x in left_out))
    return tuple(usable), left_out


def attribute(
    likelihood: Likelihood,
    n_flights: int,
    base: Reference | None = None,
    progress: Progress = silent,
) -> tuple[Problem, list[Fit]]:
    """The problem with its dispersion settled, and fits of all sets near the top."""
    problem = Problem(likelihood, base.vector, base.precision) if base else Problem(likelihood)
    floor = base.phi if base else 1.0
    progress("screening all effects", 0.1)
    problem.phi = max(floor, dispersion(problem.nominal().normal, n_flights))
    best = problem.search()[0]
    progress("weighing windows after gaps", 0.5)
    if likelihood.distrust(best.vector, DISTRUST):
        problem.renew()
        best = problem.refit(best.effects, problem.nominal())
    problem.phi = max(floor, dispersion(best.normal, n_flights))
    progress("comparing sets of effects", 0.6)
    fits = problem.search()
    problem.phi = max(floor, dispersion(fits[0].normal, n_flights))
    return problem, sorted(fits, key=problem.log_evidence, reverse=True)


def _content(
    flights: FlightSet,
    simulator: str,
    library: Library,
    problem: Problem,
    verdict: Verdict,
    every: Likelihood,
    drift: shrinkage.Drift,
    logs: Sequence[FlightLog],
    ids: tuple[list[int], list[int]],
) -> dict[str, Any]:
    fit_ids, held = ids
    lofo = fit_ids == held
    where = gap.where(every.tracks(problem.nominal().vector), every.sigma)
    found = verdict.chosen.fit
    reported = sorted(found.effects) if verdict.kind == "effect" else []
    seen = limits(problem, found)
    return {
        "schema": SCHEMA,
        "simulator": simulator,
        "drone": flights.vehicle.drone,
        "flights": {
            "n": len(logs),
            "seconds": float(sum(f.seconds for f in logs)),
            "fit": [logs[i].name for i in fit_ids],
            "held_out": [logs[i].name for i in held],
            "left_out": [],
        },
        "where": where,
        "verdict": verdict.kind,
        "unexplained_share": verdict.unexplained_share,
        "effects": [_effect(problem, verdict, name) for name in reported],
        "candidates": _candidates(problem, verdict, drift),
        "shrink": shrinkage.shrink(drift, every.sigma, lofo),
        "next_flight": next_flight(
            verdict.kind,
            {name: verdict.aliases[name] for name in reported},
            _largest_regime(where),
            _blind_to(library, seen),
        ),
        "details": _details(flights, library, problem, verdict, every, drift, logs, seen),
    }


def _effect(problem: Problem, verdict: Verdict, name: str) -> dict[str, Any]:
    free, low, high = intervals(problem, verdict.chosen.fit)
    slots = problem.library.slots
    parameters = {
        slots[i].parameter: {
            "value": float((a + b) / 2),
            "low": float(a),
            "high": float(b),
            "unit": slots[i].unit,
        }
        for i, a, b in zip(free, low, high, strict=True)
        if slots[i].effect == name
    }
    return {
        "name": name,
        "probability": verdict.probability[name],
        "aliases": verdict.aliases[name],
        "parameters": parameters,
    }


def _candidates(problem: Problem, verdict: Verdict, drift: shrinkage.Drift) -> list[dict[str, Any]]:
    nominal = problem.nominal().normal
    before = drift.before
    found = []
    for ranked in verdict.ranked[:8]:
        effects = sorted(ranked.effects)
        after = problem.likelihood.tracks(ranked.fit.vector)
        same = problem.likelihood.tracks(problem.nominal().vector) if effects else after
        a, b = (_rms(gap.drifts(t)[:, :3]) for t in (same, after))
        found.append(
            {
                "effects": effects,
                "probability": ranked.probability,
                "evidence": shrinkage.evidence(nominal, problem, ranked.fit),
                "shrink_percent": 100.0 * (1.0 - b / a) if a > 0 and len(before.t) else None,
            }
        )
    return found


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
    return [
        slots[i].effect for i, size in seen if size > 0.2 * (slots[i].high - slots[i].low)
    ]


def _details(
    flights: FlightSet,
    library: Library,
    problem: Problem,
    verdict: Verdict,
    every: Likelihood,
    drift: shrinkage.Drift,
    logs: Sequence[FlightLog],
    seen: Sequence[tuple[int, float]],
) -> dict[str, Any]:
    nominal, chosen = problem.nominal().normal, verdict.chosen.fit.normal
    slots = library.slots
    return {
        "flights_seconds": {f.name: float(f.seconds) for f in logs},
        "before_after": _along(drift, logs),
        "gap_in_time": gap.in_time(every.tracks(problem.nominal().vector), every.sigma),
        "chi2_per_dof": {
            "before": nominal.chi2 / float(nominal.dof.sum()),
            "after": chosen.chi2 / float(chosen.dof.sum()),
        },
        "structure": {"before": structure(problem, nominal), "after": verdict.structure},
        "dispersion": problem.phi,
        "noise": {name: float(s) for name, s in zip(CHANNELS, every.sigma, strict=True)},
        "not_observable": _not_observable(library),
        "limits": [
            {
                "effect": slots[i].effect,
                "parameter": slots[i].parameter,
                "unit": slots[i].unit,
                "smallest": size,
            }
            for i, size in seen
        ],
        "best_set": sorted(verdict.chosen.effects),
    }


def _along(drift: shrinkage.Drift, logs: Sequence[FlightLog]) -> list[dict[str, Any]]:
    before, after = (np.linalg.norm(gap.drifts(t)[:, :3], axis=1) for t in (drift.before, drift.after))
    found = []
    for flight in np.unique(drift.before.flight):
        mine = (drift.before.flight == flight) & np.isfinite(before) & np.isfinite(after)
        found.append(
            {
                "flight": logs[flight].name,
                "t": drift.before.t[mine].tolist(),
                "before": before[mine].tolist(),
                "after": after[mine].tolist(),
            }
        )
    return found


def _not_observable(library: Library) -> list[dict[str, str]]:
    """Registered effects that are no candidates, and why."""
    simulator = library.simulator
    found = []
    for name, kind in sorted(registry.load_all("effect").items()):
        if name in library.effects:
            continue
        missing = [door for door in (kind.door, *kind.needs) if door not in simulator.doors]
        if missing:
            why = f"simulator '{simulator.name}' has no door '{missing[0]}'"
        elif name in LEFT_OUT:
            why = "a floor is seen or not; it has no slope to follow"
        elif name == "downwash":
            why = "no flight has two drones"
        else:
            why = "excluded by request"
        found.append({"effect": name, "why": why})
    return found


