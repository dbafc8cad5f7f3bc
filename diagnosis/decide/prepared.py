"""Flights prepared for a diagnosis: windows, the simulator, and what the reference says."""

import dataclasses
import functools
from collections.abc import Callable, Collection, Iterable, Sequence

import numpy as np
from jaxtyping import Float

from diagnosis.decide.reference import Reference, fit_reference
from diagnosis.decision import Decision
from diagnosis.fit import shrinkage
from diagnosis.fit.likelihood import Likelihood
from diagnosis.logs.flights import FlightLog, FlightSet, LogError
from diagnosis.logs.inputs import Inputs, choose_inputs, driven_alike, on_ground
from diagnosis.logs.noise import UNSEEN_ATTITUDE_RAD, estimate_noise
from diagnosis.logs.segments import (
    FEWEST_NODES,
    NODE_DT,
    REPLAY_WINDOW_S,
    Early,
    Segments,
    cut,
    uncounted,
)
from diagnosis.replay.believed import nominal_simulator
from diagnosis.replay.library import make_library, with_aliases
from diagnosis.replay.programs import remembered
from diagnosis.replay.replay import Replay, make_replay
from simulators.contract import replayable_class
from simulators.vehicle import GRAVITY

PROBE = 3
"""Reference flights that are fitted first where a twin may take over: where they already are not
followed, the fit is no vehicle, and the other flights are spared. With 9 flights of
`crazyflie_plain` it takes a quarter of the time."""

Progress = Callable[[str, float], None]
"""Called with a stage's name and the share of the work that is done."""


def silent(stage: str, share: float) -> None:
    """A `Progress` that shows nothing."""


@dataclasses.dataclass(frozen=True)
class Question:
    """What is asked of a diagnosis."""

    flights: FlightSet
    """The flights that may have a gap."""
    simulator: str = "crazyflow"
    """Registered name of the simulator that they are compared with."""
    reference: FlightSet | None = None
    """Flights of the same vehicle before something changed."""
    exclude: Collection[str] = ()
    """Effects that may not be blamed; with each, those that look like it."""
    decision: Decision = Decision()
    """What decides."""


@dataclasses.dataclass(frozen=True)
class Prepared:
    """Flights replayed in one way, before anything is fitted to them."""

    inputs: Inputs
    """The flights as they are driven, those that hold nothing to compare left out."""
    compared: Inputs | None
    """The reference flights, likewise."""
    base: Reference | None
    """What the reference flights say; the first `PROBE` of them, if a twin takes over."""
    every: Likelihood
    """All flights."""
    noise: Float[np.ndarray, " 9"]
    """Noise of the logs, before a reference enlarged it."""
    fit_ids: list[int]
    """Flights that are fitted."""
    held: list[int]
    """Flights that are scored; all of them, one left out in turn, where they are few."""
    decision: Decision
    """What decides."""

    @property
    def in_turn(self) -> bool:
        """Whether each flight is left out in turn, because they are too few to hold some out."""
        return self.fit_ids == self.held

    def part(self, chosen: Sequence[int]) -> Likelihood:
        """The likelihood of some of the flights."""
        logs = [self.inputs.flights[i] for i in chosen]
        part = make_likelihood(self.every.replay, logs, self.every.sigma)
        return dataclasses.replace(part, shake=self.every.shake)


def prepare(
    question: Question,
    prescribe: bool = False,
    progress: Progress = silent,
    or_twin: bool = False,
) -> Prepared:
    """The flights in windows, the simulator with its library, and what the reference says.

    With `prescribe`, the attitude is the measured one. With `or_twin`, a twin takes the place of a
    reference that is not followed, whose fit may then end early.

    Raises:
        LogError: No flight has an input that can be replayed, or the reference has another believed
            mass or logged another input.
    """
    if question.reference is not None:
        _check_masses(question.flights, question.reference)
    progress("cutting flights into windows", 0.02)
    inputs, compared = driven(question, prescribe)
    replay = _replay(question, inputs, compared)
    logs = inputs.flights
    sigma = noise_of(replay, logs)
    fitted = ", fitting it to the reference flights" if compared is not None else ""
    progress(f"compiling the simulator{fitted}", 0.05)
    decision, base = question.decision, None
    if compared is not None:
        probed = or_twin and len(compared.flights) > PROBE
        first = compared.flights[:PROBE] if probed else compared.flights
        base = reference_of(replay, first, decision, or_twin, narrow=not probed)
        if probed and not base.unfollowed(decision):
            base = reference_of(replay, compared.flights, decision, or_twin)
    every = make_likelihood(replay, logs, base.enlarged * sigma if base else sigma)
    fit_ids, held = shrinkage.split(len(logs), decision)
    return Prepared(inputs, compared, base, every, sigma, fit_ids, held, decision)


def driven(question: Question, prescribe: bool = False) -> tuple[Inputs, Inputs | None]:
    """The flights and the reference flights, as they are driven.

    Raises:
        LogError: No flight has an input that can be replayed, or both logged different ones.
    """
    flights, simulator, reference = question.flights, question.simulator, question.reference
    if reference is not None:
        inputs, compared = driven_alike(flights, reference, prescribe)
        return _scorable(inputs, flights, simulator), _scorable(compared, reference, simulator)
    return _scorable(choose_inputs(flights, prescribe), flights, simulator), None


def _check_masses(flights: FlightSet, reference: FlightSet) -> None:
    """Both are replayed in one simulator, so both must be believed to weigh the same."""
    here, there = flights.vehicle.mass, reference.vehicle.mass
    if here != there:
        raise LogError(
            f"{flights.path}/vehicle.toml: mass is {here} kg, but {there} kg in the vehicle.toml "
            "of the reference. Flights of several drones need the same mass in both."
        )


