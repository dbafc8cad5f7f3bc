"""The rows of the study of limits: predictions for every effect, and diagnoses that check some."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from blind.draw.cases import OWN, Case, fly_case, read_back
from blind.draw.catalogue import Withheld
from blind.draw.folders import Folders
from blind.fly.references import N_KINDS
from blind.score.limits import (
    FLIGHTS,
    NOISES,
    SECONDS,
    SEED,
    USUAL,
    Linear,
    drawn,
    make_single,
    size_of,
    sized,
)
from blind.score.measures import Workbench
from diagnosis.decide.attribution import attribute
from diagnosis.decide.prepared import make_likelihood
from diagnosis.decide.verdict import Verdict, judge
from diagnosis.fit.evidence import Evidence
from diagnosis.fit.shrinkage import split
from diagnosis.logs.noise import estimate_noise
from diagnosis.replay.library import Library

CHECKED = ("drag", "delay", "trim", "battery")
"""Effects whose limit is checked by diagnoses: one of every kind of door, and one of time."""
CHECKED_FLIGHTS = (1, 6)
"""Numbers of flights there."""
CHECKED_SIZES = (0.5, 1.0, 2.0)
"""Sizes there, over the predicted limit."""
REPEATS = 2
"""Cases of each."""

Row = Mapping[str, Any]


class Survey:
    """Predictions and checks; what is linearised is kept for all rows of a process."""

    def __init__(self) -> None:
        self._desk = Workbench(Folders(Path()), OWN)
        self._linear: dict[str, Linear] = {}

    def linear(self, name: str) -> Linear:
        """Flights linearised near the limit of an effect."""
        if name not in self._linear:
            first = self._at(drawn(name))
            limit = first.limit(USUAL, 1.0).size
            near = self._at(sized(first.effect, limit)) if np.isfinite(limit) else first
            self._linear[name] = near
        return self._linear[name]

    def _at(self, effect: Withheld) -> Linear:
        return Linear(self._desk.exact(make_single(effect, N_KINDS)), effect)

    def predict(self, name: str) -> list[Row]:
        """The limits of one effect, for every duration and noise."""
        linear = self.linear(name)
        common = {
            "kind": "predicted",
            "effect": name,
            "unit": unit_of(linear.evidence.library, name),
            "small": size_of(drawn(name, 0)),
            "large": size_of(drawn(name, 2)),
        }
        return [
            {**common, "seconds": n * SECONDS, "noise": noise, **vars(linear.limit(n, noise))}
            for n in FLIGHTS
            for noise in NOISES
        ]

    def check(self, name: str, n_flights: int, factor: float, repeat: int) -> Row:
        """One diagnosis of an effect whose size is `factor` times the predicted limit."""
        linear = self.linear(name)
        size = factor * linear.limit(n_flights, 1.0).size
        seed = int(np.random.default_rng([SEED, repeat, n_flights]).integers(2**62))
        effect = sized(drawn(name, seed=seed), size)
        found = self.diagnosed(make_single(effect, n_flights, seed=seed))
        effects = found.chosen.effects if found.kind == "effect" else ()
        return {
            "kind": "checked",
            "effect": name,
            "unit": unit_of(linear.evidence.library, name),
            "seconds": n_flights * SECONDS,
            "noise": 1.0,
            "size": size,
            "factor": factor,
            "repeat": repeat,
            "predicted": linear.named(size, n_flights, 1.0),
            "named": name in effects,
            "rival": " + ".join(sorted(effects)) or found.kind,
        }

    def diagnosed(self, case: Case) -> Verdict:
        """What the diagnosis says of a case, as `diagnose` would: from noisy logs alone."""
        flights = read_back([one.logged for one in fly_case(case)])
        logs = flights.flights
        chosen, _ = split(len(logs))
        likelihood = make_likelihood(
            self._desk.replay(flights), [logs[i] for i in chosen], estimate_noise(logs)
        )
        return judge(attribute(Evidence.of(likelihood), len(chosen)))


def unit_of(library: Library, name: str) -> str:
    """The unit of an effect's size: that of its first parameter."""
    return library.slots[library.indices[name][0]].unit


def checks() -> list[tuple[str, int, float, int]]:
    """Every check: effect, flights, factor, repeat; the first repeats of all come first."""
    return [
        (name, n, factor, repeat)
        for repeat in range(REPEATS)
        for name in CHECKED
        for n in CHECKED_FLIGHTS
        for factor in CHECKED_SIZES
    ]
