"""What a case allows, measured with its label: decidability, Cramer-Rao bound, the oracle's shrink.

Everything here knows what was withheld, so it runs after the last diagnosis. Decidability and bound
come from flights without noise in the reality whose equations are the nominal simulator's: the case
itself, or for another reality the same effects flown on the same references there. Otherwise the
chi-square of what both simulators do differently would stand in the place of the effect's. Where
the diagnosis has a reference, so has this, and what it leaves open is counted.
"""

import dataclasses
import time
from typing import Any

import numpy as np

from blind.draw.cases import (
    OWN,
    Case,
    fly_case,
    read_back,
    reference_sets_in,
    undisturbed_case,
)
from blind.draw.folders import Folders
from blind.fly.flying import Noise
from diagnosis.decide.decidable import (
    Decidability,
    Parameters,
    contains,
    cramer_rao,
    decidability,
    unexplained,
    values,
    with_truth,
)
from diagnosis.decide.prepared import make_likelihood, reference_of
from diagnosis.decide.reference import Reference, beside, fit_reference
from diagnosis.fit import shrinkage
from diagnosis.fit.equations import dispersion
from diagnosis.fit.evidence import Evidence
from diagnosis.fit.fit import Fit, Set
from diagnosis.fit.likelihood import Likelihood
from diagnosis.fit.outliers import beyond
from diagnosis.fit.search import Fits, refit
from diagnosis.logs.flights import FlightSet, load_flights
from diagnosis.logs.noise import estimate_noise
from diagnosis.replay.believed import nominal_simulator
from diagnosis.replay.library import make_library, with_aliases
from diagnosis.replay.replay import Replay, make_replay
from simulators.contract import replayable_class

TWIN_SEED = 20260917
"""Seed of the undisturbed flights in that reality that stand for the reference; any would do."""


class Workbench:
    """Compiled replays and references, shared by all cases of a process."""

    def __init__(self, folders: Folders, reality: str) -> None:
        self.folders, self.with_reference = folders, reference_sets_in(reality) > 0
        self._replays: dict[bool, Replay] = {}
        self._twin: dict[bool, Reference] = {}

    def replay(self, flights: FlightSet) -> Replay:
        """The replay for flights of one drone or of several."""
        several = _several(flights)
        if several not in self._replays:
            library = make_library(
                nominal_simulator(OWN, flights), (), several, referenced=self.with_reference
            )
            self._replays[several] = make_replay(library, replayable_class(OWN).replay_dt)
        return self._replays[several]

    def exact(self, case: Case) -> Fits:
        """The nominal fit to a case without noise, at the noise that was logged."""
        flights = without_noise(case)
        noise = Noise().scaled(case.noise)
        sigma = np.repeat([noise.pos, noise.vel, noise.attitude], 3)
        likelihood = make_likelihood(self.replay(flights), flights.flights, sigma)
        base = self._reference(likelihood, _several(flights)) if self.with_reference else None
        return Fits.of(beside(likelihood, base))

    def _reference(self, likelihood: Likelihood, several: bool) -> Reference:
        if several not in self._twin:
            self._twin[several] = fit_reference(self._undisturbed(likelihood))
        return self._twin[several]

    def _undisturbed(self, likelihood: Likelihood) -> Likelihood:
        clean = undisturbed_case(OWN, np.random.default_rng(TWIN_SEED))
        flights = without_noise(clean).flights
        return make_likelihood(likelihood.replay, flights, likelihood.sigma)

    def left(self, fits: Fits) -> float:
        """The chi-square that undisturbed flights without noise leave, scaled to other flights."""
        evidence = fits.evidence
        normal = self._undisturbed(evidence.likelihood).normal(evidence.library.neutral)
        return normal.chi2 * float(fits.nominal.normal.dof.sum()) / float(normal.dof.sum())

    def logged(self, case: Case) -> tuple[Evidence, int]:
        """The evidence that the diagnosis had, of every effect, and the number of flights."""
        flights = load_flights(self.folders.cases / case.id)
        replay, sigma = self.replay(flights), estimate_noise(flights.flights)
        n = len(flights.flights)
        place = self.folders.reference_of(case)
        if place is None:
            return beside(make_likelihood(replay, flights.flights, sigma), None), n
        base = reference_of(replay, load_flights(place).flights)
        likelihood = make_likelihood(replay, flights.flights, base.enlarged * sigma)
        return beside(likelihood, base), n


def without_noise(case: Case) -> FlightSet:
    """The case flown in the nominal simulator's reality, as it was and not as it was measured."""
    flown = fly_case(dataclasses.replace(case, reality=OWN))
    return read_back([one.true for one in flown])


def _several(flights: FlightSet) -> bool:
    return any(len(flight.drones) > 1 for flight in flights.flights)


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
    fits = desk.exact(case)
    evidence, candidates = fits.evidence, fits.evidence.library.candidates
    if case.kind == "unknown":
        found = unexplained(fits, list(candidates), desk.left(fits))
    elif case.kind == "excluded":
        fits = with_truth(fits, truth)
        hidden = with_aliases(case.exclude)
        allowed = [name for name in candidates if name not in hidden]
        found = unexplained(fits, allowed, fits[Set(truth)].objective)
    else:
        fits = with_truth(fits, truth)
        found, fit = decidability(fits, truth), fits[Set(truth)]
        own = {"bound": cramer_rao(evidence, fit), "fitted": values(evidence, fit)}
        return _json(found) | own
    return _json(found)


def _json(found: Decidability) -> dict[str, Any]:
    return {**dataclasses.asdict(found), "rival": list(found.rival)}


def _with_noise(desk: Workbench, case: Case, truth: Parameters) -> dict[str, Any]:
    """Held-out shrink under the true set and under the single wrong effect that looks best."""
    evidence, n = desk.logged(case)
    fits = with_truth(Fits.of(evidence), truth)
    fits = fits.settled(
        fits[Set(truth)].total, beyond(evidence.decision.distrust_sigmas, evidence.decision)
    )
    fits = with_truth(fits, truth)
    fit = fits[Set(truth)]
    fits = fits.weighed(dispersion(fit.normal, n))
    wrong = [
        Set({name})
        for name in evidence.library.candidates
        if not any(contains(Set({name}), Set({true})) for true in truth)
    ]
    best = max(wrong, key=lambda effects: fits.evidence.promised(fits.nominal, effects))
    return {
        "shrink_oracle": _shrink(fits.evidence, fit, n),
        "shrink_wrong": _shrink(fits.evidence, refit(fits, best, fits.nominal)[best], n),
        "wrong": next(iter(best)),
        "oracle": values(fits.evidence, fit),
    }


def _shrink(evidence: Evidence, fit: Fit, n_flights: int) -> float | None:
    """Shrink of the drift [%] on flights left out in turn; None with too few flights."""
    drift = shrinkage.score(evidence, fit, evidence.likelihood, n_flights, lofo=True)
    return shrinkage.shrink(drift, evidence.likelihood.sigma, lofo=True).percent
