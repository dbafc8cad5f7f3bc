"""`diagnose(flights)`: where the gap lies, which effect causes it, how far it shrinks."""

import dataclasses
import functools
from collections.abc import Callable, Collection, Iterable, Sequence

import numpy as np
from jaxtyping import Float

from diagnosis.answer import answer
from diagnosis.decide.reference import Reference, beside, fit_reference
from diagnosis.decide.study import Study
from diagnosis.decide.support import judged
from diagnosis.decide.verdict import FOLLOWED
from diagnosis.decision import DECISION
from diagnosis.fit import shrinkage
from diagnosis.fit.equations import dispersion
from diagnosis.fit.fit import Fit
from diagnosis.fit.likelihood import Likelihood
from diagnosis.fit.outliers import beyond, upsets
from diagnosis.fit.search import Problem
from diagnosis.logs.flights import FlightLog, FlightSet, LogError
from diagnosis.logs.inputs import Inputs, choose_inputs, on_ground
from diagnosis.logs.noise import UNSEEN, estimate_noise
from diagnosis.logs.segments import FEWEST_NODES, NODE_DT, WINDOW, Segments, cut, uncounted
from diagnosis.replay.library import make_library, with_aliases
from diagnosis.replay.programs import remembered
from diagnosis.replay.replay import Replay, make_replay
from diagnosis.result import Diagnosis
from simulators import registry
from simulators.contract import AbstractSimulator
from simulators.vehicle import GRAVITY, VEHICLES

STEPS = {"crazyflow": 0.002, "point_mass": 0.005}
"""Integration step of each simulator's replay [s]; others take the point mass's."""
MEASURED = 2.0
"""Largest thrust that rotors can be measured to give, over the largest that can be commanded."""

Progress = Callable[[str, float], None]
"""Called with a stage's name and the share of the work that is done."""