def _replay(question: Question, inputs: Inputs, compared: Inputs | None) -> Replay:
    """The simulator with every effect that these flights may show."""
    sets = (inputs.flights, *([compared.flights] if compared else []))
    return nominal_replay(
        question.flights,
        inputs,
        question.simulator,
        question.exclude,
        several_drones=any(len(f.drones) > 1 for flown in sets for f in flown),
        referenced=compared is not None,
        voltage=_voltage_known(inputs, sets),
    )


def nominal_replay(
    flights: FlightSet,
    inputs: Inputs,
    simulator: str,
    exclude: Collection[str],
    **kinds: bool,
) -> Replay:
    """The nominal simulator with every effect that these inputs can show.

    Args:
        flights: The flights, whose vehicle is simulated.
        inputs: The same, as they are driven.
        simulator: Registered name of the simulator.
        exclude: Effects that are not looked for; with each, those that look like it.
        kinds: Further arguments of `make_library`.
    """
    library = make_library(
        nominal_simulator(simulator, flights, limited=inputs.follows_commands),
        with_aliases(exclude),
        prescribed=inputs.prescribed,
        produced=inputs.produced,
        mapped=inputs.mapped,
        **kinds,
    )
    return make_replay(library, replayable_class(simulator).replay_dt, inputs.measured)


def _voltage_known(inputs: Inputs, sets: Iterable[Sequence[FlightLog]]) -> bool:
    """Whether every flight is of one drone with a voltage that its thrust does not follow yet."""
    flights = [flight for logs in sets for flight in logs]
    logged = all(len(f.drones) == 1 and f.drones[0].battery is not None for f in flights)
    return logged and inputs.follows_commands


def _scorable(inputs: Inputs, flights: FlightSet, simulator: str) -> Inputs:
    """The flights with a window in which prediction and measurement can be compared.

    Raises:
        LogError: There is none.
    """
    dt = replayable_class(simulator).replay_dt
    segments = cut_in_the_air(inputs.flights, dt, inputs.measured, flights.vehicle.mass)
    why = (
        f"in the air no {REPLAY_WINDOW_S:g} s without unknown commands hold {FEWEST_NODES} rows or "
        f"more; rows every {NODE_DT:g} s are expected."
    )
    try:
        return inputs.without(uncounted(segments), why)
    except LogError as error:
        raise LogError(f"{flights.path}, no flight is usable:\n{error}") from None


def cut_in_the_air(
    logs: Sequence[FlightLog], dt: float, measured: int, mass: float, early: Early = np.zeros_like
) -> list[Segments]:
    """Windows of flights; time on the ground does not count."""
    ground = functools.partial(on_ground, mass=mass, turning=measured > 0)
    return cut(logs, dt, measured, ground, early)


def make_likelihood(
    replay: Replay, logs: Sequence[FlightLog], sigma: Float[np.ndarray, " 9"]
) -> Likelihood:
    """The likelihood of flights."""
    mass = replay.library.simulator.spec.mass
    segments = cut_in_the_air(logs, replay.dt, replay.measured, mass)
    return Likelihood(replay, segments, sigma, _shake(logs) if replay.prescribed else 0.0)


def _shake(logs: Sequence[FlightLog]) -> float:
    """Noise of a window's mean force [m/s^2] where thrust points along the measured attitude.

    The thrust is taken to be about the weight.
    """
    period = np.median(np.concatenate([np.diff(d.t) for log in logs for d in log.drones]))
    return float(GRAVITY * estimate_noise(logs)[6] / np.sqrt(REPLAY_WINDOW_S / period))


def noise_of(replay: Replay, logs: Sequence[FlightLog]) -> Float[np.ndarray, " 9"]:
    """Noise of logs, with which a prescribed attitude says nothing."""
    sigma = estimate_noise(logs)
    if replay.prescribed:
        sigma[6:] = UNSEEN_ATTITUDE_RAD
    return sigma


def reference_of(
    replay: Replay,
    logs: Sequence[FlightLog],
    decision: Decision = Decision(),
    or_twin: bool = False,
    narrow: bool = True,
) -> Reference:
    """What reference flights say (`fit_reference`); remembered where compiled programs are.

    Without `narrow`, one program flies everything (`Likelihood.narrow`): a few flights that decide
    on a twin are fitted sooner than another program is compiled.
    """

    def fit() -> dict[str, np.ndarray]:
        likelihood = make_likelihood(replay, logs, noise_of(replay, logs))
        likelihood = dataclasses.replace(likelihood, narrow=narrow)
        return fit_reference(likelihood, decision, or_twin).to_arrays()

    settings = f"{decision} {or_twin=} {narrow=}"
    return Reference.of(remembered_of("reference", fit, replay, logs, settings))


def remembered_of(
    name: str,
    make: Callable[[], dict[str, np.ndarray]],
    replay: Replay,
    logs: Sequence[FlightLog],
    settings: str = "",
) -> dict[str, np.ndarray]:
    """What `make` makes of these flights in this replay, from disk if it was made before.

    Names of flights do not count.
    """
    rows = [vars(drone).items() for log in logs for drone in log.drones]
    inputs = [x for columns in rows for _, x in columns if x is not None]
    given = [[column for column, x in columns if x is not None] for columns in rows]
    settings = f"dt={replay.dt} measured={replay.measured} {given} {settings}"
    settings += f" drones={[len(log.drones) for log in logs]}"
    return remembered(name, make, replay.library, settings, inputs)
