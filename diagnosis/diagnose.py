"""`diagnose(flights)`: where the gap lies, which effect causes it, how far it shrinks."""

import dataclasses
import functools
from collections.abc import Callable, Collection, Sequence
from typing import Any

import numpy as np
from jaxtyping import Float

from diagnosis import gap, shrinkage
from diagnosis.advice import next_flight
from diagnosis.equations import dispersion
from diagnosis.inputs import Inputs, choose_inputs, on_ground
from diagnosis.library import (
    LEFT_OUT,
    NEEDS_ATTITUDE_CMD,
    Library,
    make_library,
    with_aliases,
)
from diagnosis.likelihood import Likelihood
from diagnosis.logs import FlightLog, FlightSet, LogError
from diagnosis.noise import CHANNELS, estimate_noise
from diagnosis.programs import remembered
from diagnosis.reference import Reference, fit_reference
from diagnosis.replay import Replay, make_replay
from diagnosis.search import Fit, Problem
from diagnosis.segments import cut
from diagnosis.verdict import Verdict, intervals, judge, limits, structure
from simulators import registry
from simulators.contract import AbstractSimulator
from simulators.vehicle import VEHICLES

SCHEMA = 1
"""Version of `diagnosis.json`."""
STEPS = {"crazyflow": 0.002, "point_mass": 0.005}
"""Integration step of each simulator's replay [s]; others take the point mass's."""
ATTITUDE_LOST = 30.0
"""Chi-square per node of a roll, pitch or yaw that nothing explains, from which the attitude is
prescribed: five sigmas, so that forces are not judged through an attitude that is wrong."""
FORCES_EXPLAINED = 0.1
"""Share of the gap in forces that may be left where the attitude was prescribed for their sake."""
UNSEEN = 1e3
"""Noise [rad] of an attitude that is prescribed and therefore says nothing."""
DISTRUST = 2.5
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
    study = _study(flights, simulator, reference, exclude, progress, prescribe=False)
    if study.attitude_lost():
        progress("again, with the measured attitude", 0.05)
        other = _study(flights, simulator, reference, exclude, progress, prescribe=True)
        study = other if other.convinces() else study
    content = _content(flights, simulator, study)
    content["details"]["not_observable"] = _not_observable(study, with_aliases(exclude))
    progress("done", 1.0)
    return Diagnosis(content)


@dataclasses.dataclass(frozen=True)
class Study:
    """Flights replayed in one way, with what came of it."""

    inputs: Inputs
    """The flights as they are driven."""
    base: Reference | None
    """What the reference flights say."""
    problem: Problem
    """Fits of candidate sets."""
    verdict: Verdict
    """Which set."""
    every: Likelihood
    """All flights."""
    drift: shrinkage.Drift
    """Held-out flights before and after."""
    fit_ids: list[int]
    """Flights that were fitted."""
    held: list[int]
    """Flights that were scored; all of them, one left out in turn, where they are few."""
    noise: Float[np.ndarray, " 9"]
    """Noise of the logs, before a reference enlarged it."""

    def attitude_lost(self) -> bool:
        """Whether nothing explains the attitude, so that it spoils what thrust and forces say."""
        if self.inputs.prescribed or self.verdict.kind != "unexplained":
            return False
        normal = self.verdict.chosen.fit.normal
        chi2 = normal.kind.sum(axis=0)[6:] / (normal.dof.sum() / 9.0)
        enlarged = (self.every.sigma / self.noise)[6:] ** 2
        return bool(np.max(chi2 * enlarged) > ATTITUDE_LOST)

    def convinces(self) -> bool:
        """Whether forces, judged under the measured attitude, have a clear cause.

        The noise of the measured attitude enters the forces, which a small effect could explain.
        """
        share = self.verdict.unexplained_share
        return self.verdict.kind == "effect" and share < FORCES_EXPLAINED