def silent(stage: str, share: float) -> None:
    """A `Progress` that shows nothing."""


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
        LogError: No flight has an input that can be replayed, or the reference flew another
            vehicle or logged another input.
    """
    if reference is not None:
        _check_alike(flights, reference)
    study = _study(flights, simulator, reference, exclude, progress, prescribe=False)
    if study.attitude_lost():
        progress("again, with the measured attitude", 0.05)
        other = _study(flights, simulator, reference, exclude, progress, prescribe=True)
        study = other if other.convinces() else study
    found = answer(flights, simulator, study, reference, exclude)
    progress("done", 1.0)
    return found


def _check_alike(flights: FlightSet, reference: FlightSet) -> None:
    """Both are replayed in one simulator, so both must be believed to be one vehicle."""
    for name, unit in (("drone", ""), ("mass", " kg")):
        here, there = (getattr(x.vehicle, name) for x in (flights, reference))
        if here != there:
            raise LogError(
                f"{flights.path}/vehicle.toml: {name} is {here}{unit}, that of the reference "
                f"{there}{unit}; one vehicle, believed the same before and after, is expected."
            )


def _study(
    flights: FlightSet,
    simulator: str,
    reference: FlightSet | None,
    exclude: Collection[str],
    progress: Progress,
    prescribe: bool,
) -> Study:
    progress("cutting flights into windows", 0.02)
    inputs = _scorable(choose_inputs(flights, prescribe, reference), flights, simulator)
    compared = None
    if reference is not None:
        compared = _scorable(choose_inputs(reference, prescribe, flights), reference, simulator)
    if compared is not None and compared.kind != inputs.kind:
        raise LogError(
            f"{flights.path} is replayed by {inputs.kind}, the reference by {compared.kind}; "
            "both must log the same kind of input."
        )
    sets = (inputs.flights, *([compared.flights] if compared else []))
    several = any(len(f.drones) > 1 for flown in sets for f in flown)
    nominal = nominal_simulator(simulator, flights, limited=inputs.follows_commands)
    library = make_library(
        nominal,
        with_aliases(exclude),
        several,
        inputs.prescribed,
        referenced=compared is not None,
        voltage=_voltage_known(inputs, sets),
        produced=inputs.produced,
        mapped=inputs.mapped,
    )
    replay = make_replay(library, _step(simulator), inputs.measured)
    logs = inputs.flights
    sigma = noise_of(replay, logs)
    fitted = ", fitting it to the reference flights" if compared is not None else ""
    progress(f"compiling the simulator{fitted}", 0.05)
    base = reference_of(replay, compared.flights) if compared is not None else None
    every = make_likelihood(replay, logs, base.enlarged * sigma if base else sigma)
    fit_ids, held = shrinkage.split(len(logs))
    lofo = fit_ids == held
    likelihood = every if lofo else _part(every, logs, fit_ids)
    problem, fits = attribute(likelihood, len(fit_ids), base, progress)
    verdict, lines = judged(problem, fits, base.floor if base else FOLLOWED)
    progress("scoring held-out flights", 0.9)
    every = problem.likelihood if lofo else every
    scored = every if lofo else _part(every, logs, held)
    if not lofo:
        at, spoiled = verdict.chosen.fit.total, beyond(DECISION.distrust_sigmas)
        every, scored = every.settled(at, spoiled), scored.settled(at, spoiled)
    drift = shrinkage.score(problem, verdict.chosen.fit, scored, len(logs), lofo)
    return Study(
        inputs, compared, base, problem, verdict, lines, every, drift, fit_ids, held, sigma
    )


def _voltage_known(inputs: Inputs, sets: Iterable[Sequence[FlightLog]]) -> bool:
    """Whether every flight is of one drone with a voltage that its thrust does not follow yet."""
    flights = [flight for logs in sets for flight in logs]
    logged = all(len(f.drones) == 1 and f.drones[0].battery is not None for f in flights)
    return logged and inputs.follows_commands


def _step(simulator: str) -> float:
    return STEPS.get(simulator, STEPS["point_mass"])


def _scorable(inputs: Inputs, flights: FlightSet, simulator: str) -> Inputs:
    """The flights with a window in which prediction and measurement can be compared.

    Raises:
        LogError: There is none.
    """
    segments = _segments(inputs.flights, _step(simulator), inputs.measured, flights.vehicle.mass)
    why = (
        f"in the air no {WINDOW:g} s without unknown commands hold {FEWEST_NODES} rows or more; "
        f"rows every {NODE_DT:g} s are expected."
    )
    try:
        return inputs.without(uncounted(segments), why)
    except LogError as error:
        raise LogError(f"{flights.path}, no flight is usable:\n{error}") from None


def _segments(logs: Sequence[FlightLog], dt: float, measured: int, mass: float) -> list[Segments]:
    """Windows of flights; time on the ground does not count."""
    return cut(logs, dt, measured, functools.partial(on_ground, mass=mass, turning=measured > 0))


def make_likelihood(
    replay: Replay, logs: Sequence[FlightLog], sigma: Float[np.ndarray, " 9"]
) -> Likelihood:
    """The likelihood of flights."""
    mass = replay.library.simulator.spec.mass
    segments = _segments(logs, replay.dt, replay.measured, mass)
    return Likelihood(replay, segments, sigma, _shake(logs) if replay.prescribed else 0.0)


def _shake(logs: Sequence[FlightLog]) -> float:
    """Noise of a window's mean force [m/s^2] where thrust points along the measured attitude.

    The thrust is taken to be about the weight.
    """
    period = np.median(np.concatenate([np.diff(d.t) for log in logs for d in log.drones]))
    return float(GRAVITY * estimate_noise(logs)[6] / np.sqrt(WINDOW / period))


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
    settings = f"dt={replay.dt} measured={replay.measured} {given}"
    settings += f" drones={[len(log.drones) for log in logs]}"
    return Reference.of(remembered("reference", fit, replay.library, settings, inputs))


def _part(every: Likelihood, logs: Sequence[FlightLog], chosen: Sequence[int]) -> Likelihood:
    """The likelihood of some of the flights."""
    part = make_likelihood(every.replay, [logs[i] for i in chosen], every.sigma)
    return dataclasses.replace(part, shake=every.shake)


def nominal_simulator(name: str, flights: FlightSet, limited: bool = True) -> AbstractSimulator:
    """The simulator as the operator believes it: her airframe, her mass.

    A thrust that was measured is not `limited` to what the airframe can be commanded.
    """
    spec = VEHICLES[flights.vehicle.drone]
    spec = dataclasses.replace(spec, mass=flights.vehicle.mass)
    if not limited:
        spec = dataclasses.replace(spec, thrust_min=0.0, thrust_max=MEASURED * spec.thrust_max)
    # Buffers of effects are as fine as the simulator's own step, so that is the replay's.
    own = {"dt": STEPS[name]} if name == "point_mass" else {}
    return registry.load("simulator", name)(spec=spec, **own)


def attribute(
    likelihood: Likelihood,
    n_flights: int,
    base: Reference | None = None,
    progress: Progress = silent,
) -> tuple[Problem, list[Fit]]:
    """The problem with its dispersion settled, and fits of all sets near the top.

    What was left out is settled once more where an upset shows only at the fit without others.
    """
    problem = beside(likelihood, base)
    floor = base.phi if base else 1.0
    progress("screening all effects", 0.1)
    problem.likelihood = likelihood.settled(problem.base)
    problem.phi = max(floor, dispersion(problem.nominal().normal, n_flights))
    best = problem.search_firmly()[0]
    for share in (0.5, 0.7):
        progress("weighing windows that stand out", share)
        spoiled = beyond(DECISION.distrust_sigmas)
        problem.likelihood = problem.likelihood.settled(best.total, spoiled)
        problem.renew()
        best = problem.refit(best.effects, problem.nominal())
        problem.phi = max(floor, dispersion(best.normal, n_flights))
        progress("comparing sets of effects", share + 0.1)
        problem.search()
        problem.polish_best()
        best = problem.ranked()[0]
        problem.phi = max(floor, dispersion(best.normal, n_flights))
        if not upsets(best.normal, best.normal.dof > 0).any():
            break
    return problem, problem.ranked()
