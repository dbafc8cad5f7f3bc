"""Advised manoeuvres flown in simulation, each beside bland flights of the same duration.

For a pair of effects that flights may not tell apart, `diagnosis.decide.advice` names a manoeuvre.
Here it is flown with either effect being true, and beside it something gentle. Without noise, at
the noise that is logged, the margin of the truth is the chi-square of the best fit of the other
effect alone beyond that of the truth; 25 decides (`diagnosis.decide.decidable`).
"""

import dataclasses
import itertools
from collections.abc import Callable, Collection, Mapping
from typing import Any

import numpy as np

from blind.draw import catalogue
from blind.draw.cases import OWN, read_back
from blind.draw.catalogue import Withheld
from blind.fly import flying, paths
from blind.fly.realities import DT
from blind.fly.references import TrackedPath
from diagnosis.decide.decidable import with_truth
from diagnosis.decide.prepared import make_likelihood
from diagnosis.decision import Decision
from diagnosis.fit.evidence import Evidence
from diagnosis.fit.fit import Set
from diagnosis.fit.search import Fits, refit
from diagnosis.logs.flights import FlightSet
from diagnosis.remedies import flight_paths
from diagnosis.replay.believed import nominal_simulator
from diagnosis.replay.library import make_library
from diagnosis.replay.replay import Replay, make_replay
from simulators.contract import replayable_class
from simulators.effects.card import manoeuvre

MEDIUM = 1
"""The size of every true effect: the catalogue's second."""
SEED = 20261120
"""Seed of directions and of noise in the controller's estimates; any would do."""

Parameters = Mapping[str, float]


@dataclasses.dataclass(frozen=True)
class Flights:
    """Flights that all follow the same targets."""

    path: Callable[[np.ndarray], flight_paths.Targets | TrackedPath]
    """Targets at times [s]."""
    n: int = 1
    """Number of flights."""
    seconds: float = 10.0
    """Duration of each [s]."""
    onset: float = 0.0
    """When a gust sets in, if there is one [s]."""


@dataclasses.dataclass(frozen=True)
class Trial:
    """What is flown for a pair."""

    advised: Flights
    """What the advice says."""
    bland: Flights
    """As long in all, with nothing in it that separates the pair."""
    sizes: Mapping[str, Parameters] = dataclasses.field(default_factory=dict)
    """Parameters of true effects by names of the effects. They replace what the catalogue draws
    where its direction would separate the pair by itself; some effects it does not draw at all."""


@dataclasses.dataclass(frozen=True)
class Margins:
    """Whether a pair is told apart, one of them being true."""

    truth: str
    """The effect that acts."""
    rival: str
    """The other one, fitted alone."""
    advice: str
    """What is advised."""
    seconds: float
    """Duration of all flights together [s]."""
    bland: float
    """Chi-square of the rival beyond that of the truth in bland flights."""
    advised: float
    """Likewise in the advised flights."""

    @property
    def separated(self) -> bool:
        """Whether the advised flights decide between the two."""
        return self.advised >= Decision().decidable_chi2


_VERTICAL: Mapping[str, Parameters] = {
    "wind": {"x": 0.0, "y": 0.0, "z": -0.5},
    "thrust_gain": {"e": -0.05},
    "mass": {"e": 0.05},
}
"""A downwind and missing thrust that look alike; 10 % of the weight is more than a downwind may."""
_LIFT: Mapping[str, Parameters] = {"thrust_gain": {"e": 0.05}, "mass": {"e": -0.05}}
"""More thrust over mass, as near the ground."""
_DRIFT: Mapping[str, Parameters] = {"clock_drift": {"rate": 0.01}}
"""As much as the buffer of commands holds after the ten seconds of a flight."""
_HOVER, _LOW = Flights(flight_paths.hover), Flights(flight_paths.hover_low)
_MINUTE, _SIX = Flights(flight_paths.hover, seconds=60.0), Flights(flight_paths.hover, n=6)
_BOTH = Trial(Flights(paths.both_steps), _HOVER)
_SHARP = Trial(Flights(paths.attitude_steps), _HOVER)
_SPEEDS = Trial(Flights(flight_paths.two_speeds), Flights(flight_paths.slow_lines))
_HEIGHTS = Trial(Flights(flight_paths.heights), _LOW, _LIFT)
_TUMBLING = Trial(Flights(flight_paths.tumbling), _HOVER, _VERTICAL)

