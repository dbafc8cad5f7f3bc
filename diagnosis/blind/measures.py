"""What a case allows, measured with its label: decidability, Cramer-Rao bound, the oracle's shrink.

Everything here reads labels and flights without noise, so it runs after the last diagnosis.
"""

import dataclasses
import time
from pathlib import Path
from typing import Any

import numpy as np

from diagnosis import shrinkage
from diagnosis.blind.cases import Case
from diagnosis.blind.flying import Noise
from diagnosis.decidable import (
    Decidability,
    Parameters,
    contains,
    cramer_rao,
    decidability,
    truth_fit,
    unexplained,
    values,
)
from diagnosis.diagnose import DISTRUST, STEPS, make_likelihood, nominal_simulator
from diagnosis.library import make_library, with_aliases
from diagnosis.logs import FlightSet, load_flights
from diagnosis.noise import estimate_noise
from diagnosis.reference import Reference, fit_reference
from diagnosis.replay import Replay, make_replay
from diagnosis.search import Fit, Problem, Set, dispersion

SIMULATOR = "crazyflow"
"""The simulator that the diagnosis is asked about."""


class Workbench:
    """Compiled replays and the reference, shared by all cases of a process."""

    def __init__(self, runs: Path, with_reference: bool) -> None:
        self.runs, self.with_reference = runs, with_reference
        self._replays: dict[bool, Replay] = {}
        self._known: dict[tuple, Reference] = {}

    def replay(self, flights: FlightSet) -> Replay:
        """The replay for flights of one drone or of several."""
        several = any(len(flight.drones) > 1 for flight in flights.flights)
        if several not in self._replays:
            library = make_library(nominal_simulator(SIMULATOR, flights), (), several)
            self._replays[several] = make_replay(library, STEPS[SIMULATOR])
        return self._replays[several]

    def problem(self, flights: FlightSet, folder: str, sigma: np.ndarray) -> Problem:
        """The problem of some flights, with the reference in `folder` if there is one."""
        replay = self.replay(flights)
        if not self.with_reference:
            return Problem(make_likelihood(replay, flights.flights, sigma))
        base = self._reference(replay, folder, sigma)
        # Without noise the reference's own misfit must not hide what noise would not.
        own = sigma if folder == TRUE else base.sigma
        likelihood = make_likelihood(replay, flights.flights, own)
        return Problem(likelihood, base.vector, base.precision)

    def _reference(self, replay: Replay, folder: str, sigma: np.ndarray) -> Reference:
        key = (folder, replay.library.slots, sigma.tobytes())
        if key not in self._known:
            flights = load_flights(self.runs / folder).flights
            self._known[key] = fit_reference(make_likelihood(replay, flights, sigma))
        return self._known[key]

    def left(self, problem: Problem) -> float:
        """The chi-square that undisturbed flights without noise leave, scaled to a problem's."""
        likelihood = problem.likelihood
        flights = load_flights(self.runs / TRUE).flights
        same = make_likelihood(likelihood.replay, flights, likelihood.sigma)
        normal = same.normal(problem.base)
        dof = float(problem.nominal().normal.dof.sum())
        return normal.chi2 * dof / float(normal.dof.sum())


LOGGED = "reference"
"""Folder of the reference flights as logged, in `runs`."""
TRUE = "labels/reference"
"""Folder of the same without noise."""


def measure(desk: Workbench, case: Case) -> dict[str, Any]:
    """Everything about a case, as JSON."""
    begun = time.monotonic()
    truth: Parameters = {effect.name: effect.parameters for effect in case.effects}
    found = _without_noise(desk, case, truth)
    if case.kind in ("single", "pair"):
        found |= _with_noise(desk, case, truth)
    return found | {"seconds": time.monotonic() - begun}


def _without_noise(desk: Workbench, case: Case, truth: Parameters) -> dict[str, Any]:
    if case.kind == "clean":
        return {"decidable": True}
    flights = load_flights(desk.runs / "labels" / "true" / case.id)
    noise = Noise().scaled(case.noise)
    sigma = np.repeat([noise.pos, noise.vel, noise.attitude], 3)
    problem = desk.problem(flights, TRUE, sigma)
    if case.kind == "unknown":
        found = unexplained(problem, list(problem.library.effects), desk.left(problem))
    elif case.kind == "excluded":
        left = truth_fit(problem, truth).objective
        hidden = with_aliases(case.exclude)
        allowed = [name for name in problem.library.effects if name not in hidden]
        found = unexplained(problem, allowed, left)
    else:
        found = decidability(problem, truth)
        fit = truth_fit(problem, truth)
        own = {"bound": cramer_rao(problem, fit), "fitted": values(problem, fit)}
        return _json(found) | own
    return _json(found)


def _json(found: Decidability) -> dict[str, Any]:
    return {**dataclasses.asdict(found), "rival": list(found.rival)}


def _with_noise(desk: Workbench, case: Case, truth: Parameters) -> dict[str, Any]:
    """Held-out shrink under the true set and under the single wrong effect that looks best."""
    flights = load_flights(desk.runs / "cases" / case.id)
    problem = desk.problem(flights, LOGGED, estimate_noise(flights.flights))
    n = len(flights.flights)
    fit = truth_fit(problem, truth)
    if problem.likelihood.distrust(fit.vector, DISTRUST):
        problem.renew()
        fit = truth_fit(problem, truth)
    problem.phi = dispersion(fit.normal, n)
    nominal = problem.nominal()
    wrong = [
        Set({name})
        for name in problem.library.effects
        if not any(contains(Set({name}), Set({true})) for true in truth)
    ]
    best = max(wrong, key=lambda effects: problem.promised(nominal, effects))
    return {
        "shrink_oracle": _shrink(problem, fit, n),
        "shrink_wrong": _shrink(problem, problem.refit(best, nominal), n),
        "wrong": next(iter(best)),
        "oracle": values(problem, fit),
    }


def _shrink(problem: Problem, fit: Fit, n_flights: int) -> float | None:
    """Shrink of the drift [%] on flights left out in turn; None with too few flights."""
    drift = shrinkage.score(problem, fit, problem.likelihood, n_flights, lofo=True)
    return shrinkage.shrink(drift, problem.likelihood.sigma, lofo=True)["percent"]