def _study(
    flights: FlightSet,
    simulator: str,
    reference: FlightSet | None,
    exclude: Collection[str],
    progress: Progress,
    prescribe: bool,
) -> Study:
    inputs = choose_inputs(flights, prescribe)
    compared = choose_inputs(reference, prescribe) if reference is not None else None
    if compared is not None and compared.kind != inputs.kind:
        raise LogError(
            f"{flights.path} is replayed by {inputs.kind}, the reference by {compared.kind}; "
            "both must log the same kind of input."
        )
    logs = inputs.flights
    sets = (logs, *([compared.flights] if compared else []))
    several = any(len(f.drones) > 1 for flown in sets for f in flown)
    nominal = nominal_simulator(simulator, flights)
    library = make_library(nominal, with_aliases(exclude), several, inputs.prescribed)
    step = STEPS.get(simulator, STEPS["point_mass"])
    replay = make_replay(library, step, inputs.prescribed)
    progress("cutting flights into windows", 0.02)
    sigma = noise_of(replay, logs)
    progress("compiling the simulator", 0.05)
    base = reference_of(replay, compared.flights) if compared is not None else None
    every = make_likelihood(replay, logs, base.enlarged * sigma if base else sigma)
    fit_ids, held = shrinkage.split(len(logs))
    lofo = fit_ids == held
    likelihood = every if lofo else _part(every, logs, fit_ids)
    problem, fits = attribute(likelihood, len(fit_ids), base, progress)
    verdict = judge(problem, fits, base.structure if base else 1.0)
    progress("scoring held-out flights", 0.9)
    scored = every if lofo else _part(every, logs, held)
    if not lofo:
        for other in (every, scored):
            other.settle(verdict.chosen.fit.total, DISTRUST)
    drift = shrinkage.score(problem, verdict.chosen.fit, scored, len(logs), lofo)
    return Study(inputs, base, problem, verdict, every, drift, fit_ids, held, sigma)


def make_likelihood(
    replay: Replay, logs: Sequence[FlightLog], sigma: Float[np.ndarray, " 9"]
) -> Likelihood:
    """The likelihood of flights; time on the ground does not count."""
    mass = replay.library.simulator.spec.mass
    ignored = functools.partial(on_ground, mass=mass)
    return Likelihood(replay, cut(logs, replay.dt, replay.prescribed, ignored), sigma)


def noise_of(replay: Replay, logs: Sequence[FlightLog]) -> Float[np.ndarray, " 9"]:
    """Noise of logs, with which a prescribed attitude says nothing."""
    sigma = estimate_noise(logs)
    if replay.prescribed:
        sigma[6:] = UNSEEN
    return sigma


def reference_of(replay: Replay, logs: Sequence[FlightLog]) -> Reference:
    """What reference flights say; remembered where compiled programs are."""

    def fit() -> dict[str, np.ndarray]:
        return fit_reference(make_likelihood(replay, logs, noise_of(replay, logs))).to_arrays()

    rows = [vars(drone).items() for log in logs for drone in log.drones]
    inputs = [x for columns in rows for _, x in columns if x is not None]
    given = [[name for name, x in columns if x is not None] for columns in rows]
    settings = f"dt={replay.dt} prescribed={replay.prescribed} {given}"
    settings += f" drones={[len(log.drones) for log in logs]}"
    return Reference.of(remembered("reference", fit, replay.library, settings, inputs))


def _part(every: Likelihood, logs: Sequence[FlightLog], chosen: Sequence[int]) -> Likelihood:
    """The likelihood of some of the flights."""
    return make_likelihood(every.replay, [logs[i] for i in chosen], every.sigma)