TRIALS: Mapping[frozenset[str], Trial] = {
    frozenset(pair): trial
    for pair, trial in (
        (("mass", "thrust_gain"), Trial(Flights(flight_paths.fast_lines), _HOVER)),
        (("drag", "quadratic_drag"), _SPEEDS),
        (("quadratic_drag", "rotor_drag"), _SPEEDS),
        (("drag", "rotor_drag"), Trial(Flights(flight_paths.tumbling), _HOVER)),
        (("wind", "gust"), Trial(Flights(flight_paths.hover, onset=5.0), _HOVER)),
        (("attitude_lag", "delay"), _SHARP),
        (("attitude_lag", "motor_lag"), _BOTH),
        (("delay", "motor_lag"), _BOTH),
        (("inertia", "motor_lag"), _BOTH),
        (("attitude_lag", "inertia"), _SHARP),
        (("delay", "inertia"), _SHARP),
        (("clock_drift", "delay"), Trial(Flights(paths.attitude_steps), _HOVER, _DRIFT)),
        (("trim", "center_of_mass"), Trial(Flights(flight_paths.pumping), _HOVER)),
        (("trim", "wind"), Trial(Flights(flight_paths.turning), _HOVER)),
        (("battery", "thrust_gain"), Trial(_MINUTE, _SIX)),
        (("battery", "mass"), Trial(_MINUTE, _SIX)),
        (("ground_effect", "thrust_gain"), _HEIGHTS),
        (("ground_effect", "mass"), _HEIGHTS),
        (("thrust_gain", "wind"), _TUMBLING),
        (("mass", "wind"), _TUMBLING),
    )
}
"""What is flown for every pair that there is advice for."""


def directions() -> list[tuple[str, str]]:
    """Every pair of `TRIALS` in both directions: truth and rival."""
    pairs = [tuple(sorted(pair)) for pair in TRIALS]
    return list(itertools.chain.from_iterable(((a, b), (b, a)) for a, b in pairs))


class Range:
    """Flies trials; flights of the same truth are shared by all trials of a process.

    Effects in `exclude` are not attached, which compiles faster and changes no margin of others.
    """

    def __init__(self, exclude: Collection[str] = ()) -> None:
        self._exclude = exclude
        self._replay: Replay | None = None
        self._flown: dict[tuple, Fits] = {}

    def margins(self, truth: str, rival: str) -> Margins:
        """Bland and advised margins of one truth against one rival.

        Raises:
            ValueError: There is no advice for this pair.
        """
        pair = frozenset((truth, rival))
        if pair not in TRIALS:
            known = ", ".join(" / ".join(sorted(p)) for p in TRIALS)
            raise ValueError(
                f"`truth` and `rival` must be a pair that there is advice for ({known}), got "
                f"'{truth}' and '{rival}'."
            )
        trial, advice = TRIALS[pair], manoeuvre(truth, rival)
        assert advice is not None, "there are trials only of pairs with advice"
        return Margins(
            truth=truth,
            rival=rival,
            advice=advice,
            seconds=trial.advised.n * trial.advised.seconds,
            bland=self._margin(truth, rival, trial.bland, trial.sizes),
            advised=self._margin(truth, rival, trial.advised, trial.sizes),
        )

    def _margin(
        self, truth: str, rival: str, flights: Flights, sizes: Mapping[str, Parameters]
    ) -> float:
        effect = true_effect(truth, flights, sizes)
        key = (truth, tuple(effect.parameters.items()), flights)
        if key not in self._flown:
            nominal = Fits.of(self._evidence(effect, flights))
            self._flown[key] = with_truth(nominal, {truth: effect.parameters})
        fits, other = self._flown[key], Set({rival})
        found = refit(fits, other, fits.nominal)[other]
        return found.objective - fits[Set({truth})].objective

    def _evidence(self, effect: Withheld, flights: Flights) -> Evidence:
        flown = _fly(effect, flights)
        if self._replay is None:
            # With the effects that are looked for only beside a twin.
            library = make_library(nominal_simulator(OWN, flown), self._exclude, twin=True)
            self._replay = make_replay(library, replayable_class(OWN).replay_dt)
        noise = flying.Noise()
        sigma = np.repeat([noise.pos, noise.vel, noise.attitude], 3)
        return Evidence.of(make_likelihood(self._replay, flown.flights, sigma))


def true_effect(truth: str, flights: Flights, sizes: Mapping[str, Parameters]) -> Withheld:
    """What acts in a trial: the catalogue's medium size, changed by `sizes`."""
    drawn: Parameters = {}
    if truth in catalogue.known(OWN):
        rng = np.random.default_rng(SEED)
        drawn = catalogue.draw_effect(truth, MEDIUM, rng, flights.seconds).parameters
    onset = {"onset": flights.onset} if truth == "gust" else {}
    return Withheld(truth, {**drawn, **onset, **sizes.get(truth, {})})


def _fly(effect: Withheld, flights: Flights) -> FlightSet:
    """The flights as they were, the controller having acted on noisy estimates."""
    rng = np.random.default_rng(SEED)
    t = np.arange(round(flights.seconds / DT)) * DT
    tables: list[Any] = []
    for _ in range(flights.n):
        disturbance = catalogue.make_disturbance((effect,), 1, rng)
        flown = flying.fly(
            OWN, disturbance, [[paths.tracked(flights.path, t)]], flying.Noise(), rng
        )
        tables.append(flown[0].true)
    return read_back(tables)