def nominal_simulator(name: str, flights: FlightSet) -> AbstractSimulator:
    """The simulator as the operator believes it: her airframe, her mass."""
    spec = VEHICLES[flights.vehicle.drone]
    spec = dataclasses.replace(spec, mass=flights.vehicle.mass)
    # Buffers of effects are as fine as the simulator's own step, so that is the replay's.
    own = {"dt": STEPS[name]} if name == "point_mass" else {}
    return registry.load("simulator", name)(spec=spec, **own)


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
    likelihood.settle(best.total, DISTRUST)
    problem.renew()
    best = problem.refit(best.effects, problem.nominal())
    problem.phi = max(floor, dispersion(best.normal, n_flights))
    progress("comparing sets of effects", 0.6)
    problem.search()
    problem.polish_best()
    problem.phi = max(floor, dispersion(problem.ranked()[0].normal, n_flights))
    return problem, problem.ranked()


def _content(flights: FlightSet, simulator: str, study: Study) -> dict[str, Any]:
    problem, verdict, logs = study.problem, study.verdict, study.inputs.flights
    where = gap.where(study.every.tracks(problem.base), study.every.sigma)
    found = verdict.chosen.fit
    reported = sorted(found.effects) if verdict.kind == "effect" else []
    seen = limits(problem, found)
    left_out = [(x.name, x.reason) for x in flights.left_out] + list(study.inputs.left_out)
    return {
        "schema": SCHEMA,
        "simulator": simulator,
        "drone": flights.vehicle.drone,
        "flights": {
            "n": len(logs),
            "seconds": float(sum(f.seconds for f in logs)),
            "input": study.inputs.kind,
            "fit": [logs[i].name for i in study.fit_ids],
            "held_out": [logs[i].name for i in study.held],
            "left_out": [{"name": name, "reason": reason} for name, reason in left_out],
        },
        "where": where,
        "verdict": verdict.kind,
        "unexplained_share": verdict.unexplained_share,
        "effects": [_effect(problem, verdict, name) for name in reported],
        "candidates": _candidates(problem, verdict),
        "shrink": shrinkage.shrink(study.drift, study.every.sigma, study.fit_ids == study.held),
        "next_flight": next_flight(
            verdict.kind,
            {name: verdict.aliases[name] for name in reported},
            _largest_regime(where),
            _blind_to(problem.library, seen),
        ),
        "details": _details(study, seen),
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


def _candidates(problem: Problem, verdict: Verdict) -> list[dict[str, Any]]:
    nominal = problem.nominal()
    before = _drift(problem, problem.base)
    return [
        {
            "effects": sorted(ranked.effects),
            "probability": ranked.probability,
            "evidence": shrinkage.evidence(nominal.normal, problem, ranked.fit),
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
        "before_after": _along(study.drift, logs),
        "gap_in_time": gap.in_time(every.tracks(problem.base), every.sigma),
        "chi2_per_dof": {
            "before": nominal.chi2 / float(nominal.dof.sum()),
            "after": chosen.chi2 / float(chosen.dof.sum()),
        },
        "structure": {
            "before": structure(problem, nominal).value,
            "after": verdict.structure.value,
        },
        "dispersion": problem.phi,
        "noise": {name: float(s) for name, s in zip(CHANNELS, every.sigma, strict=True)},
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
    before, after = (
        np.linalg.norm(gap.drifts(t)[:, :3], axis=1) for t in (drift.before, drift.after)
    )
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


def _not_observable(study: Study, exclude: Collection[str]) -> list[dict[str, str]]:
    """Registered effects that are no candidates, and why."""
    library = study.problem.library
    simulator, found = library.simulator, []
    for name, kind in sorted(registry.load_all("effect").items()):
        if name in library.candidates:
            continue
        missing = [door for door in (kind.door, *kind.needs) if door not in simulator.doors]
        if name in exclude:
            why = "excluded by request, or cannot be told from what was"
        elif missing:
            why = f"simulator '{simulator.name}' has no door '{missing[0]}'"
        elif name in LEFT_OUT:
            why = "a floor is seen or not; it has no slope to follow"
        elif name in NEEDS_ATTITUDE_CMD:
            why = f"the attitude is prescribed from measurement ({study.inputs.kind})"
        else:
            why = "no flight has two drones"
        found.append({"effect": name, "why": why})
    return found
